"""The steerability test of the paper, section V-B: insertions of one length without turning the bevel."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from labrig.analysis.pictures import Measured, Unreadable, measure_image
from labrig.analysis.sentinel import GridRole
from labrig.devices.axis import AxisReadback
from labrig.devices.operator import ConfirmAxesAtZero, MountNeedle, PlaceSpecimen, ShiftToHole
from labrig.devices.rig_file import RigDescription
from labrig.errors import PictureError, Problem
from labrig.experiments.shared.holes import find_near_holes
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.experiments.shared.rig_view import load_plane_map, load_rig_mask
from labrig.experiments.steerability.analysis import make_order
from labrig.experiments.steerability.events import SweepRole, SweepTrialStart, SweepTrialStop
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.experiments.steerability.schedule import (
    BegunTrial,
    PlannedTrial,
    can_repeat,
    describe_order,
    describe_place,
    list_planned_trials,
    list_remaining_trials,
)
from labrig.protocol.sections import TrackedSpecimen
from labrig.runner.experiment import PlannedMove, RunPlan, total_duration_s
from labrig.runner.graph_paper import confirm_needle_out, photograph_grid
from labrig.runner.plan import (
    PICTURES_A_TRIAL_BESIDE_ADVANCE,
    count_sentinel_work,
    find_rig_problems,
    plan_insertion_moves,
    plan_roll_move,
)
from labrig.runner.session import Session, TakenPicture
from labrig.vision.curvature import CurvatureMeasurement
from labrig.vision.picture import Picture


def list_trial_moves(protocol: SteerabilityProtocol) -> tuple[PlannedMove, ...]:
    """Return the moves of one insertion, in order; all insertions of a sweep make the same moves."""
    insertion = protocol.insertion
    return plan_insertion_moves("insertion.length_mm", insertion.length_mm, insertion, protocol.sheath)


def plan(protocol: SteerabilityProtocol, rig: RigDescription) -> RunPlan:
    """Return the plan of a run on a rig."""
    insertion, moves = protocol.insertion, list_trial_moves(protocol)
    trials = len(protocol.specimens) * protocol.insertions_per_specimen
    advance = math.ceil(insertion.length_mm / insertion.frame_every_mm) - 1
    pictures, steps = count_sentinel_work(protocol.sentinel)
    turn = plan_roll_move(rig, "insertion.bevel_roll_rad", insertion.bevel_roll_rad)
    return RunPlan(
        trials=trials,
        duration_s=trials * total_duration_s(moves),
        pictures=trials * (advance + PICTURES_A_TRIAL_BESIDE_ADVANCE) + pictures,
        operator_steps=1 + len(protocol.specimens) + trials + steps,
        moves=moves,
        problems=(*find_rig_problems(protocol, rig, (turn, *moves)), *_find_near_holes(protocol)),
        uses_calibration=True,
        notes=tuple(describe_order(protocol)),
    )


def _find_near_holes(protocol: SteerabilityProtocol) -> Iterator[Problem]:
    """Yield planned holes that come too close to old ones."""
    for key, gel in protocol.gels.items():
        places_mm, diameter_mm = protocol.list_places_mm(gel), protocol.sheath.diameter_mm
        yield from find_near_holes(key, gel, places_mm, diameter_mm, protocol.last_place_mm)


def run(protocol: SteerabilityProtocol, session: Session) -> None:
    """Make every insertion of the sweep.

    The operator places one specimen after another and shifts it from hole to hole: the bench has no lateral axis.
    """
    confirm_needle_out(session)
    mount_and_reference(protocol, session)
    make_insertions(protocol, session)


def mount_and_reference(protocol: SteerabilityProtocol, session: Session) -> None:
    """Have the needle mounted, take the present positions of the axes as zero, and turn the bevel."""
    session.ask(MountNeedle(protocol.needle.needle_id))
    session.ask(ConfirmAxesAtZero())
    session.reference_axes()
    session.move("rotation", protocol.insertion.bevel_roll_rad, session.axis("rotation").max_speed / 2)


def make_insertions(
    protocol: SteerabilityProtocol,
    session: Session,
    begun: Sequence[BegunTrial] = (),
    placed: TrackedSpecimen | None = None,
) -> None:
    """Make the insertions that remain, in order; each specimen is placed before its first one.

    What remains is told anew after each: a person may skip an insertion or have one made again.

    Parameters
    ----------
    protocol : SteerabilityProtocol
        The sweep.
    session : Session
        The session.
    begun : sequence of BegunTrial
        The insertions of earlier sessions.
    placed : TrackedSpecimen or None
        The specimen that is in the frame already.
    """
    photograph_grid(protocol.sentinel, GridRole.BEFORE, session)
    sweep = _Sweep(protocol, session, list(begun), placed)
    while remaining := sweep.list_remaining():
        sweep.make(remaining)
    photograph_grid(protocol.sentinel, GridRole.AFTER, session)


@dataclass
class _Sweep:
    """A sweep in progress: its insertions so far, and the specimen in the frame."""

    protocol: SteerabilityProtocol
    session: Session
    begun: list[BegunTrial]
    placed: TrackedSpecimen | None = None

    def list_remaining(self) -> tuple[PlannedTrial, ...]:
        """Return the insertions that remain."""
        return list_remaining_trials(self.protocol, self.begun, self.session.decisions)

    def make(self, remaining: Sequence[PlannedTrial]) -> None:
        """Make the first of the remaining insertions, unless the person chooses otherwise before it starts."""
        trial = remaining[0]
        self.session.tell_place(self._describe_place(trial))
        done = max(len(list_planned_trials(self.protocol)) - len(remaining), 0)
        self.session.attempt(
            trial.trial,
            partial(self._place_and_insert, trial, done),
            repeats=trial.repeats,
            can_repeat=self._can_repeat,
        )

    def _place_and_insert(self, trial: PlannedTrial, done: int) -> None:
        session, specimen = self.session, trial.specimen
        if specimen != self.placed:
            session.ask(PlaceSpecimen(specimen.name, specimen.gelatin_percent))
            self.placed = specimen
        session.progress(
            done * total_duration_s(list_trial_moves(self.protocol)),
            f"{specimen.name}, {describe_place(self.protocol, trial)}",
        )
        session.ask(ShiftToHole(specimen.name, trial.hole, trial.hole_position_mm))
        start = _make_start(self.protocol, trial)
        # An insertion that does not come to its end ends the run.
        self.begun.append(BegunTrial(start, SweepTrialStop(trial=trial.trial, exit_status="success")))
        _insert_once(self.protocol, trial, start, done, session)

    def _can_repeat(self, trial: int) -> bool:
        return can_repeat(self.protocol, self.begun, self.session.decisions, trial)

    def _describe_place(self, trial: PlannedTrial) -> str:
        specimens = self.protocol.specimens
        gel = f"gel {specimens.index(trial.specimen) + 1} of {len(specimens)}"
        return f"{describe_place(self.protocol, trial)}, {gel}"


def _make_start(protocol: SteerabilityProtocol, planned: PlannedTrial) -> SweepTrialStart:
    return SweepTrialStart(
        trial=planned.trial,
        specimen=planned.specimen.name,
        gelatin_percent=planned.specimen.gelatin_percent,
        hole=planned.hole,
        hole_position_mm=planned.hole_position_mm,
        needle_id=protocol.needle.needle_id,
        repeats=planned.repeats,
    )


def _insert_once(
    protocol: SteerabilityProtocol, planned: PlannedTrial, start: SweepTrialStart, done: int, session: Session
) -> None:
    """Sheath in, needle in with a picture every few mm, final picture, needle out along its path, sheath out."""
    total_s = total_duration_s(list_trial_moves(protocol))
    insertion, sheath = protocol.insertion, protocol.sheath
    specimen, trial = planned.specimen, planned.trial
    session.record(start)
    session.take_picture(SweepRole.HOLE, trial)
    session.mark_needle_in_tissue()
    session.move("linear", sheath.depth_mm, sheath.speed_mm_s)
    session.take_picture(SweepRole.SHEATH, trial)
    pictures = _PicturesOnTheWay(session, trial, insertion.frame_every_mm, insertion.length_mm)
    session.move("insertion", insertion.length_mm, insertion.speed_mm_s, pictures)
    final = session.take_picture(NeedleRole.FINAL, trial)
    session.record_truth(trial)
    session.progress(
        done * total_s + insertion.length_mm / insertion.speed_mm_s, f"{specimen.name}, withdrawing"
    )
    session.move("insertion", 0.0, insertion.withdraw_speed_mm_s)
    session.move("linear", 0.0, sheath.speed_mm_s)
    session.mark_needle_out()
    if session.is_judged:
        _judge_radius(protocol, trial, final, session)
    session.record(SweepTrialStop(trial=trial, exit_status="success", final_frame=final.frame))
    session.progress((done + 1) * total_s, f"{specimen.name}, hole {planned.hole + 1} done")


def _judge_radius(protocol: SteerabilityProtocol, trial: int, final: TakenPicture, session: Session) -> None:
    """Have the conditions of the protocol judge the radius in the final picture, measured as the analysis does.

    What only the whole run tells is not in it: a sheath that was elsewhere, and the drift of the camera.
    """
    name = session.picture_path(final.frame).name
    measured = session.compute(partial(_measure_radius, protocol, session.description, final.image, name))
    values: dict[str, float | None] = {"radius_mm": None, "radius_sd_mm": None}
    if isinstance(measured, CurvatureMeasurement) and measured.accepted:
        values = {"radius_mm": measured.radius_mm, "radius_sd_mm": measured.sigma_radius_mm}
    session.judge(trial, values, measured.reason or "")


def _measure_radius(
    protocol: SteerabilityProtocol, rig: RigDescription, image: Picture, name: str
) -> Measured:
    try:
        return measure_image(
            image, name, load_plane_map(rig), make_order(protocol).settings, load_rig_mask(rig)
        )
    except PictureError as error:
        return Unreadable(error.message)


class _PicturesOnTheWay:
    """Takes a picture each time the needle has advanced by another `every_mm`, except at the end."""

    def __init__(self, session: Session, trial: int, every_mm: float, length_mm: float) -> None:
        self._session = session
        self._trial = trial
        self._every_mm = every_mm
        self._length_mm = length_mm
        self._next_mm = every_mm

    def __call__(self, states: Mapping[str, AxisReadback]) -> None:
        if self._next_mm < self._length_mm and states["insertion"].position >= self._next_mm:
            self._session.take_picture(NeedleRole.ADVANCE, self._trial)
            self._next_mm += self._every_mm
