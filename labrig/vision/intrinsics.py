"""The lens of a camera: a pinhole with Brown's distortion, five coefficients in OpenCV's order, and its uncertainty."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict, Field, PositiveFloat, PositiveInt, TypeAdapter

from labrig.errors import InputError, MeasurementRefusedError

_FloatArray = NDArray[np.float64]
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""The order of `Intrinsics.parameters` and of its covariance."""

# The views tell the warp of the board if they reduce its standard deviation to this share.
_TOLD = 0.5
# OpenCV undoes the distortion by iteration: until a pixel moves by less, or so many steps. Version 4 takes these in a
# function of its own.
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-9)
_UNDISTORT: Any = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
# Largest distance between a pixel and itself after undistortion and distortion [px].
_UNDISTORTION_TOLERANCE_PX = 1e-7


@dataclass(frozen=True)
class ViewResidual:
    """What one photograph of the board contributed.

    Attributes
    ----------
    image : str
        Name of the photograph.
    rms_px : float or None
        Root mean square distance between its corners and their reprojections; None without corners.
    used : bool
        Whether its corners entered the fit.
    reason : str or None
        Why it was not used.
    corners_px, errors_px : tuple of (float, float)
        Its corners and their reprojection errors, for drawings; not kept in files.
    """

    image: str
    rms_px: float | None
    used: bool
    reason: str | None = None
    corners_px: Annotated[tuple[tuple[float, float], ...], Field(exclude=True)] = ()
    errors_px: Annotated[tuple[tuple[float, float], ...], Field(exclude=True)] = ()


@dataclass(frozen=True)
class LensEffect:
    """What the uncertainty of a lens does to what is measured with it: standard deviations as shares.

    Attributes
    ----------
    length, radius : float
        Of lengths and radii in the working area, rms, through a plane map that is made with this lens.
    distance : float
        Of the distance from the camera to the plane.
    """

    length: float
    radius: float
    distance: float

    def sentence(self) -> str:
        """Return the effect in words."""
        length, radius, distance = (100.0 * share for share in (self.length, self.radius, self.distance))
        return (
            f"The calibration makes lengths in the plane uncertain by {length:.3f} %, radii by {radius:.3f} %, and the "
            f"distance from the camera to the plane by {distance:.2f} % (1 sigma)."
        )


@dataclass(frozen=True)
class BoardWarp:
    """How far the middle of the board stands above its edges, towards the camera, along its rows and its columns.

    Attributes
    ----------
    row_mm, column_mm : float
        Height of the middle of a row over its ends, and of the middle of a column over its ends.
    sigma_row_mm, sigma_column_mm : float
        Their standard deviations.
    prior_mm : float
        The standard deviation of both before the views are seen.
    """

    row_mm: float
    column_mm: float
    sigma_row_mm: float
    sigma_column_mm: float
    prior_mm: float

    def sentence(self) -> str:
        """Return the warp in words."""
        heights = (
            f"the middle of its rows stands {self.row_mm:+z.3f} ± {self.sigma_row_mm:.3f} mm, that of its columns "
            f"{self.column_mm:+z.3f} ± {self.sigma_column_mm:.3f} mm towards the camera (1 sigma)"
        )
        if max(self.sigma_row_mm, self.sigma_column_mm) <= _TOLD * self.prior_mm:
            return f"Warp of the board: {heights}."
        return (
            f"The views hardly tell the warp of the board: {heights}. It is taken to be within {self.prior_mm:.3f} mm "
            "(1 sigma), which is in the uncertainty of the lens; more tilted views would tell it."
        )


