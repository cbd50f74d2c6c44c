"""The steerability test of the paper, section V-B: insertions of one length without turning the bevel.

The operator places one specimen after another and shifts it from hole to hole: the bench has no lateral axis.
"""

from collections.abc import Iterator
from functools import partial

from labrig.analysis.sentinel import GridRole
from labrig.devices.operator import (
    ConfirmAxesAtZero,
    ConfirmUnchanged,
    MountNeedle,
    PlaceSpecimen,
    ShiftToHole,
)
from labrig.errors import FileFormatError, Problem
from labrig.experiments.shared.curvature import make_settings
from labrig.experiments.shared.holes import find_near_holes
from labrig.experiments.shared.needle_events import NeedleRole, SpecimenTrialStart, SpecimenTrialStop
from labrig.experiments.steerability.holes import (
    Hole,
    describe_place,
    find_another_hole,
    list_holes,
    sort_holes,
)
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.sections import TrackedSpecimen
from labrig.runner.graph_paper import photograph_grid
from labrig.runner.session import Session, TrialRun
from labrig.runner.sight import Sight
from labrig.runner.withdrawal import confirm_needle_out


def run(protocol: SteerabilityProtocol, session: Session) -> None:
    """Make every insertion of the sweep, or those that remain of it."""
    if problems := tuple(_find_near_holes(protocol)):
        raise FileFormatError(problems)
    for doubt in protocol.list_doubts():
        session.warn(doubt)
    sight = session.open_sight()
    confirm_needle_out(session)
    placed = _find_placed(protocol, session)
    if placed is None:
        session.ask(MountNeedle(protocol.needle.needle_id))
        session.ask(ConfirmAxesAtZero())
        session.reference_axes()
        session.move("rotation", protocol.insertion.bevel_roll_rad, session.axis("rotation").max_speed / 2)
    photograph_grid(protocol.sentinel, GridRole.BEFORE, session)
    trials = session.trials(
        list_holes(protocol), again=partial(find_another_hole, protocol), order=sort_holes(protocol)
    )
    for trial in trials:
        hole = trial.what
        place = f"gel {protocol.specimens.index(hole.specimen) + 1} of {len(protocol.specimens)}"
        session.tell_place(f"{describe_place(protocol, trial.number, hole, trial.repeats)}, {place}")
        with trial:
            if hole.specimen != placed:
                session.ask(PlaceSpecimen(hole.specimen.name, hole.specimen.gelatin_percent))
                placed = hole.specimen
            _insert(protocol, trial, session, sight)
    photograph_grid(protocol.sentinel, GridRole.AFTER, session)


def _find_near_holes(protocol: SteerabilityProtocol) -> Iterator[Problem]:
    """Yield planned holes that come too close to old ones."""
    for key, gel in protocol.gels.items():
        places_mm, diameter_mm = protocol.list_places_mm(gel), protocol.sheath.diameter_mm
        yield from find_near_holes(key, gel, places_mm, diameter_mm, protocol.last_place_mm)


def _find_placed(protocol: SteerabilityProtocol, session: Session) -> TrackedSpecimen | None:
    """Return the specimen in the frame if the operator of a resumed sweep confirms that all is as it was."""
    name = session.past.begun[-1].start.specimen if session.past.begun else ""
    specimen = next((specimen for specimen in protocol.specimens if specimen.name == name), None)
    if specimen is None or not session.stands_at_start():
        return None
    as_it_was = ConfirmUnchanged(session.run_name, protocol.needle.needle_id, name)
    return specimen if session.offer(as_it_was) else None


def _insert(protocol: SteerabilityProtocol, trial: TrialRun[Hole], session: Session, sight: Sight) -> None:
    """Sheath in, needle in with a picture every few mm, final picture, needle out along its path, sheath out."""
    insertion, sheath, hole, number = protocol.insertion, protocol.sheath, trial.what, trial.number
    specimen = hole.specimen

    def advance() -> None:
        inserted_mm = session.take_picture(NeedleRole.ADVANCE, number).positions.insertion_mm
        session.tell(f"{place}, inserted {inserted_mm:.0f} mm")

    place = f"{specimen.name}, {describe_place(protocol, trial.number, hole, trial.repeats)}"
    session.tell(place)
    session.ask(ShiftToHole(specimen.name, hole.number, hole.position_mm))
    session.record(
        SpecimenTrialStart(
            trial=number,
            specimen=specimen.name,
            gelatin_percent=specimen.gelatin_percent,
            hole=hole.number,
            hole_position_mm=hole.position_mm,
            needle_id=protocol.needle.needle_id,
            repeats=trial.repeats,
        )
    )
    session.take_picture(NeedleRole.HOLE, number)
    session.move("linear", sheath.depth_mm, sheath.speed_mm_s)
    session.take_picture(NeedleRole.SHEATH, number)
    stops_mm = insertion.list_stops_mm()
    session.move("insertion", insertion.length_mm, insertion.speed_mm_s, passing=stops_mm, then=advance)
    final = session.take_picture(NeedleRole.FINAL, number)
    session.record_truth(number)
    session.tell(f"{specimen.name}, withdrawing")
    session.move("insertion", 0.0, insertion.withdraw_speed_mm_s)
    session.move("linear", 0.0, sheath.speed_mm_s)
    if session.is_judged:
        # What only the whole run tells is not in it: a sheath that was elsewhere, and the drift of the camera.
        seen = session.compute(partial(sight.measure_radius, final, make_settings(protocol)))
        session.judge(number, {"radius_mm": seen.radius_mm, "radius_sd_mm": seen.sd_mm}, seen.reason)
    session.record(SpecimenTrialStop(trial=number, exit_status="success", final_frame=final.frame))
