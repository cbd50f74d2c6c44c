"""Camera and poses from corners by least squares, with the covariance of every parameter.

There are two lens models. "brown" is OpenCV's with five coefficients, fitted by OpenCV. "zhang" is the model of Zhang
2000 (IEEE PAMI 22:1330): two radial coefficients and a skew of the pixel axes. OpenCV has no skew, so Gauss-Newton fits
it here, starting from OpenCV's answer. The covariance is that of least squares; the residuals and their degrees of
freedom give the noise. OpenCV's own standard deviations count a corner as one observation, not two.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import CalibrationRefusedError

LensModel = Literal["brown", "zhang"]
_FloatArray = NDArray[np.float64]

# The order of `Fit.parameters`, and which of them a model fits.
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "skew")
FREE: dict[LensModel, list[int]] = {"brown": list(range(9)), "zhang": [0, 1, 2, 3, 4, 5, 9]}
_FLAGS: dict[LensModel, int] = {"brown": 0, "zhang": cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3}
_POSE = 6
_MAX_STEPS = 30
# Convergence: the largest effect of a step on all residuals together [px].
_STEP_TOLERANCE_PX = 1e-9
# Above this condition number of the scaled normal equations a parameter is undetermined.
_LARGEST_CONDITION = 1e13


@dataclass(frozen=True, eq=False)
class ObservedView:
    """The corners of one photograph: board points (N, 3) [mm], pixels (N, 2)."""

    name: str
    board: _FloatArray
    pixels: _FloatArray


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted camera and the poses of the boards in front of it.

    Attributes
    ----------
    model : "brown" or "zhang"
    parameters : ndarray (10,)
        In the order of `PARAMETERS`.
    poses : ndarray (V, 6)
        Rotation vector, then shift [mm], of each board.
    rms_px : float
    covariance : ndarray (10, 10) or None
        Of the parameters; zero for a parameter that the model fixes. None if the views do not determine them.
    """

    model: LensModel
    parameters: _FloatArray
    poses: _FloatArray
    rms_px: float
    covariance: _FloatArray | None

    @property
    def matrix(self) -> _FloatArray:
        """Camera matrix (3, 3), without skew."""
        fx, fy, cx, cy = self.parameters[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> _FloatArray:
        """k1, k2, p1, p2, k3."""
        return self.parameters[4:9]

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length; infinite if it is undetermined."""
        if self.covariance is None:
            return float("inf")
        return float(np.sqrt(self.covariance[0, 0]) / self.parameters[0])

    def with_views(self, views: Sequence[ObservedView]) -> "Fit":
        """Return the same camera with the poses of other views; a pose is NaN if none fits."""
        poses = [find_pose(self, view) for view in views]
        return replace(
            self, poses=np.array([np.full(_POSE, np.nan) if pose is None else pose for pose in poses])
        )


def fit_camera(views: Sequence[ObservedView], size: tuple[int, int], model: LensModel) -> Fit:
    """Fit a camera to views of a board.

    Raises
    ------
    CalibrationRefusedError
        If no camera explains the views.
    """
    corners, unknown = sum(len(view.pixels) for view in views), len(FREE[model]) + _POSE * len(views)
    if 2 * corners < unknown:
        raise CalibrationRefusedError(
            f"{corners} corners are too few for a camera, {-(-unknown // 2)} are the least",
            "photograph the board in more poses, and more of it",
        )
    boards = [view.board.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    try:
        with _single_thread():
            _, matrix, lens, turns, shifts = cv2.calibrateCamera(
                boards, pixels, size, None, None, flags=_FLAGS[model]
            )
    except cv2.error as error:
        raise CalibrationRefusedError(
            f"no camera explains the {len(views)} views: {error.err}",
            "photograph the board tilted in several ways",
        ) from error
    focal = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])
    start = np.concatenate((focal, np.ravel(lens)[:5], [0.0]))
    poses = np.array([np.ravel(np.vstack(pose)) for pose in zip(turns, shifts, strict=True)], dtype=float)
    fit = Fit(model, start, poses, 0.0, None)
    return _add_covariance(_minimise(fit, views) if model == "zhang" else fit, views)


@contextmanager
def _single_thread() -> Iterator[None]:
    """Run OpenCV in one thread: with several threads the last digits of a camera change from call to call."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def project(fit: Fit, pose: _FloatArray, board: _FloatArray) -> _FloatArray:
    """Return the pixels (N, 2) of a board's points (N, 3) [mm] in a pose (6,)."""
    return _project(fit, pose, board)[0]


def find_pose(fit: Fit, view: ObservedView) -> _FloatArray | None:
    """Return the pose (6,) of another view through the same camera; None if there is none."""
    straight = view.pixels.copy()
    fy, cy = fit.parameters[1], fit.parameters[3]
    # The skew shifts a pixel along u in proportion to its distance from row cy.
    straight[:, 0] -= fit.parameters[9] * (view.pixels[:, 1] - cy) / fy
    solved, turn, shift = cv2.solvePnP(view.board, straight, fit.matrix, fit.distortion)
    return np.concatenate((np.ravel(turn), np.ravel(shift))).astype(np.float64) if solved else None


def estimate_focal_change(fit: Fit, view: ObservedView, pose: _FloatArray) -> tuple[float, float]:
    """Return the relative change of the focal length that fits one view alone, and its standard deviation.

    The rest of the lens is held. The deviation is infinite if the view does not separate focal length from distance.
    """
    pixels, by_lens, by_pose = _project(fit, pose, view.board)
    by_focal = by_lens[:, :, :2] @ fit.parameters[:2]
    jacobian = np.concatenate((by_focal[:, :, None], by_pose), axis=2).reshape(-1, 1 + _POSE)
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(float).tiny)
    residuals = (view.pixels - pixels).ravel()
    normal = (jacobian / scale).T @ (jacobian / scale)
    if len(residuals) <= 1 + _POSE or np.linalg.cond(normal) > _LARGEST_CONDITION:
        return 0.0, float("inf")
    inverse = np.linalg.inv(normal)
    step = inverse @ ((jacobian / scale).T @ residuals)
    left = residuals - (jacobian / scale) @ step
    variance = float(left @ left) / (len(residuals) - 1 - _POSE)
    return float(step[0] / scale[0]), float(np.sqrt(inverse[0, 0] * variance) / scale[0])


