"""Pixels of a picture to mm in the steering plane, and back.

The map undoes the lens (where intrinsics are given) and then applies one homography. It holds for one plane
only: the graph paper must lie where the needle will be, at the needle's depth **in the same gel**. Refraction
is not modelled: paper at needle depth but in air makes radii too large by 0.3 to 2 %, paper on top of the gel
makes them too small by 1 to 6 %.
"""

from dataclasses import dataclass
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import InputError
from labrig.vision.intrinsics import Intrinsics

Insertion = Literal["right", "left", "up", "down"]

_FloatArray = NDArray[np.float64]

# Rows: where +y and +z of the steering plane point in the picture (u, v).
PICTURE_AXES: dict[Insertion, tuple[tuple[int, int], tuple[int, int]]] = {
    "right": ((0, -1), (1, 0)),
    "down": ((1, 0), (0, 1)),
    "left": ((0, 1), (-1, 0)),
    "up": ((-1, 0), (0, -1)),
}


@dataclass(frozen=True, eq=False)
class PlaneMap:
    """The map between a picture and the steering plane, with the evidence for it.

    Attributes
    ----------
    homography : ndarray (3, 3)
        From homogeneous ideal pixels (u, v, 1) to homogeneous (y, z, 1) [mm].
    intrinsics : Intrinsics or None
        The lens; None takes pixels as they are.
    origin_px : (float, float)
        The pixel, in the picture, that is (0, 0) mm.
    insertion : "right", "left", "up" or "down"
        Where the insertion points in the picture, within 45 degrees.
    image_size : (int, int) or None
        Width and height [px] of the pictures it holds for; None where that is not known.
    mm_per_px : float
        Square root of the area of the pixel at the origin.
    rms_mm, worst_mm : float or None
        Distances between the paper's crossings and their fitted places; None for a stated scale.
    holdout_rms_mm : float or None
        The same for crossings that the fit did not see.
    residual_field_mm : tuple of 3 x 3 floats or None
        `rms_mm` in the ninths of the picture, row by row, None where nothing was found: paper is not flat,
        and this is where it is not.
    crossings : int
        How many crossings of the paper's lines were fitted.
    accepted : bool
    reasons : tuple of str
        Why not, each with what to do.
    """

    homography: _FloatArray
    intrinsics: Intrinsics | None
    origin_px: tuple[float, float]
    insertion: Insertion
    image_size: tuple[int, int] | None
    mm_per_px: float
    rms_mm: float | None = None
    worst_mm: float | None = None
    holdout_rms_mm: float | None = None
    residual_field_mm: tuple[tuple[float | None, ...], ...] | None = None
    crossings: int = 0
    accepted: bool = True
    reasons: tuple[str, ...] = ()

    @classmethod
    def from_scale(
        cls,
        px_per_mm: float,
        origin_px: tuple[float, float],
        insertion: Insertion,
        image_size: tuple[int, int] | None = None,
    ) -> Self:
        """Make the map of pictures that are rectified already: one scale, no lens.

        Raises
        ------
        InputError
            If the scale is not positive, the origin not finite, or the direction unknown.
        """
        if not (np.isfinite(px_per_mm) and px_per_mm > 0.0):
            raise InputError(f"scale is {px_per_mm} px/mm, not a positive number", "count between two marks")
        origin, direction = checked_frame(origin_px, insertion)
        turn = np.array(PICTURE_AXES[direction]) / px_per_mm
        homography = np.eye(3)
        homography[:2, :2] = turn
        homography[:2, 2] = -turn @ np.asarray(origin)
        return cls(homography, None, origin, direction, image_size, 1.0 / px_per_mm)

    def to_mm(self, px: ArrayLike) -> _FloatArray:
        """Return points (N, 2) in the plane, columns (y, z) [mm], of pixels (N, 2) in a picture.

        Raises
        ------
        MeasurementRefusedError
            If the lens model cannot be inverted at a pixel.
        """
        array = _as_points(px, "pixels")
        return projected(
            self.homography, array if self.intrinsics is None else self.intrinsics.undistort_px(array)
        )

    def to_px(self, mm: ArrayLike) -> _FloatArray:
        """Return pixels (N, 2) in a picture of points (N, 2) in the plane, columns (y, z) [mm]."""
        ideal = projected(np.linalg.inv(self.homography), _as_points(mm, "points in the plane"))
        return ideal if self.intrinsics is None else self.intrinsics.distort_px(ideal)

    def to_json(self) -> dict[str, Any]:
        """Return the document that `labrig calibrate plane --json` prints; what is unknown is None."""
        return {
            "accepted": self.accepted,
            "reasons": list(self.reasons),
            "rms_mm": self.rms_mm,
            "worst_mm": self.worst_mm,
            "holdout_rms_mm": self.holdout_rms_mm,
            "mm_per_px": self.mm_per_px,
            "residual_field_mm": self.residual_field_mm and [list(row) for row in self.residual_field_mm],
            "crossings": self.crossings,
            "image_size": None if self.image_size is None else list(self.image_size),
            "origin_px": list(self.origin_px),
            "insertion": self.insertion,
            "homography": self.homography.tolist(),
        }


def _as_points(points: ArrayLike, what: str) -> _FloatArray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"{what} have shape {array.shape}, not (N, 2)", "one row a point")
    return array


def undistorted(intrinsics: Intrinsics | None, px: _FloatArray) -> _FloatArray:
    """Return ideal pixels (N, 2) of pixels (N, 2) in a picture; the same ones where no lens is known."""
    return px if intrinsics is None else intrinsics.undistort_px(px)


def projected(homography: NDArray[np.floating], points: _FloatArray) -> _FloatArray:
    """Return points (N, 2) through a 3 x 3 homography."""
    homogeneous = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def checked_frame(origin_px: tuple[float, float], insertion: str) -> tuple[tuple[float, float], Insertion]:
    """Return origin and direction of a steering plane frame, or raise InputError naming what is wrong."""
    for known in get_args(Insertion):
        if insertion == known:
            break
    else:
        raise InputError(
            f"insertion {insertion!r} is no direction", f"one of {', '.join(get_args(Insertion))}"
        )
    u, v = origin_px
    if not (np.isfinite(u) and np.isfinite(v)):
        raise InputError(f"origin ({u}, {v}) px is not finite", "give the pixel that is to be (0, 0) mm")
    return (float(u), float(v)), known
