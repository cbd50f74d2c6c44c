"""The steerability test of the paper, section V-B: insertions of one length without turning the bevel."""

import math
from collections.abc import Mapping, Sequence

from labrig.analysis.sentinel import GridRole
from labrig.devices.axis import AxisReadback
from labrig.devices.operator import ConfirmAxesAtZero, MountNeedle, PlaceSpecimen, ShiftToHole
from labrig.devices.rig_file import RigDescription
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.experiments.steerability.events import SweepRole, SweepTrialStart, SweepTrialStop
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.experiments.steerability.schedule import PlannedTrial, list_planned_trials
from labrig.protocol.sections import Specimen
from labrig.runner.experiment import PlannedMove, RunPlan, total_duration_s
from labrig.runner.graph_paper import confirm_needle_out, photograph_grid
from labrig.runner.plan import (
    PICTURES_A_TRIAL_BESIDE_ADVANCE,
    count_sentinel_work,
    find_rig_problems,
    plan_insertion_moves,
    plan_roll_move,
)
from labrig.runner.session import Session


def list_trial_moves(protocol: SteerabilityProtocol) -> tuple[PlannedMove, ...]:
    """Return the moves of one insertion, in order; all insertions of a sweep make the same moves."""
    insertion = protocol.insertion
    return plan_insertion_moves("insertion.length_mm", insertion.length_mm, insertion, protocol.sheath)


def plan(protocol: SteerabilityProtocol, rig: RigDescription) -> RunPlan:
    """Return the plan of a run on a rig."""
    insertion, moves = protocol.insertion, list_trial_moves(protocol)
    trials = len(protocol.specimens) * protocol.insertions_per_specimen
    advance = math.ceil(insertion.length_mm / insertion.frame_every_mm) - 1
    pictures, operator_steps = count_sentinel_work(protocol.sentinel)
    turn = plan_roll_move(rig, "insertion.bevel_roll_rad", insertion.bevel_roll_rad)
    return RunPlan(
        trials=trials,
        duration_s=trials * total_duration_s(moves),
        pictures=trials * (advance + PICTURES_A_TRIAL_BESIDE_ADVANCE) + pictures,
        operator_steps=1 + len(protocol.specimens) + trials + operator_steps,
        problems=find_rig_problems(protocol, rig, (turn, *moves)),
    )


def run(protocol: SteerabilityProtocol, session: Session) -> None:
    """Make every insertion of the sweep.

    The operator places one specimen after another and shifts it from hole to hole: the bench has no lateral axis.
    """
    confirm_needle_out(session)
    mount_and_reference(protocol, session)
    make_insertions(protocol, list_planned_trials(protocol), session)


def mount_and_reference(protocol: SteerabilityProtocol, session: Session) -> None:
    """Have the needle mounted, take the present positions of the axes as zero, and turn the bevel."""
    session.ask(MountNeedle(protocol.needle.needle_id))
    session.ask(ConfirmAxesAtZero())
    session.rig.reference_axes()
    session.move("rotation", protocol.insertion.bevel_roll_rad, session.rig.rotation.max_speed / 2)


def make_insertions(protocol: SteerabilityProtocol, trials: Sequence[PlannedTrial], session: Session) -> None:
    """Make the insertions in order; each specimen is placed before its first one."""
    photograph_grid(protocol.sentinel, GridRole.BEFORE, session)
    placed: Specimen | None = None
    behind = len(list_planned_trials(protocol)) - len(trials)
    for done, trial in enumerate(trials, start=max(behind, 0)):
        if trial.specimen != placed:
            session.ask(PlaceSpecimen(trial.specimen.name, trial.specimen.gelatin_percent))
            placed = trial.specimen
        _insert_once(protocol, trial, done, session)
    photograph_grid(protocol.sentinel, GridRole.AFTER, session)


def _insert_once(protocol: SteerabilityProtocol, planned: PlannedTrial, done: int, session: Session) -> None:
    """Sheath in, needle in with a picture every few mm, final picture, needle out along its path, sheath out."""
    total_s = total_duration_s(list_trial_moves(protocol))
    insertion, sheath = protocol.insertion, protocol.sheath
    specimen, trial = planned.specimen, planned.trial
    session.progress(
        done * total_s, f"{specimen.name}, insertion {planned.hole + 1} of {protocol.insertions_per_specimen}"
    )
    session.ask(ShiftToHole(specimen.name, planned.hole, planned.hole_position_mm))
    session.record(
        SweepTrialStart(
            trial=trial,
            specimen=specimen.name,
            gelatin_percent=specimen.gelatin_percent,
            hole=planned.hole,
            hole_position_mm=planned.hole_position_mm,
            needle_id=protocol.needle.needle_id,
            repeats=planned.repeats,
        )
    )
    session.take_picture(SweepRole.HOLE, trial)
    session.rig.needle.mark_in_tissue(session.recorder.run_name)
    session.move("linear", sheath.depth_mm, sheath.speed_mm_s)
    session.take_picture(SweepRole.SHEATH, trial)
    pictures = _PicturesOnTheWay(session, trial, insertion.frame_every_mm, insertion.length_mm)
    session.move("insertion", insertion.length_mm, insertion.speed_mm_s, pictures)
    final_frame = session.take_picture(NeedleRole.FINAL, trial).frame
    for line in session.rig.truth():
        session.recorder.truth(trial=trial, **line)
    session.progress(
        done * total_s + insertion.length_mm / insertion.speed_mm_s, f"{specimen.name}, withdrawing"
    )
    session.move("insertion", 0.0, insertion.withdraw_speed_mm_s)
    session.move("linear", 0.0, sheath.speed_mm_s)
    session.rig.needle.mark_out()
    session.record(SweepTrialStop(trial=trial, exit_status="success", final_frame=final_frame))
    session.progress((done + 1) * total_s, f"{specimen.name}, insertion {planned.hole + 1} done")


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
