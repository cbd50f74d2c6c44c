"""Pixels of a picture to mm in the steering plane, and back.

The map undoes the lens (by the intrinsics, or by one radial term fitted with the plane), applies one homography, and
refracts rays at the surfaces of a stated gel and of the walls before it. It holds for one plane only: without a stated
gel the graph paper must lie where the needle will be. With a needle 5 to 20 mm deep and a camera 250 to 400 mm away,
paper at needle depth but in air makes radii 0.3 to 2 % too large, and paper on top of the gel 1 to 6 % too small; 5 mm
of glass left out make them 0.9 % too large at 200 mm.
"""

import math
from collections.abc import Iterable
from functools import cached_property
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, InstanceOf, PositiveFloat, PositiveInt

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.gel import Gel
from labrig.vision.intrinsics import Intrinsics, check_points

Insertion = Literal["right", "left", "up", "down"]
VariationGroup = Literal["lens", "plane", "surface"]
FloatArray = NDArray[np.float64]

_Row = tuple[float, float, float]


def _list_rows(value: object) -> object:
    return tuple(map(tuple, value.tolist())) if isinstance(value, np.ndarray) else value


Homography = Annotated[tuple[_Row, _Row, _Row], BeforeValidator(_list_rows)]
"""Three rows of three numbers; an array (3, 3) is taken as well."""

# Rows: where +y and +z of the steering plane point in the picture (u, v).
PICTURE_AXES: dict[Insertion, tuple[tuple[int, int], tuple[int, int]]] = {
    "right": ((0, -1), (1, 0)),
    "down": ((1, 0), (0, 1)),
    "left": ((0, 1), (-1, 0)),
    "up": ((-1, 0), (0, -1)),
}


# Ends of a cross from left to right and from top to bottom, and its middle.
_CROSS = np.array([(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0), (0.0, 0.0)])


