"""Grid pictures before and after a run: an error bar for its lengths, or the reason to refuse them."""

from collections.abc import Sequence

from labrig.analysis.origin import ReadFrame
from labrig.analysis.result import Sentinel
from labrig.errors import CalibrationRefusedError, PictureError, RecordError
from labrig.protocol.sections import GridSentinel
from labrig.record.events import FrameLine, PictureRole
from labrig.vision.plane import PlaneMap
from labrig.vision.plane_check import check_grid, compare_grids


class GridRole(PictureRole):
    """Pictures of the graph paper in the steering plane."""

    BEFORE = "grid-before"
    AFTER = "grid-after"


def check_sentinel(
    section: GridSentinel | None, read: ReadFrame, lines: Sequence[FrameLine], plane: PlaneMap
) -> Sentinel | None:
    """Compare the grid pictures of a run; None if its protocol asks for none."""
    return None if section is None else compare_grid_pictures(read, lines, plane, section.pitch_mm)


def compare_grid_pictures(
    read: ReadFrame, lines: Sequence[FrameLine], plane: PlaneMap, pitch_mm: float
) -> Sentinel:
    """Compare the first grid picture before the run with the last one after it.

    Parameters
    ----------
    read : callable
        Returns the picture of a frame number.
    lines : sequence of FrameLine
        Lines of a run; other roles are skipped.
    """
    of_role = {role: [line.frame for line in lines if line.role == role] for role in GridRole}
    view = plane.view_sentence()
    if not all(of_role.values()):
        why = "There is no grid picture both before and after the run."
        return Sentinel(view=view, accepted=True, reason=why)
    try:
        before = check_grid(read(of_role[GridRole.BEFORE][0]), plane, pitch_mm)
        after = check_grid(read(of_role[GridRole.AFTER][-1]), plane, pitch_mm)
    except (CalibrationRefusedError, PictureError, RecordError) as refusal:
        why = f"The grid pictures cannot be compared: {refusal.message}."
        return Sentinel(view=view, accepted=False, reason=why)
    drift = compare_grids(before, after)
    return Sentinel(
        drift=drift.relative,
        bending_mm=drift.bending_mm,
        scale_before=before.scale,
        scale_after=after.scale,
        view=view,
        accepted=drift.accepted,
        reason=drift.reason,
    )
