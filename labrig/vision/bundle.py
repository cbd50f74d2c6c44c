"""Camera, poses and warp of the board from corners by least squares, with the covariance of every parameter.

There are two lens models. "brown" is OpenCV's with five coefficients. "zhang" is the model of Zhang 2000 (IEEE PAMI
22:1330): two radial coefficients and a skew of the pixel axes. OpenCV has neither the skew nor the warp of the board
(`board_warp`), so Gauss-Newton fits them here, starting from OpenCV's answer for a flat board. The warp is known a
priori within a standard deviation, which is one more observation for each of its parameters; its weight is that of the
corners' noise. The covariance is that of least squares; the residuals and their degrees of freedom give the noise.
OpenCV's own standard deviations count a corner as one observation, not two.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
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
_MAX_HALVINGS = 10
# A sum of squares that grows by no more than this share grows by rounding.
_ROUNDING = 1e-12
# Convergence: the largest effect of a step on all residuals together [px]; rough if it starts from another fit.
_STEP_TOLERANCE_PX = 1e-8
_ROUGH_TOLERANCE_PX = 1e-4
# Keeps a step finite in directions that the views do not determine.
_DAMPING = 1e-12
# Above this condition number of the scaled normal equations a parameter is undetermined.
_LARGEST_CONDITION = 1e13


@dataclass(frozen=True, eq=False)
class ObservedView:
    """The corners of one photograph.

    Attributes
    ----------
    name : str
    board : ndarray (N, 3)
        Points of the flat board [mm].
    pixels : ndarray (N, 2)
    warp_shapes : ndarray (N, W)
        Height of each point [mm], along z of the board, for one prior standard deviation of each parameter of the
        warp. No columns for a board that is taken for flat.
    """

    name: str
    board: _FloatArray
    pixels: _FloatArray
    warp_shapes: _FloatArray


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted camera, the poses of the boards in front of it, and their common warp.

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
    warp : ndarray (W,)
        In prior standard deviations, in the order of `ObservedView.warp_shapes`.
    warp_sigma : ndarray (W,)
        Standard deviations of `warp`, 1 where the views say nothing.
    """

    model: LensModel
    parameters: _FloatArray
    poses: _FloatArray
    rms_px: float
    covariance: _FloatArray | None
    warp: _FloatArray = field(default_factory=lambda: np.empty(0))
    warp_sigma: _FloatArray = field(default_factory=lambda: np.empty(0))

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


def fit_camera(
    views: Sequence[ObservedView], size: tuple[int, int], model: LensModel, start: Fit | None = None
) -> Fit:
    """Fit a camera to views of a board. Views that do not determine it give what the fit started from.

    Parameters
    ----------
    views : sequence of ObservedView
    size : (int, int)
    model : "brown" or "zhang"
    start : Fit, optional
        Camera and poses of these views to start from, for a quick fit to about 0.001 sigma; without it, OpenCV's fit
        for a flat board.

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
    fit = _fit_flat_board(views, size, model) if start is None else start
    equations = _build_normal_equations(fit, views)
    if (
        equations.freedom > 0
        and np.linalg.cond(_scale(equations.weigh_prior(fit)[0])[0]) < _LARGEST_CONDITION
    ):
        tolerance_px = _STEP_TOLERANCE_PX if start is None else _ROUGH_TOLERANCE_PX
        found, at_minimum = _minimise(fit, equations, views, tolerance_px)
        if np.isfinite(found.parameters).all() and found.parameters[:2].min() > 0.0:
            return _add_covariance(found, at_minimum, views)
    rms = float(np.sqrt(equations.squares / corners))
    return replace(fit, rms_px=rms, covariance=None, warp_sigma=np.ones(len(fit.warp)))


def _scale(matrix: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
    """Return a normal matrix with ones on its diagonal, and the root of its diagonal."""
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    return np.asarray(matrix / np.outer(scale, scale)), np.asarray(scale)


def _fit_flat_board(views: Sequence[ObservedView], size: tuple[int, int], model: LensModel) -> Fit:
    """Return OpenCV's fit, which has neither skew nor warp."""
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
    found = np.concatenate((focal, np.ravel(lens)[:5], [0.0]))
    poses = np.array([np.ravel(np.vstack(pose)) for pose in zip(turns, shifts, strict=True)], dtype=float)
    return Fit(model, found, poses, 0.0, None, np.zeros(views[0].warp_shapes.shape[1]))


