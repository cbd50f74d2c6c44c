"""Pixels of a picture to mm in the steering plane, and back.

The map undoes the lens (by the intrinsics, or by one radial term fitted with the plane), applies one homography, and
refracts rays at the surfaces of a stated gel and of the walls before it. It holds for one plane only: without a stated
gel the graph paper must lie where the needle will be, at the needle's depth **in the same gel**. Otherwise, paper at
needle depth but in air makes radii 0.3 to 2 % too large, and paper on top of the gel makes them 1 to 6 % too small; 5
mm of glass left out make them 0.9 % too large.

The map of a telecentric lens is affine. Its rays are parallel, so a gel shifts them and changes no scale.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.intrinsics import Intrinsics, undistort_by_each
from labrig.vision.refraction import Gel, GelMeasurement

Insertion = Literal["right", "left", "up", "down"]
VariationGroup = Literal["lens", "plane", "surface"]

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
    """One radial term of distortion for an unknown lens: an ideal pixel is c + (p - c) (1 + k |p - c|^2).

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
        """Return the pixels (N, 2) in a picture of ideal pixels (N, 2)."""
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
    """The map moved by one standard deviation along one independent axis of its uncertainty.

    Attributes
    ----------
    homography : ndarray (3, 3)
    lens : tuple of float or None
        The lens's parameters; None for the map's own lens.
    group : "lens", "plane" or "surface"
        What is uncertain: the lens; the paper's crossings and its bend; or the gel and the walls before the needle.
    gel : Gel or None
        None for the map's own gel.
    """

    homography: _FloatArray
    lens: tuple[float, ...] | None
    group: VariationGroup
    gel: Gel | None = None


@dataclass(frozen=True)
class Bend:
    """A bend of the sheet that explains why crossings are off a plane. It is no part of the map.

    Attributes
    ----------
    order : int
        Order of the polynomial for the height over the sheet, chosen by the error of crossings left out.
    holdout_rms_mm : float
        Error of crossings left out of the fit, with the bend.
    largest_shift_mm : float
        The largest part of a crossing's residual that the bend explains.
    largest_shift_px : (float, float)
        Pixel of that crossing.
    height_mm, sigma_mm : float or None
        Height of the highest crossing above the lowest, relative to the best plane, and its standard deviation; None
        without intrinsics, because camera place, radial term and height then have the same effect.
    highest_px, lowest_px : (float, float) or None
        Pixels of these crossings.
    gel_depth_mm : float or None
        Depth of gel under which a flat sheet would look like this one; None if none would, or without intrinsics.
    """

    order: int
    holdout_rms_mm: float
    largest_shift_mm: float
    largest_shift_px: tuple[float, float]
    height_mm: float | None = None
    sigma_mm: float | None = None
    highest_px: tuple[float, float] | None = None
    lowest_px: tuple[float, float] | None = None
    gel_depth_mm: float | None = None

    def sentence(self) -> str:
        """Return the bend in words; without intrinsics the lens could be the cause as well."""
        u, v = self.largest_shift_px
        moved = f"That moves its lines by up to {self.largest_shift_mm:.2f} mm, around ({u:.0f}, {v:.0f}) px."
        left_out = f"With it, crossings left out are predicted within {self.holdout_rms_mm:.3f} mm rms."
        if self.highest_px is None or self.lowest_px is None:
            return (
                "The sheet is bent, or the lens has more than one radial term; by how much it is bent, only the lens's "
                f"calibration would tell. {moved} {left_out}"
            )
        (a, b), (c, d) = self.highest_px, self.lowest_px
        gel = "" if self.gel_depth_mm is None else f", or lies flat under {self.gel_depth_mm:.1f} mm of gel"
        return (
            f"The sheet is bent{gel}: at ({a:.0f}, {b:.0f}) px it is {self.height_mm:.2f} ± {self.sigma_mm:.2f} mm "
            f"higher over its best plane than at ({c:.0f}, {d:.0f}) px. {moved} {left_out}"
        )


