"""Steps of the operator before and after a run: confirm that the needle is out, and place the graph paper."""

from functools import partial

from labrig.analysis.sentinel import GridRole
from labrig.devices.operator import ClearBench, ConfirmNeedleOut, LayGraphPaper
from labrig.errors import CalibrationRefusedError
from labrig.protocol.sections import GridSentinel
from labrig.runner.session import Session
from labrig.vision.grid_check import check_grid, compare_grids
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap


def confirm_needle_out(session: Session) -> None:
    """Have the operator confirm that no needle is in tissue, unless the rig knows it.

    Raises
    ------
    SafetyStopError
        When the operator does not confirm.
    """
    if session.state.needle_in_tissue is not False:
        session.ask(ConfirmNeedleOut(session.state.doubt))
        session.mark_needle_out()


def photograph_grid(sentinel: GridSentinel | None, role: GridRole, session: Session) -> Picture | None:
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
    image = session.take_picture(role).image
    session.ask(ClearBench("the graph paper"))
    return image


def require_same_grid(
    before: Picture | None,
    after: Picture | None,
    sentinel: GridSentinel | None,
    plane: PlaneMap,
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
        session.compute(partial(check_grid, image, plane, sentinel.pitch_mm)) for image in (before, after)
    ]
    drift = compare_grids(*checks)
    if drift.reason is not None:
        raise CalibrationRefusedError(
            drift.reason.rstrip("."), "what was measured in this run is not stated; run it again"
        )