@contextmanager
def _single_thread() -> Iterator[None]:
    """Run OpenCV in one thread: with several threads the last digits of a camera change from call to call."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def project(fit: Fit, pose: _FloatArray, view: ObservedView) -> _FloatArray:
    """Return the pixels (N, 2) where a view's corners appear with the board in a pose (6,)."""
    return _project(fit, pose, view)[0]


def _bend_board(fit: Fit, view: ObservedView) -> _FloatArray:
    """Return the points (N, 3) of the warped board [mm]."""
    bent = view.board.copy()
    bent[:, 2] += view.warp_shapes @ fit.warp
    return bent


def find_pose(fit: Fit, view: ObservedView) -> _FloatArray | None:
    """Return the pose (6,) of another view through the same camera; None if there is none."""
    straight = view.pixels.copy()
    fy, cy = fit.parameters[1], fit.parameters[3]
    # The skew shifts a pixel along u in proportion to its distance from row cy.
    straight[:, 0] -= fit.parameters[9] * (view.pixels[:, 1] - cy) / fy
    solved, turn, shift = cv2.solvePnP(_bend_board(fit, view), straight, fit.matrix, fit.distortion)
    return np.concatenate((np.ravel(turn), np.ravel(shift))).astype(np.float64) if solved else None


def estimate_focal_change(fit: Fit, view: ObservedView, pose: _FloatArray) -> tuple[float, float]:
    """Return the relative change of the focal length that fits one view alone, and its standard deviation.

    The rest of the lens is held. The deviation is infinite if the view does not separate focal length from distance.
    """
    pixels, by_lens, by_pose = _project(fit, pose, view)
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


def predict_sigma_px(fit: Fit, view: ObservedView, pose: _FloatArray) -> float:
    """Return the root mean square error that the uncertainty of the lens gives the corners of a view, its pose fitted.

    Infinite if the views do not determine the lens.
    """
    if fit.covariance is None:
        return float("inf")
    _, by_lens, by_pose = _project(fit, pose, view)
    values, vectors = np.linalg.eigh(fit.covariance)
    moves = by_lens.reshape(-1, len(PARAMETERS)) @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    camera = by_pose.reshape(-1, _POSE)
    left = moves - camera @ np.linalg.lstsq(camera, moves, rcond=None)[0]
    return float(np.sqrt(np.sum(left**2) / len(view.pixels)))


def _project(fit: Fit, pose: _FloatArray, view: ObservedView) -> tuple[_FloatArray, _FloatArray, _FloatArray]:
    """Return pixels (N, 2) and their derivatives with respect to ten parameters (N, 2, 10) and the pose (N, 2, 6)."""
    board = _bend_board(fit, view)
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


def _differentiate_warp(view: ObservedView, pose: _FloatArray, by_pose: _FloatArray) -> _FloatArray:
    """Return the derivatives (N, 2, W) of the pixels with respect to the warp.

    A point that rises along the board's z moves as if the whole board were shifted that way.
    """
    normal = np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64)[:, 2]
    return np.asarray((by_pose[:, :, 3:] @ normal)[:, :, None] * view.warp_shapes[:, None, :])


@dataclass(frozen=True, eq=False)
class _NormalEquations:
    """Lens, warp and poses in this order: matrix, right side, sum of squared residuals [px^2], and their freedom.

    The prior of the warp is not in them; it adds an observation for each of its parameters.
    """

    matrix: _FloatArray
    side: _FloatArray
    squares: float
    warp: slice
    freedom: int

    @property
    def variance(self) -> float:
        """Variance of a corner's coordinate [px^2]; zero if there are no more observations than unknowns."""
        return self.squares / self.freedom if self.freedom > 0 else 0.0

    def weigh_prior(self, fit: Fit) -> tuple[_FloatArray, _FloatArray]:
        """Return matrix and right side with the prior of the warp."""
        matrix, side = self.matrix.copy(), self.side.copy()
        matrix[self.warp, self.warp] += self.variance * np.eye(len(fit.warp))
        side[self.warp] -= self.variance * fit.warp
        return matrix, side