class _Value(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Radial(_Value):
    """One radial term of distortion for an unknown lens: an ideal pixel is c + (p - c) / (1 + k |p - c|^2).

    It has an inverse in closed form (Fitzgibbon 2001, IEEE CVPR I:125).

    Attributes
    ----------
    centre_px : (float, float)
    k_per_px2 : float
    """

    centre_px: tuple[float, float]
    k_per_px2: float

    def undistort_px(self, px: FloatArray) -> FloatArray:
        """Return the ideal pixels (N, 2)."""
        aside = px - self.centre_px
        return np.asarray(self.centre_px + aside / (1.0 + self.k_per_px2 * np.sum(aside**2, axis=1))[:, None])

    def distort_px(self, px: FloatArray) -> FloatArray:
        """Return the pixels (N, 2) in a picture of ideal pixels (N, 2)."""
        aside = px - self.centre_px
        root = np.sqrt(np.maximum(1.0 - 4.0 * self.k_per_px2 * np.sum(aside**2, axis=1), 0.0))
        return np.asarray(self.centre_px + aside * (2.0 / (1.0 + root))[:, None])


class Variation(_Value):
    """The map moved by one standard deviation along one independent axis of its uncertainty.

    Attributes
    ----------
    homography : 3 x 3
    group : "lens", "plane" or "surface"
        What is uncertain: the lens; the paper's lines and its bend; or the gel and the walls before the needle.
    lens : tuple of float or None
        The lens's parameters; None for the map's own lens.
    gel : Gel or None
        None for the map's own gel.
    """

    homography: Homography
    group: VariationGroup
    lens: tuple[float, ...] | None = None
    gel: Gel | None = None


class PlaneMap(_Value):
    """The map between a picture and the steering plane, with the evidence for it.

    Attributes
    ----------
    homography : 3 x 3
        From homogeneous ideal pixels (u, v, 1) to homogeneous (y, z, 1) [mm].
    origin_px : (float, float)
        The pixel of the picture at (0, 0) mm.
    insertion : "right", "left", "up" or "down"
        Direction of the insertion in the picture, within 45 degrees.
    mm_per_px : float
        Square root of the area of the pixel at the origin.
    image_size : (int, int) or None
        Width and height [px] of the pictures that the map holds for; None if unknown.
    intrinsics : Intrinsics or None
        The lens, which has a file of its own; None if it is unknown, or the picture is rectified.
    radial : Radial or None
        Fitted with the plane if there are no intrinsics.
    gel : Gel or None
        Refracts the rays; None for a plane in air, or where the paper lay in the needle's gel.
    accepted : bool
    reasons : tuple of str
        Why the map is not accepted, each with what to do.
    points : int
        Number of points of the paper's lines that were fitted; 0 for a stated scale.
    rms_mm, holdout_rms_mm : float or None
        Distances between these points and their fitted places, and those of points left out of the fit.
    flatness_mm : float or None
        Deviation of the paper from flat: rms over parts of the picture of the median residual of each.
    paper_sigma_mm : float or None
        Standard deviation of the paper's height over the needle's plane; None if it is not known.
    variations : tuple of Variation
        The map's uncertainty: the variance of any length is the sum of its squared changes over these.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    accepted: bool = True
    reasons: tuple[str, ...] = ()
    rms_mm: float | None = None
    holdout_rms_mm: float | None = None
    flatness_mm: float | None = None
    mm_per_px: PositiveFloat
    points: int = 0
    image_size: tuple[PositiveInt, PositiveInt] | None = None
    origin_px: tuple[float, float]
    insertion: Insertion
    homography: Homography
    radial: Radial | None = None
    gel: Gel | None = None
    paper_sigma_mm: float | None = None
    variations: tuple[Variation, ...] = ()
    intrinsics: InstanceOf[Intrinsics] | None = Field(None, exclude=True)

    def change(self, **values: Any) -> Self:
        """Return the map with other values."""
        return type(self)(**{name: getattr(self, name) for name in type(self).model_fields} | values)

    @cached_property
    def matrix(self) -> FloatArray:
        """The homography as an array (3, 3)."""
        return np.array(self.homography)

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
        return cls(
            homography=homography,
            origin_px=origin,
            insertion=direction,
            image_size=image_size,
            mm_per_px=1.0 / px_per_mm,
        )

    def to_mm(self, px: ArrayLike) -> FloatArray:
        """Return points (N, 2) in the plane, columns (y, z) [mm], of pixels (N, 2) in a picture.

        Raises
        ------
        MeasurementRefusedError
            If the lens model cannot be inverted at a pixel.
        """
        return self.ideal_to_mm(undistort(self.intrinsics or self.radial, check_points(px)))

    def ideal_to_mm(self, ideal: FloatArray) -> FloatArray:
        """Return points (N, 2) in the plane [mm] of pixels (N, 2) from which the lens's distortion has been taken."""
        straight = apply_homography(self.matrix, ideal)
        return straight if self.gel is None else self.gel.bend(straight, self.camera_mm())

    def to_px(self, mm: ArrayLike) -> FloatArray:
        """Return pixels (N, 2) in a picture of points (N, 2) in the plane, columns (y, z) [mm]."""
        points = check_points(mm, "points in the plane")
        straight = points if self.gel is None else self.gel.straighten(points, self.camera_mm())
        ideal = apply_homography(np.linalg.inv(self.matrix), straight)
        lens = self.intrinsics or self.radial
        return ideal if lens is None else lens.distort_px(ideal)

    def to_pixel(self, place_mm: tuple[float, float]) -> tuple[float, float]:
        """Return the pixel (u, v) of a point (y, z) in the plane [mm]."""
        u, v = self.to_px([place_mm])[0].tolist()
        return u, v

    def camera_mm(self) -> FloatArray:
        """Return the place of the camera (3,) [mm]: its foot (y, z) on the paper's plane, and its height above it.

        Raises
        ------
        InputError
            Without intrinsics, because the homography alone does not determine it.
        """
        if self.intrinsics is None:
            raise InputError(
                "a gel's refraction needs the camera's intrinsics", "calibrate them first: --intrinsics FILE"
            )
        return find_camera_mm(self.matrix, self.intrinsics)

    def mm_per_px_at(self, px: tuple[float, float]) -> float:
        """Return the square root of the area [mm] of a pixel of the picture."""
        left, right, top, bottom, _ = self.to_mm(np.asarray(px) + 0.5 * _CROSS)
        return float(np.sqrt(np.abs(np.linalg.det(np.array([right - left, bottom - top])))))

    def at_paper(self) -> "PlaneMap":
        """Return the map to the paper as it was calibrated, in air."""
        return self if self.gel is None else self.change(gel=None, variations=())

    @property
    def picture_mm(self) -> tuple[float, float] | None:
        """Width and height of the picture on the paper, through its middle [mm]; None without the picture's size."""
        places = self._find_cross_mm()
        if places is None:
            return None
        return math.dist(places[0], places[1]), math.dist(places[2], places[3])

    @property
    def camera_distance_mm(self) -> float | None:
        """Distance of the camera from the middle of the picture on the paper [mm]; None without intrinsics."""
        places = self._find_cross_mm()
        if places is None or self.intrinsics is None:
            return None
        return math.dist(self.camera_mm(), (*places[4], 0.0))

    def _find_cross_mm(self) -> FloatArray | None:
        """Return the ends of the picture's middle row and column, and its middle, on the paper (5, 2)."""
        if self.image_size is None:
            return None
        try:
            return self.at_paper().to_mm((0.5 * np.array(self.image_size) - 0.5) * (1.0 + _CROSS))
        except MeasurementRefusedError:  # the lens was calibrated for the middle of the picture only
            return None

    def view_sentence(self) -> str | None:
        """Return what the scale implies, in words that a person can check with a ruler; None if it is unknown."""
        if self.picture_mm is None:
            return None
        width, height = self.picture_mm
        words = f"The picture is {width:.0f} mm wide and {height:.0f} mm high at the paper"
        if self.camera_distance_mm is None:
            return f"{words}."
        return f"{words}; the camera stands {self.camera_distance_mm:.0f} mm away."

    def assumptions(self) -> tuple[str, ...]:
        """Return what the map assumes of the gel, a sentence each."""
        return () if self.gel is None else self.gel.assumptions()

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
        # On the gel the paper's height is the gel's depth.
        on_gel = self.gel is not None and self.gel.paper_at == "surface"
        needs_height = bool(self.points) and not on_gel and self.paper_sigma_mm is None
        gel = () if self.gel is None else self.gel.unknown_sigmas()
        return (*(("the height of the paper over the needle",) if needs_height else ()), *gel)

    def map_by_variants(self, px: ArrayLike) -> dict[VariationGroup, list[FloatArray]]:
        """Return where pixels (N, 2) are by the map moved by one standard deviation along each axis, by group.

        Raises as `to_mm`.
        """
        points = check_points(px)
        by_own = undistort(self.intrinsics or self.radial, points)
        found: dict[VariationGroup, list[FloatArray]] = {group: [] for group in get_args(VariationGroup)}
        for variation, variant in zip(self.variations, self._variants, strict=True):
            ideal = by_own if variation.lens is None else undistort(variant.intrinsics, points)
            found[variation.group].append(variant.ideal_to_mm(ideal))
        return found

    @cached_property
    def _variants(self) -> "list[PlaneMap]":
        moved = []
        for variation in self.variations:
            lens = self.intrinsics
            if lens is not None and variation.lens is not None:
                lens = lens.with_parameters(variation.lens)
            gel = variation.gel or self.gel
            moved.append(
                self.change(homography=variation.homography, intrinsics=lens, gel=gel, variations=())
            )
        return moved

    def to_json(self) -> dict[str, Any]:
        """Return the document that `labrig calibrate plane --json` prints; unknown values are None."""
        return {
            **self.model_dump(mode="json"),
            "assumptions": list(self.assumptions()),
            "not_in_interval": list(self.not_in_interval()),
            "view": self.view_sentence(),
            "picture_mm": self.picture_mm and list(self.picture_mm),
            "camera_distance_mm": self.camera_distance_mm,
        }


def undistort(lens: Intrinsics | Radial | None, px: FloatArray) -> FloatArray:
    """Return the ideal pixels (N, 2) of pixels (N, 2) in a picture; the pixels themselves without a lens."""
    return px if lens is None else lens.undistort_px(px)


def find_camera_mm(homography: FloatArray, lens: Intrinsics) -> FloatArray:
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


def apply_homography(homography: NDArray[np.floating], points: FloatArray) -> FloatArray:
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
