"""Pixels of a picture to mm in the steering plane, and back.

The map undoes the lens (the intrinsics, or one radial term fitted with the plane where there are none), applies one
homography, and bends rays at the gel's surface where a gel is stated. It holds for one plane only: without a stated gel
the graph paper must lie where the needle will be, at the needle's depth **in the same gel**. Left out, paper at needle
depth but in air makes radii too large by 0.3 to 2 %, paper on top of the gel makes them too small by 1 to 6 %.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import InputError
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.refraction import Gel

Insertion = Literal["right", "left", "up", "down"]

_FloatArray = NDArray[np.float64]

# Rows: where +y and +z of the steering plane point in the picture (u, v).
PICTURE_AXES: dict[Insertion, tuple[tuple[int, int], tuple[int, int]]] = {
    "right": ((0, -1), (1, 0)),
    "down": ((1, 0), (0, 1)),
    "left": ((0, 1), (-1, 0)),
    "up": ((-1, 0), (0, -1)),
}


_MAX_NEWTON_STEPS = 30
_RADIAL_TOLERANCE_PX = 1e-10


@dataclass(frozen=True)
class Radial:
    """One radial term of distortion, where no lens is known: an ideal pixel is c + (p - c) (1 + k |p - c|^2).

    Attributes
    ----------
    centre_px : (float, float)
    k_per_px2 : float
    """

    centre_px: tuple[float, float]
    k_per_px2: float

    def undistort_px(self, px: _FloatArray) -> _FloatArray:
        """Return the ideal pixels (N, 2)."""
        aside = px - self.centre_px
        return np.asarray(px + aside * (self.k_per_px2 * np.sum(aside**2, axis=1))[:, None])

    def distort_px(self, px: _FloatArray) -> _FloatArray:
        """Return where the lens puts ideal pixels (N, 2)."""
        wanted = np.hypot(*(px - self.centre_px).T)
        found = wanted.copy()
        for _ in range(_MAX_NEWTON_STEPS):
            missing = wanted - found * (1.0 + self.k_per_px2 * found**2)
            found = found + missing / np.maximum(1.0 + 3.0 * self.k_per_px2 * found**2, 0.1)
            if np.abs(missing).max(initial=0.0) <= _RADIAL_TOLERANCE_PX:
                break
        shrunk = found / np.maximum(wanted, np.finfo(float).tiny)
        return np.asarray(self.centre_px + (px - self.centre_px) * shrunk[:, None])


@dataclass(frozen=True, eq=False)
class Variation:
    """The map moved along one independent axis of what is uncertain in it, by one standard deviation.

    Attributes
    ----------
    homography : ndarray (3, 3)
    lens : tuple of float or None
        The lens's ten parameters; None where it is the map's own.
    """

    homography: _FloatArray
    lens: tuple[float, ...] | None


@dataclass(frozen=True)
class Bend:
    """Why crossings are off a plane: the sheet is bent. It explains residuals, and is no part of the map.

    Attributes
    ----------
    order : int
        Of the polynomial that the height is of the place on the sheet, chosen by the crossings left out.
    holdout_rms_mm : float
        Error of crossings that the fit did not see, with the bend.
    largest_shift_mm : float
        The most of a crossing's residual that it explains.
    largest_shift_px : (float, float)
        Where that is in the picture.
    height_mm, sigma_mm : float or None
        The highest crossing above the lowest one, over the best plane, and the standard deviation of that; None where
        no intrinsics say where the camera is: its place, one radial term and the height stand for one another then.
    highest_px, lowest_px : (float, float) or None
        Where these crossings are in the picture.
    """

    order: int
    holdout_rms_mm: float
    largest_shift_mm: float
    largest_shift_px: tuple[float, float]
    height_mm: float | None = None
    sigma_mm: float | None = None
    highest_px: tuple[float, float] | None = None
    lowest_px: tuple[float, float] | None = None

    def sentence(self) -> str:
        """Return it in words; without a lens's calibration it could also be the lens."""
        u, v = self.largest_shift_px
        moved = f"That moves its lines by up to {self.largest_shift_mm:.2f} mm, around ({u:.0f}, {v:.0f}) px."
        left_out = f"With it, crossings left out are predicted within {self.holdout_rms_mm:.3f} mm rms."
        if self.highest_px is None or self.lowest_px is None:
            return (
                "The sheet is bent, or the lens has more than one radial term; by how much it is bent, only the lens's "
                f"calibration would tell. {moved} {left_out}"
            )
        (a, b), (c, d) = self.highest_px, self.lowest_px
        return (
            f"The sheet is bent: at ({a:.0f}, {b:.0f}) px it is {self.height_mm:.2f} ± {self.sigma_mm:.2f} mm higher "
            f"over its best plane than at ({c:.0f}, {d:.0f}) px. {moved} {left_out}"
        )


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
    radial : Radial or None
        Fitted with the plane where no intrinsics were given.
    gel : Gel or None
        Bends the rays; None for a plane in air, or paper that lay in the same gel.
    flatness_mm : float or None
        How far the paper is from flat: the largest mean residual over a part of the picture.
    crossing_noise_mm : float or None
        How far a crossing is off on its own, rms, by the differences of neighbours: no fit gets below it.
    bend : Bend or None
        Why the crossings are off a plane, where a bent sheet explains it.
    variations : tuple of Variation
        What is uncertain in the map; the variance of any length is the sum of its squared changes over these.
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
    radial: Radial | None = None
    gel: Gel | None = None
    flatness_mm: float | None = None
    crossing_noise_mm: float | None = None
    bend: Bend | None = None
    variations: tuple[Variation, ...] = ()

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
        origin, direction = check_frame(origin_px, insertion)
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
        ideal = undistort(self.intrinsics or self.radial, _as_points(px, "pixels"))
        straight = apply_homography(self.homography, ideal)
        return straight if self.gel is None else self.gel.bent(straight, self.camera_mm())

    def to_px(self, mm: ArrayLike) -> _FloatArray:
        """Return pixels (N, 2) in a picture of points (N, 2) in the plane, columns (y, z) [mm]."""
        points = _as_points(mm, "points in the plane")
        straight = points if self.gel is None else self.gel.straight(points, self.camera_mm())
        ideal = apply_homography(np.linalg.inv(self.homography), straight)
        lens = self.intrinsics or self.radial
        return ideal if lens is None else lens.distort_px(ideal)

    def camera_mm(self) -> _FloatArray:
        """Return where the camera stands: its foot (y, z) on the paper's plane, and its height over it [mm].

        Raises
        ------
        InputError
            Without intrinsics: the homography alone does not say it.
        """
        if self.intrinsics is None:
            raise InputError(
                "a gel's refraction needs the camera's intrinsics", "calibrate them first: --intrinsics FILE"
            )
        return find_camera_mm(self.homography, self.intrinsics)

    def variants(self) -> "list[PlaneMap]":
        """Return the map moved along each independent axis of its uncertainty, one standard deviation each."""
        moved = []
        for one in self.variations:
            lens = self.intrinsics
            if lens is not None and one.lens is not None:
                lens = lens.with_parameters(one.lens)
            moved.append(replace(self, homography=one.homography, intrinsics=lens, variations=()))
        return moved

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
            "radial": None if self.radial is None else [*self.radial.centre_px, self.radial.k_per_px2],
            "gel": None if self.gel is None else vars(self.gel),
            "assumptions": [] if self.gel is None else list(self.gel.assumptions()),
            "flatness_mm": self.flatness_mm,
            "crossing_noise_mm": self.crossing_noise_mm,
            "bend": self.bend and {**vars(self.bend), "sentence": self.bend.sentence()},
            "variations": [
                {"homography": one.homography.tolist(), "lens": one.lens and list(one.lens)}
                for one in self.variations
            ],
        }


