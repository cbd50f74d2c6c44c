"""Ruled paper seen through a plane map: whether the camera was moved since the map was made, or during a run.

Through a valid map ruled paper has its own pitch in every direction. The deviation from that, as scales along two axes
and as distances of the points from an even grid, is compared before and after a run. The paper may be moved in between,
so its place and direction do not count; a camera that was bumped shows in scale and shape. A map whose scale the paper
contradicts is refused: the camera was moved since it was made.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from labrig.errors import CalibrationRefusedError, MeasurementRefusedError
from labrig.text import round_up
from labrig.vision.paper import find_paper
from labrig.vision.picture import Picture, require_size
from labrig.vision.plane import PlaneMap

# Limits of a check through a map with ruled paper: points, and how far the map may be off: paper is true to 0.5 %, and
# paper in air where the map was made behind gel to 2 %. A point further off than this share of the pitch is false.
_LEAST_CHECKED, _LARGEST_DEVIATION, _GROSS = 24, 0.03, 0.25
_CALIBRATE_AGAIN = (
    "measure the lines of the paper with a ruler; if they are as stated, the camera was moved since the plane was "
    "calibrated: calibrate the plane again"
)
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
        Rms distance of the points from an even grid with these scales.
    """

    scale: float
    other_scale: float
    residual_mm: float


@dataclass(frozen=True)
class GridDrift:
    """What changed between two checks.

    Attributes
    ----------
    relative : float
        Largest change of scale in any direction: the error bar of every length of the run.
    bending_mm : float
        Increase of the points' distance from an even grid.
    reason : str or None
        Why the change is too large for an error bar.
    """

    relative: float
    bending_mm: float
    reason: str | None

    @property
    def accepted(self) -> bool:
        """Whether an error bar covers the change."""
        return self.reason is None


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
    # The paper lies as when the plane was calibrated, in air; the gel comes afterwards.
    on_paper = plane.at_paper()
    middle = 0.5 * image.shape[1], 0.5 * image.shape[0]
    try:
        found = find_paper(image, pitch_mm / on_paper.mm_per_px_at(middle))
        seen = on_paper.to_mm(found.pixels)
    except MeasurementRefusedError as refusal:
        raise CalibrationRefusedError(refusal.message, _CALIBRATE_AGAIN) from refusal
    # OpenCV's sampling has a fixed seed of its own.
    affine, inside = cv2.estimateAffine2D(
        found.lines * float(pitch_mm), seen, ransacReprojThreshold=_GROSS * pitch_mm
    )
    kept = np.ravel(inside) > 0
    if affine is None or kept.sum() < _LEAST_CHECKED:
        raise CalibrationRefusedError(
            f"{kept.sum()} points of ruled lines, {_LEAST_CHECKED} are needed", "show more of the paper"
        )
    off = np.hypot(*(found.lines[kept] * pitch_mm @ affine[:, :2].T + affine[:, 2] - seen[kept]).T)
    largest, least = np.linalg.svd(affine[:, :2], compute_uv=False)
    return GridCheck(float(largest), float(least), float(np.sqrt(np.mean(off**2))))


def compare_grids(before: GridCheck, after: GridCheck) -> GridDrift:
    """Return what changed; refused if the change is too large for an error bar."""
    drift = max(abs(after.scale / before.scale - 1.0), abs(after.other_scale / before.other_scale - 1.0))
    bending = float(np.sqrt(max(after.residual_mm**2 - before.residual_mm**2, 0.0)))
    scale = max((before.scale, before.other_scale), key=lambda length: abs(length - 1.0))
    reason = None
    if abs(scale - 1.0) > _LARGEST_DEVIATION:
        reason = (
            f"Lengths on the graph paper before the run are {scale:.3f} times the true ones through the plane map, and "
            f"{100.0 * _LARGEST_DEVIATION:g} % off is the most: the camera was moved since the plane was calibrated, "
            "or the paper lay higher or lower then; calibrate the plane again."
        )
    elif drift > _LARGEST_DRIFT:
        reason = (
            f"Lengths changed by {round_up(100.0 * drift, 2)} % between the grid pictures before and after the run, "
            f"and {100.0 * _LARGEST_DRIFT:g} % is the most: the camera was bumped; calibrate the plane again."
        )
    elif bending > _LARGEST_BENDING_MM:
        reason = (
            f"The grid after the run is {round_up(bending, 2)} mm out of shape, and {_LARGEST_BENDING_MM:g} mm is the "
            "most: the camera was tilted, or the paper is bent; calibrate the plane again."
        )
    return GridDrift(drift, bending, reason)
