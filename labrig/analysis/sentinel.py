"""Grid pictures before and after a run: an error bar for its lengths, or the reason why they are refused."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from labrig.analysis.origin import ReadFrame
from labrig.analysis.result import PictureResult, Sentinel
from labrig.errors import CalibrationRefusedError, PictureError, RecordError
from labrig.protocol.insertion import InsertionProtocol, RollZeroProtocol
from labrig.protocol.load import AnyProtocol
from labrig.protocol.protocols import SteerabilityProtocol
from labrig.vision.grid_check import GridCheck, check_grid, compare_grids
from labrig.vision.plane import PlaneMap

BEFORE_ROLE, AFTER_ROLE = "grid-before", "grid-after"
_TWO_SIDED_95 = 1.96


def sentinel_of(
    protocol: AnyProtocol, read: ReadFrame, lines: Iterable[Mapping[Any, Any]], plane: PlaneMap
) -> Sentinel | None:
    """Return what the grid pictures of a run say, as `watch` does; None where its protocol asks for none."""
    if not isinstance(protocol, SteerabilityProtocol | InsertionProtocol | RollZeroProtocol):
        return None
    if protocol.sentinel is None:
        return None
    return watch(read, lines, plane, protocol.sentinel.pitch_mm)


def watch(read: ReadFrame, lines: Iterable[Mapping[Any, Any]], plane: PlaneMap, pitch_mm: float) -> Sentinel:
    """Compare the first grid picture before the run with the last one after it.

    Parameters
    ----------
    read : callable
        Gives the picture of a frame number.
    lines : iterable of Mapping
        Of frames.jsonl; those of another role are passed over.
    """
    frames: dict[str, list[int]] = {BEFORE_ROLE: [], AFTER_ROLE: []}
    for line in lines:
        frames.get(line["role"], []).append(int(line["frame"]))
    if not frames[BEFORE_ROLE] or not frames[AFTER_ROLE]:
        return Sentinel(accepted=True, reason="There is no grid picture both before and after the run.")
    try:
        before, after = (
            check_grid(read(frame), plane, pitch_mm)
            for frame in (frames[BEFORE_ROLE][0], frames[AFTER_ROLE][-1])
        )
    except (CalibrationRefusedError, PictureError, RecordError) as refusal:
        return Sentinel(accepted=False, reason=f"The grid pictures cannot be compared: {refusal.message}.")
    return _sentinel(before, after)


def _sentinel(before: GridCheck, after: GridCheck) -> Sentinel:
    drift = compare_grids(before, after)
    return Sentinel(
        drift=drift.relative,
        bending_mm=drift.bending_mm,
        scale_before=before.scale,
        scale_after=after.scale,
        accepted=drift.accepted,
        reason=drift.reason,
    )


def watched(results: Sequence[PictureResult], sentinel: Sentinel | None) -> tuple[PictureResult, ...]:
    """Return the pictures with the drift in their error bars, or refused."""
    if sentinel is None:
        return tuple(results)
    if not sentinel.accepted:
        refused = {"accepted": False, "reason": sentinel.reason}
        return tuple(one.model_copy(update=refused) if one.accepted else one for one in results)
    return tuple(_widened(one, sentinel.drift or 0.0) for one in results)


def _widened(one: PictureResult, drift: float) -> PictureResult:
    """Return a picture whose radius may be off by the drift as well, taken as one standard deviation."""
    if one.radius_mm is None or one.sigma_radius_mm is None or not drift:
        return one
    more = drift * one.radius_mm
    update: dict[str, object] = {"sigma_radius_mm": float(np.hypot(one.sigma_radius_mm, more))}
    if one.radius_ci95_mm is not None:
        low, high = (abs(end - one.radius_mm) for end in one.radius_ci95_mm)
        reach = _TWO_SIDED_95 * more
        update["radius_ci95_mm"] = (
            one.radius_mm - float(np.hypot(low, reach)),
            one.radius_mm + float(np.hypot(high, reach)),
        )
    return one.model_copy(update=update)
