"""Graph paper that the operator lays into the steering plane before and after a run."""

from functools import partial

from labrig.analysis.sentinel import GridRole
from labrig.devices.operator import ClearBench, LayGraphPaper
from labrig.errors import CalibrationRefusedError
from labrig.protocol.sections import GridSentinel
from labrig.runner.session import Session
from labrig.runner.sight import Sight, TakenPicture
from labrig.runner.withdrawal import confirm_needle_out
from labrig.vision.plane_check import compare_grids


def photograph_grid(sentinel: GridSentinel | None, role: GridRole, session: Session) -> TakenPicture | None:
    """Photograph graph paper in the steering plane, if the protocol asks for it; no needle is in tissue then.

    Raises
    ------
    SafetyStopError
        When the operator does not confirm.
    """
    if sentinel is None:
        return None
    confirm_needle_out(session)
    session.ask(LayGraphPaper(sentinel.pitch_mm))
    taken = session.take_picture(role)
    session.ask(ClearBench("the graph paper"))
    return taken


def require_same_grid(
    before: TakenPicture | None,
    after: TakenPicture | None,
    sentinel: GridSentinel | None,
    sight: Sight,
    session: Session,
) -> None:
    """Refuse a run whose pictures of the paper differ by more than an error bar can cover.

    Raises
    ------
    CalibrationRefusedError
        When the camera was bumped between the pictures, or one of them does not show the paper.
    """
    if sentinel is None or before is None or after is None:
        return
    checks = [
        session.compute(partial(sight.check_grid, taken, sentinel.pitch_mm)) for taken in (before, after)
    ]
    drift = compare_grids(*checks)
    if drift.reason is not None:
        raise CalibrationRefusedError(
            drift.reason.rstrip("."), "what was measured in this run is not stated; run it again"
        )
