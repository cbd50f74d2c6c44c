"""The steerability test of the paper, section V-B: insertions of one length without turning the bevel."""

from collections.abc import Mapping

from labrig.devices import (
    AxisReadback,
    ConfirmAxesAtZero,
    ConfirmNeedleOut,
    MountNeedle,
    PlaceSpecimen,
    ShiftToHole,
)
from labrig.experiments.plan import planned_moves
from labrig.experiments.session import Session
from labrig.protocol import Specimen, SteerabilityProtocol


def run_steerability(protocol: SteerabilityProtocol, session: Session) -> int:
    """Make every insertion of the sweep and return how many were made.

    A specimen after another is placed by the operator, and in it a hole after another; the bench has no lateral axis.
    """
    rig = session.rig
    if rig.state.needle_in_tissue is not False:
        session.ask(ConfirmNeedleOut(rig.state.doubt))
        rig.mark_needle_out()
    session.ask(MountNeedle(protocol.needle.needle_id))
    session.ask(ConfirmAxesAtZero())
    rig.reference_axes()
    session.move("rotation", protocol.insertion.bevel_roll_rad, rig.rotation.max_speed / 2)
    trial = 0
    for specimen in protocol.specimens:
        session.ask(PlaceSpecimen(specimen.name, specimen.gelatin_percent))
        for hole in range(protocol.insertions_per_specimen):
            _insert_once(protocol, specimen, hole, trial, session)
            trial += 1
    return trial


def _insert_once(
    protocol: SteerabilityProtocol, specimen: Specimen, hole: int, trial: int, session: Session
) -> None:
    """Sheath in, needle in with a picture every few mm, final picture, needle out along its path, sheath out."""
    total_s = sum(move.duration_s for move in planned_moves(protocol))
    insertion, sheath = protocol.insertion, protocol.sheath
    hole_position_mm = hole * protocol.hole_spacing_mm
    session.progress(
        trial * total_s, f"{specimen.name}, insertion {hole + 1} of {protocol.insertions_per_specimen}"
    )
    session.ask(ShiftToHole(specimen.name, hole, hole_position_mm))
    session.note(
        "trial_start",
        trial=trial,
        specimen=specimen.name,
        gelatin_percent=specimen.gelatin_percent,
        hole=hole,
        hole_position_mm=hole_position_mm,
        needle_id=protocol.needle.needle_id,
    )
    session.look("hole", trial)
    session.rig.mark_needle_in_tissue(session.recorder.run_name)
    session.move("linear", sheath.depth_mm, sheath.speed_mm_s)
    session.look("sheath", trial)
    pictures = _PicturesOnTheWay(session, trial, insertion.frame_every_mm, insertion.length_mm)
    session.move("insertion", insertion.length_mm, insertion.speed_mm_s, pictures)
    final_frame = session.look("final", trial)
    for line in session.rig.truth():
        session.recorder.truth(trial=trial, **line)
    session.progress(
        trial * total_s + insertion.length_mm / insertion.speed_mm_s, f"{specimen.name}, withdrawing"
    )
    session.move("insertion", 0.0, insertion.withdraw_speed_mm_s)
    session.move("linear", 0.0, sheath.speed_mm_s)
    session.rig.mark_needle_out()
    session.note("trial_stop", trial=trial, exit_status="success", final_frame=final_frame)
    session.progress((trial + 1) * total_s, f"{specimen.name}, insertion {hole + 1} done")


class _PicturesOnTheWay:
    """Takes a picture each time the needle has advanced by another `every_mm`, the end excepted."""

    def __init__(self, session: Session, trial: int, every_mm: float, length_mm: float) -> None:
        self._session = session
        self._trial = trial
        self._every_mm = every_mm
        self._length_mm = length_mm
        self._next_mm = every_mm

    def __call__(self, states: Mapping[str, AxisReadback]) -> None:
        if self._next_mm < self._length_mm and states["insertion"].position >= self._next_mm:
            self._session.look("advance", self._trial)
            self._next_mm += self._every_mm