def linearise_view(
    fit: Fit, view: ObservedView, pose: _FloatArray
) -> tuple[_FloatArray, _FloatArray, _FloatArray]:
    """Return the derivatives of a view's pixels, and its residuals (2N,) [px].

    The derivatives are with respect to the free parameters of the lens and the warp, (2N, F + W), and to the view's own
    pose, (2N, 6).
    """
    pixels, by_lens, by_pose = _project(fit, pose, view)
    shared = np.concatenate(
        (by_lens[:, :, FREE[fit.model]], _differentiate_warp(view, pose, by_pose)), axis=2
    )
    residuals = (view.pixels - pixels).ravel()
    return shared.reshape(len(residuals), -1), by_pose.reshape(-1, _POSE), residuals


def _build_normal_equations(fit: Fit, views: Sequence[ObservedView]) -> _NormalEquations:
    free = FREE[fit.model]
    shared = len(free) + len(fit.warp)
    count = shared + _POSE * len(views)
    normal, side, squares = np.zeros((count, count)), np.zeros(count), 0.0
    for index, (view, pose) in enumerate(zip(views, fit.poses, strict=True)):
        start = shared + _POSE * index
        columns = np.concatenate((np.arange(shared), np.arange(start, start + _POSE)))
        by_shared, by_pose, residuals = linearise_view(fit, view, pose)
        jacobian = np.concatenate((by_shared, by_pose), axis=1)
        normal[np.ix_(columns, columns)] += jacobian.T @ jacobian
        side[columns] += jacobian.T @ residuals
        squares += float(residuals @ residuals)
    freedom = 2 * sum(len(view.pixels) for view in views) + len(fit.warp) - count
    return _NormalEquations(normal, side, squares, slice(len(free), shared), freedom)


def _minimise(
    fit: Fit, equations: _NormalEquations, views: Sequence[ObservedView], tolerance_px: float
) -> tuple[Fit, _NormalEquations]:
    """Return the minimum next to a fit by Gauss-Newton, and the equations there; a step that makes it worse is halved.

    The noise of the corners, which weighs the prior, is estimated anew at each step.
    """
    for _ in range(_MAX_STEPS):
        variance = equations.variance
        matrix, side = equations.weigh_prior(fit)
        scaled, scale = _scale(matrix)
        step = np.linalg.solve(scaled + _DAMPING * np.eye(len(scale)), side / scale) / scale
        limit = (1.0 + _ROUNDING) * (equations.squares + variance * float(fit.warp @ fit.warp))
        for _ in range(_MAX_HALVINGS):
            moved = _move(fit, step)
            equations = _build_normal_equations(moved, views)
            if equations.squares + variance * float(moved.warp @ moved.warp) <= limit:
                break
            step *= 0.5
        fit = moved
        if np.abs(step * scale).max() <= tolerance_px:
            break
    return fit, equations


def _move(fit: Fit, step: _FloatArray) -> Fit:
    free = FREE[fit.model]
    shared = len(free) + len(fit.warp)
    parameters = fit.parameters.copy()
    parameters[free] += step[: len(free)]
    poses = fit.poses + step[shared:].reshape(fit.poses.shape)
    return replace(fit, parameters=parameters, warp=fit.warp + step[len(free) : shared], poses=poses)


def _add_covariance(fit: Fit, equations: _NormalEquations, views: Sequence[ObservedView]) -> Fit:
    """Return the fit with its residual and the covariance of its parameters."""
    scaled, scale = _scale(equations.weigh_prior(fit)[0])
    inverse = np.linalg.inv(scaled) / np.outer(scale, scale) * equations.variance
    free = FREE[fit.model]
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[np.ix_(free, free)] = inverse[: len(free), : len(free)]
    rms = float(np.sqrt(equations.squares / sum(len(view.pixels) for view in views)))
    warp_sigma = np.sqrt(np.diag(inverse)[equations.warp])
    return replace(fit, rms_px=rms, covariance=covariance, warp_sigma=warp_sigma)