@dataclass(frozen=True, eq=False)
class PlaneMap:
    """The map between a picture and the steering plane, with the evidence for it.

    Attributes
    ----------
    homography : ndarray (3, 3)
        From homogeneous ideal pixels (u, v, 1) to homogeneous (y, z, 1) [mm].
    intrinsics : Intrinsics or None
        The lens; None if it is unknown, or the picture is rectified.
    origin_px : (float, float)
        The pixel of the picture at (0, 0) mm.
    insertion : "right", "left", "up" or "down"
        Direction of the insertion in the picture, within 45 degrees.
    image_size : (int, int) or None
        Width and height [px] of the pictures that the map holds for; None if unknown.
    mm_per_px : float
        Square root of the area of the pixel at the origin.
    rms_mm, worst_mm : float or None
        Distances between the paper's crossings and their fitted places; None for a stated scale.
    holdout_rms_mm : float or None
        The same for crossings left out of the fit.
    residual_field_mm : tuple of 3 x 3 floats or None
        `rms_mm` in the ninths of the picture, row by row: it shows where the paper is not flat. None for a ninth
        without crossings.
    crossings : int
        Number of fitted crossings of the paper's lines.
    accepted : bool
    reasons : tuple of str
        Why the map is not accepted, each with what to do.
    radial : Radial or None
        Fitted with the plane if there are no intrinsics.
    gel : Gel or None
        Refracts the rays; None for a plane in air, or if the paper lay in the same gel.
    flatness_mm : float or None
        Deviation of the paper from flat: the largest median residual of a part of the picture.
    crossing_noise_mm : float or None
        Rms noise of a single crossing, from the differences of neighbours: no fit gets below it.
    bend : Bend or None
        Explains why the crossings are off a plane; None if a bent sheet does not.
    variations : tuple of Variation
        The map's uncertainty: the variance of any length is the sum of its squared changes over these.
    paper_sigma_mm : float or None
        Standard deviation of the paper's height over the needle's plane; None if it is not known.
    gel_measurement : GelMeasurement or None
        What paper seen through the gel said about it.
    telecentric : bool
        The lens is telecentric: its rays are parallel and perpendicular to the paper, and the homography is affine.
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
    telecentric: bool = False
    gel_measurement: GelMeasurement | None = None
    paper_sigma_mm: float | None = None

    @classmethod
    def from_scale(
        cls,
        px_per_mm: float,
        origin_px: tuple[float, float],
        insertion: Insertion,
        image_size: tuple[int, int] | None = None,
    ) -> Self:
        """Make the map of rectified pictures: one scale, no lens.

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
        return self.ideal_to_mm(undistort(self.intrinsics or self.radial, _as_points(px, "pixels")))

    def ideal_to_mm(self, ideal: _FloatArray) -> _FloatArray:
        """Return points (N, 2) in the plane [mm] of pixels (N, 2) from which the lens's distortion has been taken."""
        straight = apply_homography(self.homography, ideal)
        return straight if self.gel is None else self.gel.bend(straight, self.camera_centre())

    def to_px(self, mm: ArrayLike) -> _FloatArray:
        """Return pixels (N, 2) in a picture of points (N, 2) in the plane, columns (y, z) [mm]."""
        points = _as_points(mm, "points in the plane")
        straight = points if self.gel is None else self.gel.straighten(points, self.camera_centre())
        ideal = apply_homography(np.linalg.inv(self.homography), straight)
        lens = self.intrinsics or self.radial
        return ideal if lens is None else lens.distort_px(ideal)

    def to_pixel(self, place_mm: tuple[float, float]) -> tuple[float, float]:
        """Return the pixel (u, v) of a point (y, z) in the plane [mm]."""
        u, v = self.to_px([place_mm])[0].tolist()
        return u, v

    def camera_mm(self) -> _FloatArray:
        """Return the place of the camera (3,) [mm]: its foot (y, z) on the paper's plane, and its height above it.

        Raises
        ------
        InputError
            Without intrinsics, because the homography alone does not determine it; with a telecentric lens, which has
            no such place.
        """
        if self.telecentric:
            raise InputError(
                "a telecentric lens has no distance from the paper: its rays are parallel",
                "use a lens with perspective, and its intrinsics, where the camera's place is needed",
            )
        if self.intrinsics is None:
            raise InputError(
                "a gel's refraction needs the camera's intrinsics", "calibrate them first: --intrinsics FILE"
            )
        return find_camera_mm(self.homography, self.intrinsics)

    def mm_per_px_at(self, px: tuple[float, float]) -> float:
        """Return the square root of the area [mm] of a pixel of the picture."""
        sides = np.asarray(px) + 0.5 * np.array([(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)])
        left, right, top, bottom = self.to_mm(sides)
        return float(np.sqrt(np.abs(np.linalg.det(np.array([right - left, bottom - top])))))

    def at_paper(self) -> "PlaneMap":
        """Return the map to the paper as it was calibrated: through the gel only if the paper lay in it."""
        return self if self.gel is None or self.gel.paper == "gel" else replace(self, gel=None)

    @property
    def picture_mm(self) -> tuple[float, float] | None:
        """Width and height of the picture on the paper, through its middle [mm]; None without the picture's size."""
        places = self._find_middle_lines_mm()
        if places is None:
            return None
        left, right, top, bottom, _ = places
        return float(np.linalg.norm(right - left)), float(np.linalg.norm(bottom - top))

    @property
    def camera_distance_mm(self) -> float | None:
        """Distance of the camera from the middle of the picture on the paper [mm]; None without intrinsics."""
        places = self._find_middle_lines_mm()
        if places is None or self.intrinsics is None:
            return None
        return float(np.linalg.norm(self.camera_mm() - (*places[-1], 0.0)))

    def _find_middle_lines_mm(self) -> _FloatArray | None:
        """Return the ends of the picture's middle row and column, and its middle, on the paper (5, 2)."""
        if self.image_size is None:
            return None
        right, down = np.array(self.image_size, dtype=np.float64) - 1.0
        ends = [
            (0.0, down / 2),
            (right, down / 2),
            (right / 2, 0.0),
            (right / 2, down),
            (right / 2, down / 2),
        ]
        try:
            return self.at_paper().to_mm(ends)
        except MeasurementRefusedError:  # the lens was calibrated for the middle of the picture only
            return None

    def camera_centre(self) -> _FloatArray:
        """Return the camera's centre (4,) in homogeneous coordinates (x, y, z, w) of the paper's plane.

        That of a telecentric lens is at infinity, straight above the paper.

        Raises
        ------
        InputError
            Without intrinsics, if the lens is not telecentric.
        """
        if self.telecentric:
            return np.array([-1.0, 0.0, 0.0, 0.0])
        y, z, height = self.camera_mm()
        return np.array([-height, y, z, 1.0])

    def view_sentence(self) -> str | None:
        """Return what the scale implies, in words that a person can check with a ruler; None if it is unknown."""
        if self.picture_mm is None:
            return None
        width, height = self.picture_mm
        words = f"The picture is {width:.0f} mm wide and {height:.0f} mm high at the paper"
        if self.telecentric:
            return f"{words}; the lens is telecentric, so the scale holds at any distance."
        if self.camera_distance_mm is None:
            return f"{words}."
        return f"{words}; the camera stands {self.camera_distance_mm:.0f} mm away."

    def assumptions(self) -> tuple[str, ...]:
        """Return what the map assumes of gel and lens, a sentence each."""
        parallel = "The lens is telecentric: its rays are parallel, and perpendicular to the paper."
        return (
            *(() if self.gel is None else self.gel.assumptions()),
            *((parallel,) if self.telecentric else ()),
        )

    def not_in_interval(self, sources: Iterable[str] | None = None) -> tuple[str, ...]:
        """Return what no interval includes, its size being unknown: sources of error, then quantities of the map.

        Parameters
        ----------
        sources : iterable of str, optional
            The sources of a measurement's error that are not known; default: those of the map alone.
        """
        known = {variation.group for variation in self.variations}
        unknown = [group for group in get_args(VariationGroup) if group not in known]
        return tuple(dict.fromkeys((*(unknown if sources is None else sources), *self.unknown_quantities())))

    def unknown_quantities(self) -> tuple[str, ...]:
        """Return the quantities of the map whose errors no interval includes, because their sizes are not known."""
        paper = ("the height of the paper over the needle",) if self._needs_height() else ()
        gel = () if self.gel is None else self.gel.unknown_sigmas()
        rays = ("the direction of the lens's rays",) if self.telecentric and self.gel is not None else ()
        return (*paper, *gel, *rays)

    def _needs_height(self) -> bool:
        """Return whether the height of the paper over the needle is not known; on the gel it is the gel's depth."""
        on_gel = self.gel is not None and self.gel.paper == "surface"
        return bool(self.crossings) and not self.telecentric and not on_gel and self.paper_sigma_mm is None

    def variants(self, group: VariationGroup | None = None) -> "list[PlaneMap]":
        """Return the map moved by one standard deviation along each independent axis of its uncertainty.

        With `group`, only along the axes of that group; an empty list means that its uncertainty is not known.
        """
        axes = zip(self.variations, self._variants, strict=True)
        return [variant for variation, variant in axes if group in (None, variation.group)]

    def map_by_variants(self, px: ArrayLike) -> dict[VariationGroup, list[_FloatArray]]:
        """Return what `to_mm` of each variant returns for pixels (N, 2), by group, with all lenses at once.

        Raises as `to_mm`.
        """
        points = _as_points(px, "pixels")
        own, others = self.intrinsics or self.radial, [variant.intrinsics for variant in self._variants]
        varied = [lens for lens in others if lens is not None and lens is not own]
        by_own = undistort(own, points)
        by_varied = iter(undistort_by_each(varied, points) if varied else ())
        found: dict[VariationGroup, list[_FloatArray]] = {group: [] for group in get_args(VariationGroup)}
        for variation, variant in zip(self.variations, self._variants, strict=True):
            is_own = variant.intrinsics is None or variant.intrinsics is own
            ideal = by_own if is_own else next(by_varied)
            found[variation.group].append(variant.ideal_to_mm(ideal))
        return found

    @cached_property
    def _variants(self) -> "list[PlaneMap]":
        moved = []
        for variation in self.variations:
            lens = self.intrinsics
            if lens is not None and variation.lens is not None:
                lens = lens.with_parameters(variation.lens)
            moved.append(
                replace(
                    self,
                    homography=variation.homography,
                    intrinsics=lens,
                    gel=variation.gel or self.gel,
                    variations=(),
                )
            )
        return moved

    def to_json(self) -> dict[str, Any]:
        """Return the document that `labrig calibrate plane --json` prints; unknown values are None."""
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
            "gel": None if self.gel is None else asdict(self.gel),
            "assumptions": list(self.assumptions()),
            "not_in_interval": list(self.not_in_interval()),
            "gel_measurement": self.gel_measurement
            and {**vars(self.gel_measurement), "sentence": self.gel_measurement.sentence()},
            "flatness_mm": self.flatness_mm,
            "crossing_noise_mm": self.crossing_noise_mm,
            "view": self.view_sentence(),
            "bend": self.bend and {**vars(self.bend), "sentence": self.bend.sentence()},
            "telecentric": self.telecentric,
            "paper_sigma_mm": self.paper_sigma_mm,
            "picture_mm": self.picture_mm and list(self.picture_mm),
            "camera_distance_mm": self.camera_distance_mm,
            "variations": [
                {
                    "homography": variation.homography.tolist(),
                    "lens": variation.lens and list(variation.lens),
                    "group": variation.group,
                    "gel": None if variation.gel is None else asdict(variation.gel),
                }
                for variation in self.variations
            ],
        }


