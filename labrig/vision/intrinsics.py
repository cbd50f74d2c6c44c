"""The lens of a camera: a pinhole with radial and tangential distortion, and the uncertainty of its parameters.

The model is Brown's with five coefficients in OpenCV's order (k1, k2, p1, p2, k3), and a skew of the pixel axes that
is zero except in Zhang's own model.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.board_warp import BoardWarp

_FloatArray = NDArray[np.float64]
SigmaSource = Literal["corners", "views"]

# Newton steps to undo the distortion; an invertible lens takes four or five.
_MAX_NEWTON_STEPS = 30
# Distance between a pixel and itself after undistortion and distortion [focal lengths].
_UNDISTORTION_TOLERANCE = 1e-11


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
        Why it was not used, or what is unusual about it.
    corners_px, errors_px : tuple of (float, float)
        Its corners and their reprojection errors, for drawings; not kept in files.
    """

    image: str
    rms_px: float | None
    used: bool
    reason: str | None = None
    corners_px: tuple[tuple[float, float], ...] = ()
    errors_px: tuple[tuple[float, float], ...] = ()


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
        Standard deviations of fx, fy, cx, cy [px] and k1, k2, p1, p2, k3, or of the parameters of Zhang's model; None
        for a parameter that the views do not determine.
    rms_px : float
        Reprojection error of the fitted corners. It says nothing about the error of the focal length.
    holdout_rms_px : float or None
        Reprojection error of photographs that were left out of the fit.
    views : tuple of ViewResidual
    accepted : bool
        Whether measurements may rely on it.
    reasons : tuple of str
        Why not, each with what to photograph next.
    skew : float
        Of the pixel axes: shift of u [px] per focal length in v.
    covariance : tuple of rows or None
        Of fx, fy, cx, cy, k1, k2, p1, p2, k3 and skew, ten by ten.
    projection_sigma_px : tuple of rows of floats or None
        Standard deviation of the pixel of a direction over the picture, row by row from corner to corner; see
        `labrig.vision.projection`.
    coverage : float or None
        Share of the picture inside the convex hull of all corners.
    different_views : int or None
    tilt_spread_deg : float or None
        Largest angle between two boards.
    board_warp : BoardWarp or None
        How far the board is from flat; None where it was taken for flat, as in calibrations of earlier versions.
    sigma_from : "corners" or "views"
        What the standard deviations rest on: the noise of corners that err independently, as in calibrations of earlier
        versions, or the scatter between views, where that is significantly larger.
    """

    image_size: tuple[int, int]
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]
    sigma: dict[str, float | None]
    rms_px: float
    holdout_rms_px: float | None
    views: tuple[ViewResidual, ...]
    accepted: bool
    reasons: tuple[str, ...]
    skew: float = 0.0
    covariance: tuple[tuple[float, ...], ...] | None = None
    projection_sigma_px: tuple[tuple[float, ...], ...] | None = None
    coverage: float | None = None
    different_views: int | None = None
    tilt_spread_deg: float | None = None
    board_warp: BoardWarp | None = None
    sigma_from: SigmaSource = "corners"

    def camera_matrix(self) -> _FloatArray:
        """Return the matrix (3, 3) from directions to ideal pixels."""
        return np.array([[self.fx, self.skew, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def directions(self, px: ArrayLike) -> _FloatArray:
        """Return the unit vectors (N, 3), z away from the camera, that appear at pixels (N, 2)."""
        flat = self.to_directions(self.undistort_px(px))
        rays = np.column_stack((flat, np.ones(len(flat))))
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def with_parameters(self, values: Sequence[float]) -> "Intrinsics":
        """Return the lens with other values of fx, fy, cx, cy, k1, k2, p1, p2, k3 and skew."""
        fx, fy, cx, cy, k1, k2, p1, p2, k3, skew = map(float, values)
        return replace(self, fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3), skew=skew)

    def parameters(self) -> tuple[float, ...]:
        """Return fx, fy, cx, cy, k1, k2, p1, p2, k3 and skew, in the order of `covariance`."""
        return (self.fx, self.fy, self.cx, self.cy, *self.distortion, self.skew)

    def distort_px(self, px: ArrayLike) -> _FloatArray:
        """Return where the lens puts ideal pixels (N, 2)."""
        return self.to_px(_distort(self.to_directions(px), self.distortion)[0])

    def undistort_px(self, px: ArrayLike) -> _FloatArray:
        """Return the ideal pixels (N, 2) of pixels (N, 2) in a picture.

        Raises
        ------
        MeasurementRefusedError
            If the model cannot be inverted at a pixel: it lies outside the region that the boards covered,
            where the fitted distortion folds over.
        """
        wanted = self.to_directions(px)
        found, off = _undistort(wanted, self.distortion)
        if off.size and not off.max() <= _UNDISTORTION_TOLERANCE:
            worst = self.to_px(wanted)[int(np.argmax(np.nan_to_num(off, nan=np.inf)))]
            raise MeasurementRefusedError(
                f"the lens model has no inverse at pixel ({worst[0]:.1f}, {worst[1]:.1f})",
                "photograph the board in that part of the picture and calibrate again",
            )
        return self.to_px(found)

    def sigma_sentence(self) -> str:
        """Return what the standard deviations rest on."""
        if self.sigma_from == "views":
            return "by the scatter between views: the errors of the corners of a view are not independent"
        return "by the noise of the corners, taken for independent"

    def fingerprint(self) -> str:
        """Return the SHA-256 of size, matrix and distortion, by which a plane map identifies its lens."""
        numbers = [*self.image_size, self.fx, self.fy, self.cx, self.cy, *self.distortion]
        numbers += [self.skew] if self.skew else []
        return hashlib.sha256(json.dumps(numbers).encode()).hexdigest()

    def to_json(self) -> dict[str, Any]:
        """Return the document that `labrig calibrate intrinsics --json` prints; unknown values are None."""
        return {
            "accepted": self.accepted,
            "reasons": list(self.reasons),
            "image_size": list(self.image_size),
            "fx": self.fx,
            "fy": self.fy,
            "cx": self.cx,
            "cy": self.cy,
            "sigma": dict(self.sigma),
            "sigma_from": self.sigma_from,
            "sigma_sentence": self.sigma_sentence(),
            "distortion": list(self.distortion),
            "rms_px": self.rms_px,
            "holdout_rms_px": self.holdout_rms_px,
            "skew": self.skew,
            "covariance": _rows(self.covariance),
            "projection_sigma_px": _rows(self.projection_sigma_px),
            "coverage": self.coverage,
            "different_views": self.different_views,
            "tilt_spread_deg": self.tilt_spread_deg,
            "board_warp": self.board_warp
            and {**vars(self.board_warp), "sentence": self.board_warp.sentence()},
            "views": [
                {"image": view.image, "rms_px": view.rms_px, "used": view.used, "reason": view.reason}
                for view in self.views
            ],
        }

    def to_directions(self, px: ArrayLike) -> _FloatArray:
        """Return the directions (N, 2), x and y at distance 1, of ideal pixels (N, 2)."""
        array = np.asarray(px, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != 2:
            raise InputError(
                f"pixels have shape {array.shape}, not (N, 2)", "one row per point, columns u, v"
            )
        flat = (array - (self.cx, self.cy)) / (self.fx, self.fy)
        flat[:, 0] -= self.skew / self.fx * flat[:, 1]
        return np.asarray(flat)

    def to_px(self, directions: _FloatArray) -> _FloatArray:
        """Return the ideal pixels (N, 2) of directions (N, 2)."""
        px = directions * (self.fx, self.fy) + (self.cx, self.cy)
        px[:, 0] += self.skew * directions[:, 1]
        return np.asarray(px)


def _rows(table: tuple[tuple[float, ...], ...] | None) -> list[list[float]] | None:
    return None if table is None else [list(row) for row in table]


def undistort_by_each(lenses: Sequence[Intrinsics], px: _FloatArray) -> _FloatArray:
    """Return the ideal pixels (K, N, 2) of pixels (N, 2) by K lenses, at once. Raises as `Intrinsics.undistort_px`."""
    wanted = np.concatenate([lens.to_directions(px) for lens in lenses])
    coefficients = np.repeat([lens.distortion for lens in lenses], len(px), axis=0).T
    found, off = _undistort(wanted, tuple(coefficients))
    if off.size and not off.max() <= _UNDISTORTION_TOLERANCE:
        return np.stack([lens.undistort_px(px) for lens in lenses])
    return np.stack(
        [lens.to_px(part) for lens, part in zip(lenses, np.split(found, len(lenses)), strict=True)]
    )


def _distort(
    points: _FloatArray, distortion: Sequence[float | _FloatArray]
) -> tuple[_FloatArray, _FloatArray]:
    """Return distorted directions (N, 2) and their Jacobians (N, 2, 2) with respect to the ideal directions."""
    k1, k2, p1, p2, k3 = distortion
    x, y = points[:, 0], points[:, 1]
    s = x * x + y * y
    radial = 1.0 + s * (k1 + s * (k2 + s * k3))
    slope = 2.0 * (k1 + s * (2.0 * k2 + s * 3.0 * k3))
    moved = np.column_stack(
        (
            x * radial + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * radial + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    )
    jacobian = np.empty((len(points), 2, 2))
    jacobian[:, 0, 0] = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    jacobian[:, 1, 1] = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    return moved, jacobian


def _undistort(
    wanted: _FloatArray, distortion: Sequence[float | _FloatArray]
) -> tuple[_FloatArray, _FloatArray]:
    """Return ideal directions (N, 2) and the distances (N,) of their distorted images from `wanted`."""
    found = wanted.copy()
    for _ in range(_MAX_NEWTON_STEPS):
        moved, jacobian = _distort(found, distortion)
        missing = wanted - moved
        determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] ** 2
        unfolded = determinant > 0.0
        off = np.where(unfolded, np.hypot(missing[:, 0], missing[:, 1]), np.inf)
        if not (np.isfinite(off) & (off > 0.1 * _UNDISTORTION_TOLERANCE)).any():
            break
        step_x = jacobian[:, 1, 1] * missing[:, 0] - jacobian[:, 0, 1] * missing[:, 1]
        step_y = jacobian[:, 0, 0] * missing[:, 1] - jacobian[:, 0, 1] * missing[:, 0]
        step = np.column_stack((step_x, step_y)) / np.where(unfolded, determinant, 1.0)[:, None]
        found = np.where(unfolded[:, None], found + step, found)
    return found, off
