"""Whether a plane map still holds: pictures of ruled paper before and after a run.

Through a valid plane map the paper has its own pitch in every direction. The deviation from that, as scales along two
axes and as distances of the crossings from an even grid, is compared before and after the run. The paper may be moved
in between, so its place and direction do not count; a camera that was bumped shows in scale and shape.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.errors import CalibrationRefusedError, MeasurementRefusedError
from labrig.vision.graph_paper import Crossings, find_crossings
from labrig.vision.picture import Picture, require_size
from labrig.vision.plane import PlaneMap
from labrig.vision.rounding import round_up

_LEAST_CROSSINGS = 60
# A crossing further off than this share of the pitch is a false detection.
_GROSS = 0.25
# Lines that can be counted instead of the finest, and how far off a map may be in between.
_MULTIPLES = (1, 2, 5, 10)
_LARGEST_SCALE_ERROR = 0.2
_LARGEST_DRIFT = 0.005
_LARGEST_BENDING_MM = 0.1


@dataclass(frozen=True)
class GridCheck:
    """Ruled paper seen through a plane map.

    Attributes
    ----------
    scale, other_scale : float
        Lengths through the map over true lengths: the largest and the least over all directions.
    residual_mm : float
        Rms distance of the crossings from an even grid with these scales.
    crossings : int
    """

    scale: float
    other_scale: float
    residual_mm: float
    crossings: int


@dataclass(frozen=True)
class GridDrift:
    """What changed between two checks.

    Attributes
    ----------
    relative : float
        Largest change of scale in any direction: the error bar of every length of the run.
    bending_mm : float
        Increase of the crossings' distance from an even grid.
    accepted : bool
    reason : str or None
    """

    relative: float
    bending_mm: float
    accepted: bool
    reason: str | None


def check_grid(image: Picture, plane: PlaneMap, pitch_mm: float) -> GridCheck:
    """Measure ruled paper of a known pitch through a plane map.

    Raises
    ------
    CalibrationRefusedError
        If too little of the paper is visible.
    PictureError
        If the picture has another size than the map is for.
    """
    require_size(image, plane.image_size, "the plane map")
    try:
        found = find_crossings(image)
        seen = plane.to_mm(found.pixels)
    except MeasurementRefusedError as refusal:
        raise CalibrationRefusedError(refusal.message, refusal.hint) from refusal
    numbers = found.indices * _find_multiple(found, seen, pitch_mm)
    design = np.column_stack((numbers * float(pitch_mm), np.ones(len(seen))))
    kept = np.ones(len(seen), dtype=bool)
    for _ in range(3):
        affine = np.linalg.lstsq(design[kept], seen[kept], rcond=None)[0]
        off = np.hypot(*(design @ affine - seen).T)
        kept = off < _GROSS * found.step * pitch_mm
        if kept.sum() < _LEAST_CROSSINGS:
            raise CalibrationRefusedError(
                f"{kept.sum()} crossings of ruled lines, {_LEAST_CROSSINGS} are needed",
                "show more of the paper",
            )
    largest, least = np.linalg.svd(affine[:2], compute_uv=False)
    return GridCheck(float(largest), float(least), float(np.sqrt(np.mean(off[kept] ** 2))), int(kept.sum()))


def _find_multiple(found: Crossings, seen_mm: NDArray[np.float64], pitch_mm: float) -> int:
    """Return how many of the paper's lines there are from one counted line to the next, by the map.

    The map is not off by a factor of two; the counted lines can be heavier ones, with unseen ones between them.

    Raises
    ------
    CalibrationRefusedError
        If the lines through the map are no multiple of the pitch apart.
    """
    design = np.column_stack((found.indices, np.ones(len(seen_mm))))
    affine = np.linalg.lstsq(design, seen_mm, rcond=None)[0]
    spacing_mm = float(np.mean(np.linalg.svd(affine[:2], compute_uv=False)))
    multiple = max(round(spacing_mm / pitch_mm), 1)
    if multiple not in _MULTIPLES or abs(spacing_mm / (multiple * pitch_mm) - 1.0) > _LARGEST_SCALE_ERROR:
        raise CalibrationRefusedError(
            f"the lines of the paper are {spacing_mm:.2f} mm apart through the plane map, not {pitch_mm:g} mm",
            "check the paper's pitch; if it is right, the camera has moved: calibrate the plane again",
        )
    return multiple


def compare_grids(before: GridCheck, after: GridCheck) -> GridDrift:
    """Return what changed; refused if the change is too large for an error bar."""
    drift = max(abs(after.scale / before.scale - 1.0), abs(after.other_scale / before.other_scale - 1.0))
    bending = float(np.sqrt(max(after.residual_mm**2 - before.residual_mm**2, 0.0)))
    reason = None
    if drift > _LARGEST_DRIFT:
        reason = (
            f"Lengths changed by {round_up(100.0 * drift, 2)} % between the grid pictures before and after the run, "
            f"and {100.0 * _LARGEST_DRIFT:g} % is the most: the camera was bumped; calibrate the plane again."
        )
    elif bending > _LARGEST_BENDING_MM:
        reason = (
            f"The grid after the run is {round_up(bending, 2)} mm out of shape, and {_LARGEST_BENDING_MM:g} mm is the "
            "most: the camera was tilted, or the paper is bent; calibrate the plane again."
        )
    return GridDrift(drift, bending, reason is None, reason)
