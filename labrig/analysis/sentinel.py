"""Grid pictures before and after a run: an error bar for its lengths, or the reason to refuse them."""

from collections.abc import Iterable

from labrig.analysis.origin import ReadFrame
from labrig.analysis.result import Sentinel
from labrig.errors import CalibrationRefusedError, PictureError, RecordError
from labrig.protocol.sections import GridSentinel
from labrig.record.events import FrameLine, PictureRole
from labrig.vision.plane import PlaneMap
from labrig.vision.plane_fit import check_grid, compare_grids


class GridRole(PictureRole):
    """Pictures of the graph paper in the steering plane."""

    BEFORE = "grid-before"
    AFTER = "grid-after"


def check_sentinel(
    section: GridSentinel | None, read: ReadFrame, lines: Iterable[FrameLine], plane: PlaneMap
) -> Sentinel | None:
    """Compare the grid pictures of a run; None if its protocol asks for none."""
    return None if section is None else compare_grid_pictures(read, lines, plane, section.pitch_mm)


def compare_grid_pictures(
    read: ReadFrame, lines: Iterable[FrameLine], plane: PlaneMap, pitch_mm: float
) -> Sentinel:
    """Compare the first grid picture before the run with the last one after it.

    Parameters
    ----------
    read : callable
        Returns the picture of a frame number.
    lines : iterable of FrameLine
        Lines of a run; other roles are skipped.
    """
    frames: dict[str, list[int]] = {role: [] for role in GridRole}
    for line in lines:
        frames.get(line.role or "", []).append(line.frame)
    if not all(frames.values()):
        return Sentinel(
            view=plane.view_sentence(),
            accepted=True,
            reason="There is no grid picture both before and after the run.",
        )
    try:
        before, after = (
            check_grid(read(frame), plane, pitch_mm)
            for frame in (frames[GridRole.BEFORE][0], frames[GridRole.AFTER][-1])
        )
    except (CalibrationRefusedError, PictureError, RecordError) as refusal:
        why = f"The grid pictures cannot be compared: {refusal.message}."
        return Sentinel(view=plane.view_sentence(), accepted=False, reason=why)
    drift = compare_grids(before, after)
    return Sentinel(
        drift=drift.relative,
        bending_mm=drift.bending_mm,
        scale_before=before.scale,
        scale_after=after.scale,
        view=plane.view_sentence(),
        accepted=drift.accepted,
        reason=drift.reason,
    )