def _as_points(points: ArrayLike, what: str) -> _FloatArray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"{what} have shape {array.shape}, not (N, 2)", "one row per point")
    return array


def undistort(lens: Intrinsics | Radial | None, px: _FloatArray) -> _FloatArray:
    """Return ideal pixels (N, 2) of pixels (N, 2) in a picture; the same ones where no lens is known."""
    return px if lens is None else lens.undistort_px(px)


def find_camera_mm(homography: _FloatArray, lens: Intrinsics) -> _FloatArray:
    """Return where the camera stands (3,): its foot on the plane that a homography leads to, and its height [mm].

    Parameters
    ----------
    homography : ndarray (3, 3)
        From ideal pixels to the plane [mm].
    """
    pose = np.linalg.solve(lens.camera_matrix(), np.linalg.inv(homography))
    pose /= np.sqrt(np.linalg.norm(pose[:, 0]) * np.linalg.norm(pose[:, 1]))
    turn = np.column_stack((pose[:, 0], pose[:, 1], np.cross(pose[:, 0], pose[:, 1])))
    u, _, v = np.linalg.svd(turn)
    foot = -(u @ v).T @ pose[:, 2]
    return np.array([foot[0], foot[1], abs(foot[2])])


def apply_homography(homography: NDArray[np.floating], points: _FloatArray) -> _FloatArray:
    """Return points (N, 2) through a 3 x 3 homography."""
    homogeneous = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def check_frame(origin_px: tuple[float, float], insertion: str) -> tuple[tuple[float, float], Insertion]:
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