@dataclass(frozen=True)
class Intrinsics:
    """The calibrated lens of a camera, with standard deviations and evidence.

    Attributes
    ----------
    image_size : (int, int)
        Width and height [px] of the pictures of this camera.
    fx, fy, cx, cy : float
        Focal lengths and principal point [px], pixel centres at integers.
    distortion : 5 floats
        k1, k2, p1, p2, k3.
    sigma : dict
        Standard deviations of fx, fy, cx, cy [px] and k1, k2, p1, p2, k3; None for a parameter that the views do not
        determine.
    rms_px : float
        Reprojection error of the fitted corners. It says nothing about the error of the focal length.
    holdout_rms_px : float or None
        Reprojection error of photographs that were left out of the fit.
    views : tuple of ViewResidual
    accepted : bool
        Whether measurements may rely on it.
    reasons : tuple of str
        Why not, each with what to photograph next.
    covariance : tuple of rows or None
        Of the parameters in the order of `PARAMETERS`, nine by nine.
    effect : LensEffect or None
        What the covariance does to lengths, radii and the plane's distance.
    coverage : float or None
        Share of the picture inside the convex hull of all corners.
    board_warp : BoardWarp or None
        How far the board is from flat.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(strict=True, allow_inf_nan=False)

    image_size: tuple[PositiveInt, PositiveInt]
    fx: PositiveFloat
    fy: PositiveFloat
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]
    sigma: dict[str, float | None]
    rms_px: float
    holdout_rms_px: float | None
    views: tuple[ViewResidual, ...]
    accepted: bool
    reasons: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...] | None = None
    effect: LensEffect | None = None
    coverage: float | None = None
    board_warp: BoardWarp | None = None

    def camera_matrix(self) -> _FloatArray:
        """Return the matrix (3, 3) from directions to ideal pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def directions(self, px: ArrayLike) -> _FloatArray:
        """Return the unit vectors (N, 3), z away from the camera, that appear at pixels (N, 2)."""
        rays = self._rays(self.undistort_px(px))
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def with_parameters(self, values: Sequence[float]) -> "Intrinsics":
        """Return the lens with other values of its parameters, in the order of `PARAMETERS`."""
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = map(float, values)
        return replace(self, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3))

    def parameters(self) -> tuple[float, ...]:
        """Return the parameters, in the order of `PARAMETERS`."""
        return (self.fx, self.fy, self.cx, self.cy, *self.distortion)

    def distort_px(self, px: ArrayLike) -> _FloatArray:
        """Return where the lens puts ideal pixels (N, 2)."""
        return self.project(self._rays(check_points(px)))[0]

    def undistort_px(self, px: ArrayLike) -> _FloatArray:
        """Return the ideal pixels (N, 2) of pixels (N, 2) in a picture.

        Raises
        ------
        MeasurementRefusedError
            If the model cannot be inverted at a pixel: it lies outside the region that the boards covered,
            where the fitted distortion folds over.
        """
        wanted = check_points(px)
        if not len(wanted):
            return wanted
        matrix, distortion = self.camera_matrix(), np.array(self.distortion)
        rays = cv2.convertPointsToHomogeneous(
            _UNDISTORT(wanted[:, None], matrix, distortion, R=None, P=None, criteria=_STOP)
        ).reshape(-1, 3)
        off = np.hypot(*(self.project(rays)[0] - wanted).T)
        if not off.max() <= _UNDISTORTION_TOLERANCE_PX:
            worst = wanted[int(np.argmax(np.nan_to_num(off, nan=np.inf)))]
            raise MeasurementRefusedError(
                f"the lens model has no inverse at pixel ({worst[0]:.1f}, {worst[1]:.1f})",
                "photograph the board in that part of the picture and calibrate again",
            )
        return np.asarray(rays[:, :2] * (self.fx, self.fy) + (self.cx, self.cy))

    def project(self, rays: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
        """Return where the lens shows points (N, 3) before it, (N, 2) [px], and the derivatives (2 N, 15).

        The derivatives are with respect to turn and shift of the points, and the parameters.
        """
        if not len(rays):
            return np.empty((0, 2)), np.empty((0, 15))
        none = np.zeros(3)
        px, slopes = cv2.projectPoints(rays, none, none, self.camera_matrix(), np.array(self.distortion))
        return np.asarray(px, np.float64).reshape(-1, 2), np.asarray(slopes, np.float64)[:, :15]

    def fingerprint(self) -> str:
        """Return the SHA-256 of size, matrix and distortion, by which a plane map identifies its lens."""
        return hashlib.sha256(json.dumps([*self.image_size, *self.parameters()]).encode()).hexdigest()

    def to_json(self) -> dict[str, Any]:
        """Return the document that `labrig calibrate intrinsics --json` prints; unknown values are None."""
        document: dict[str, Any] = LENS.dump_python(self, mode="json")
        for part, told in (("board_warp", self.board_warp), ("effect", self.effect)):
            if told is not None:
                document[part]["sentence"] = told.sentence()
        return document

    def _rays(self, ideal_px: _FloatArray) -> _FloatArray:
        """Return the directions (N, 3), at distance 1, of ideal pixels (N, 2)."""
        flat = (ideal_px - (self.cx, self.cy)) / (self.fx, self.fy)
        return np.column_stack((flat, np.ones(len(flat))))


LENS = TypeAdapter(Intrinsics)
"""What reads and writes a lens as JSON."""


def vary_lens(lens: Intrinsics) -> list[Intrinsics]:
    """Return the lens moved by one standard deviation along each principal axis of its covariance.

    The variance of a quantity due to the lens is the sum of its squared changes over these lenses.
    """
    if lens.covariance is None:
        return []
    values, vectors = np.linalg.eigh(np.array(lens.covariance))
    moves = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    return [lens.with_parameters(np.array(lens.parameters()) + move) for move in moves if move.any()]


def check_points(points: ArrayLike, what: str = "pixels") -> _FloatArray:
    """Return points as an array (N, 2). Raises `InputError` for another shape."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"{what} have shape {array.shape}, not (N, 2)", "one row per point")
    return array


def measure_rms(errors: _FloatArray) -> float:
    """Return the root mean square length of errors (N, 2), in their unit."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