def _project(fit: Fit, pose: _FloatArray, board: _FloatArray) -> tuple[_FloatArray, _FloatArray, _FloatArray]:
    """Return pixels (N, 2) and their derivatives with respect to ten parameters (N, 2, 10) and the pose (N, 2, 6)."""
    flat, slopes = cv2.projectPoints(board, pose[:3], pose[3:], fit.matrix, fit.distortion)
    pixels = np.asarray(flat, dtype=np.float64).reshape(-1, 2)
    slopes = np.asarray(slopes, dtype=np.float64).reshape(len(pixels), 2, -1)
    fy, cy, skew = fit.parameters[1], fit.parameters[3], fit.parameters[9]
    height = (pixels[:, 1] - cy) / fy
    by_lens = np.zeros((len(pixels), 2, len(PARAMETERS)))
    by_lens[:, :, :9] = slopes[:, :, _POSE : _POSE + 9]
    by_pose = slopes[:, :, :_POSE].copy()
    by_pose[:, 0] += skew / fy * by_pose[:, 1]
    by_lens[:, 0, 4:9] += skew / fy * by_lens[:, 1, 4:9]
    by_lens[:, 0, 9] = height
    pixels[:, 0] += skew * height
    return pixels, by_lens, by_pose


def _build_normal_equations(
    fit: Fit, views: Sequence[ObservedView]
) -> tuple[_FloatArray, _FloatArray, float]:
    """Return the normal matrix, its right side, and the sum of squared residuals [px^2]."""
    free = FREE[fit.model]
    count = len(free) + _POSE * len(views)
    normal, side, squares = np.zeros((count, count)), np.zeros(count), 0.0
    for index, (view, pose) in enumerate(zip(views, fit.poses, strict=True)):
        pixels, by_lens, by_pose = _project(fit, pose, view.board)
        start = len(free) + _POSE * index
        columns = np.concatenate((np.arange(len(free)), np.arange(start, start + _POSE)))
        jacobian = np.concatenate((by_lens[:, :, free], by_pose), axis=2).reshape(-1, len(columns))
        residuals = (view.pixels - pixels).ravel()
        normal[np.ix_(columns, columns)] += jacobian.T @ jacobian
        side[columns] += jacobian.T @ residuals
        squares += float(residuals @ residuals)
    return normal, side, squares


def _minimise(fit: Fit, views: Sequence[ObservedView]) -> Fit:
    """Move a fit to its minimum by Gauss-Newton."""
    free = FREE[fit.model]
    for _ in range(_MAX_STEPS):
        normal, side, _ = _build_normal_equations(fit, views)
        scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
        step = np.linalg.lstsq(normal / np.outer(scale, scale), side / scale, rcond=None)[0] / scale
        parameters = fit.parameters.copy()
        parameters[free] += step[: len(free)]
        fit = replace(
            fit, parameters=parameters, poses=fit.poses + step[len(free) :].reshape(fit.poses.shape)
        )
        if np.abs(step * scale).max() <= _STEP_TOLERANCE_PX:
            break
    if not (np.isfinite(fit.parameters).all() and fit.parameters[:2].min() > 0.0):
        raise CalibrationRefusedError(
            f"Zhang's model has no minimum for the {len(views)} views",
            "photograph the board tilted in several ways",
        )
    return fit


def _add_covariance(fit: Fit, views: Sequence[ObservedView]) -> Fit:
    """Return the fit with its residual and the covariance of its parameters."""
    normal, _, squares = _build_normal_equations(fit, views)
    corners = sum(len(view.pixels) for view in views)
    free, freedom = FREE[fit.model], 2 * corners - len(normal)
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal / np.outer(scale, scale)
    covariance = None
    if freedom > 0 and np.linalg.cond(scaled) < _LARGEST_CONDITION:
        inverse = np.linalg.inv(scaled) / np.outer(scale, scale) * (squares / freedom)
        covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
        covariance[np.ix_(free, free)] = inverse[: len(free), : len(free)]
    return replace(fit, rms_px=float(np.sqrt(squares / corners)), covariance=covariance)