def _as_points(points: ArrayLike, what: str) -> _FloatArray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"{what} have shape {array.shape}, not (N, 2)", "one row per point")
    return array


def undistort(lens: Intrinsics | Radial | None, px: _FloatArray) -> _FloatArray:
    """Return the ideal pixels (N, 2) of pixels (N, 2) in a picture; the pixels themselves without a lens."""
    return px if lens is None else lens.undistort_px(px)


def find_camera_mm(homography: _FloatArray, lens: Intrinsics) -> _FloatArray:
    """Return the place of the camera (3,) [mm]: its foot on the plane of a homography, and its height above it.

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
    """Return points (N, 2) mapped by a homography (3, 3)."""
    homogeneous = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def check_frame(origin_px: tuple[float, float], insertion: str) -> tuple[tuple[float, float], Insertion]:
    """Return origin and direction of a steering plane frame; raises InputError, which names the fault."""
    directions: dict[str, Insertion] = {direction: direction for direction in PICTURE_AXES}
    if insertion not in directions:
        raise InputError(f"insertion {insertion!r} is not a direction", f"one of {', '.join(directions)}")
    u, v = origin_px
    if not (np.isfinite(u) and np.isfinite(v)):
        raise InputError(f"origin ({u}, {v}) px is not finite", "give the pixel that is to be (0, 0) mm")
    return (float(u), float(v)), directions[insertion]
