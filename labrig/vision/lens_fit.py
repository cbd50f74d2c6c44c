"""Camera, poses and warp of the board from corners by least squares, with the covariance of every parameter.

OpenCV's fit, which takes the board for flat, is where scipy's Levenberg and Marquardt starts; the derivatives are those
of `cv2.projectPoints`. The warp of the board (`boards`) is known a priori within a standard deviation, which is one
more observation for each of its parameters. Its weight is that of the corners' noise, so the fit is repeated until
that has settled.

Least squares takes the errors of all corners for independent. Those of one photograph are not if the board was bent
otherwise than in the others, if its light shifts edges, or if the lens model does not fit there. What each view pulls
the lens by then scatters more than independent corners allow. The covariance that holds for any errors within a view is
the sandwich over views (Liang & Zeger 1986, Biometrika 73:13), with the correction for few views that makes it a
jackknife over views to first order: CR3 of Bell & McCaffrey (2002, Survey Methodology 28:169); their CR2, unbiased for
independent corners, tells whether it is needed. It is as uncertain as views are few, so it is used only where the
scatter is significant, and never states less than the corners' noise.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from labrig.errors import CalibrationRefusedError
from labrig.vision.intrinsics import PARAMETERS, root_of

_FloatArray = NDArray[np.float64]

LENS = len(PARAMETERS)
_POSE = 6
# Fits until the noise that weighs the prior of the warp has settled, and scipy's tolerance of each.
_REWEIGHTINGS = 3
_TOLERANCE = 1e-12
# Above this condition number of the scaled Jacobian a parameter is undetermined.
_LARGEST_CONDITION = 3e6
# Fewer views say too little about their scatter, which is significant so many standard deviations above that of
# independent corners. A view that determines a parameter by itself, by its share of the information, has nothing to be
# compared with.
_LEAST_VIEWS, _LEAST_SIGMAS, _LARGEST_SHARE = 5, 4.0, 0.999


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
        warp.
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
    parameters : ndarray (9,)
        In the order of `PARAMETERS`.
    warp : ndarray (W,)
        In prior standard deviations, in the order of `ObservedView.warp_shapes`.
    poses : ndarray (V, 6)
        Rotation vector, then shift [mm], of each board.
    rms_px : float
    covariance : ndarray (9 + W, 9 + W) or None
        Of parameters and warp; None if the views do not determine them.
    by_views : bool
        Whether the covariance rests on the scatter between views.
    """

    parameters: _FloatArray
    warp: _FloatArray
    poses: _FloatArray
    rms_px: float = 0.0
    covariance: _FloatArray | None = None
    by_views: bool = False

    @property
    def matrix(self) -> _FloatArray:
        """Camera matrix (3, 3)."""
        fx, fy, cx, cy = self.parameters[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def lens_covariance(self) -> _FloatArray | None:
        """Covariance (9, 9) of the parameters."""
        return None if self.covariance is None else self.covariance[:LENS, :LENS]

    @property
    def warp_sigma(self) -> _FloatArray:
        """Standard deviations (W,) of the warp, 1 where the views say nothing."""
        if self.covariance is None:
            return np.ones(len(self.warp))
        return np.sqrt(np.diag(self.covariance)[LENS:])

    def project(self, view: ObservedView, pose: _FloatArray) -> tuple[_FloatArray, _FloatArray, _FloatArray]:
        """Return where a view's corners appear with the board in a pose (6,), (N, 2) [px], and the derivatives.

        The derivatives (2 N, 9 + W) are with respect to parameters and warp, and (2 N, 6) to the pose.
        """
        board = self._bend(view)
        found, slopes = cv2.projectPoints(board, pose[:3], pose[3:], self.matrix, self.parameters[4:])
        jacobian: _FloatArray = np.asarray(slopes, dtype=np.float64)
        by_pose, by_lens = jacobian[:, :_POSE], jacobian[:, _POSE : _POSE + LENS]
        # A point that rises along the board's z moves as if the whole board were shifted that way.
        normal = np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64)[:, 2]
        by_warp = (by_pose[:, 3:] @ normal)[:, None] * np.repeat(view.warp_shapes, 2, axis=0)
        shared = np.asarray(np.hstack((by_lens, by_warp)), dtype=np.float64)
        return np.asarray(found, np.float64).reshape(-1, 2), shared, by_pose

    def errors_px(self, view: ObservedView, pose: _FloatArray) -> _FloatArray:
        """Return by how much a view's corners are off where they appear, (N, 2)."""
        return self.project(view, pose)[0] - view.pixels

    def find_pose(self, view: ObservedView) -> _FloatArray | None:
        """Return the pose (6,) of another view through the same camera; None if there is none."""
        solved, turn, shift = cv2.solvePnP(self._bend(view), view.pixels, self.matrix, self.parameters[4:])
        return np.concatenate((np.ravel(turn), np.ravel(shift))).astype(np.float64) if solved else None

    def _bend(self, view: ObservedView) -> _FloatArray:
        """Return the points (N, 3) of the warped board [mm]."""
        bent = view.board.copy()
        bent[:, 2] += view.warp_shapes @ self.warp
        return bent


@dataclass(frozen=True, eq=False)
class Pulls:
    """What each view says about parameters and warp, P in all, with its own pose eliminated.

    Attributes
    ----------
    information : ndarray (V, P, P)
    scores : ndarray (V, P)
        Gradient of each view's sum of squares.
    prior : ndarray (P, P)
        Information of the prior of the warp.
    """

    information: _FloatArray
    scores: _FloatArray
    prior: _FloatArray

    @classmethod
    def of(cls, fit: Fit, views: Sequence[ObservedView]) -> "Pulls":
        """Return the pulls of the views of a fit, in units of the corners' noise."""
        parts, squares = [], 0.0
        for view, pose in zip(views, fit.poses, strict=True):
            px, shared, by_pose = fit.project(view, pose)
            off = (view.pixels - px).ravel()
            basis = np.linalg.qr(by_pose)[0]
            shared = shared - basis @ (basis.T @ shared)
            parts.append((shared.T @ shared, shared.T @ off))
            squares += float(off @ off)
        freedom = sum(view.pixels.size - _POSE for view in views) - LENS
        variance = max(squares / max(freedom, 1), np.finfo(float).tiny)
        information, scores = (np.array(part) / variance for part in zip(*parts, strict=True))
        prior = np.diag(np.concatenate((np.zeros(LENS), np.ones(len(fit.warp)))))
        return cls(information, scores, prior)

    def leave_out(self, fit: Fit, index: int) -> Fit | None:
        """Return the camera of the other views, by a step of Gauss and Newton; None if they do not determine it."""
        left = self.information.sum(axis=0) - self.information[index] + self.prior
        scale = np.sqrt(np.maximum(np.diag(left), np.finfo(float).tiny))
        scaled = left / np.outer(scale, scale)
        if np.linalg.cond(scaled) > _LARGEST_CONDITION**2:
            return None
        covariance = np.linalg.inv(scaled) / np.outer(scale, scale)
        step = -covariance @ self.scores[index]
        parameters, warp = fit.parameters + step[:LENS], fit.warp + step[LENS:]
        return replace(fit, parameters=parameters, warp=warp, covariance=covariance)


def fit_camera(views: Sequence[ObservedView], size: tuple[int, int]) -> Fit:
    """Fit a camera to views of a board. Views that do not determine it give OpenCV's fit, without a covariance.

    Raises
    ------
    CalibrationRefusedError
        If no camera explains the views.
    """
    corners, unknown = sum(len(view.pixels) for view in views), LENS + _POSE * len(views)
    if 2 * corners < unknown:
        raise CalibrationRefusedError(
            f"{corners} corners are too few for a camera, {-(-unknown // 2)} are the least",
            "photograph the board in more poses, and more of it",
        )
    fit = _fit_flat_board(views, size)
    freedom = 2 * corners - unknown
    if freedom > 0 and _scale(_Problem(views, fit, 0.0).jacobian(_pack(fit)))[2] < _LARGEST_CONDITION:
        found = _minimise(fit, views, freedom)
        if found is not None:
            return found
    return replace(fit, rms_px=_measure_rms(fit, views))


def _fit_flat_board(views: Sequence[ObservedView], size: tuple[int, int]) -> Fit:
    boards = [view.board.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    try:
        with _single_thread():
            _, matrix, lens, turns, shifts = cv2.calibrateCamera(boards, pixels, size, None, None)
    except cv2.error as error:
        raise CalibrationRefusedError(
            f"no camera explains the {len(views)} views: {error.err}",
            "photograph the board tilted in several ways",
        ) from error
    focal = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])
    poses = np.array([np.ravel(np.vstack(pose)) for pose in zip(turns, shifts, strict=True)], dtype=float)
    return Fit(np.concatenate((focal, np.ravel(lens)[:5])), np.zeros(views[0].warp_shapes.shape[1]), poses)


@contextmanager
def _single_thread() -> Iterator[None]:
    """Run OpenCV in one thread: with several threads the last digits of a camera change from call to call."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def _pack(fit: Fit) -> _FloatArray:
    return np.concatenate((fit.parameters, fit.warp, fit.poses.ravel()))


@dataclass(frozen=True, eq=False)
class _Problem:
    """The least squares of some views from a fit on, the corners' noise [px] being known."""

    views: Sequence[ObservedView]
    start: Fit
    noise_px: float

    def unpack(self, values: _FloatArray) -> Fit:
        warp_end = LENS + len(self.start.warp)
        poses = values[warp_end:].reshape(-1, _POSE)
        return replace(self.start, parameters=values[:LENS], warp=values[LENS:warp_end], poses=poses)

    def residuals(self, values: _FloatArray) -> _FloatArray:
        fit = self.unpack(values)
        off = [fit.errors_px(view, pose).ravel() for view, pose in zip(self.views, fit.poses, strict=True)]
        return np.concatenate((*off, self.noise_px * fit.warp))

    def jacobian(self, values: _FloatArray) -> _FloatArray:
        fit = self.unpack(values)
        slopes = [fit.project(view, pose)[1:] for view, pose in zip(self.views, fit.poses, strict=True)]
        shared = np.vstack([by_shared for by_shared, _ in slopes])
        corners = np.hstack((shared, block_diag(*(by_pose for _, by_pose in slopes))))
        prior = np.zeros((len(fit.warp), corners.shape[1]))
        prior[:, LENS : LENS + len(fit.warp)] = self.noise_px * np.eye(len(fit.warp))
        return np.vstack((corners, prior))


def _minimise(fit: Fit, views: Sequence[ObservedView], freedom: int) -> Fit | None:
    """Return the minimum next to a fit, and its covariance; None if the views do not determine it."""
    for _ in range(_REWEIGHTINGS):
        noise_px = _measure_rms(fit, views) * np.sqrt(sum(len(view.pixels) for view in views) / freedom)
        problem = _Problem(views, fit, float(noise_px))
        # Levenberg and Marquardt, as in MINPACK; a step that makes the fit worse is never taken.
        found = least_squares(
            problem.residuals,
            _pack(fit),
            problem.jacobian,
            method="lm",
            x_scale="jac",
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=_TOLERANCE,
        )
        fit = problem.unpack(found.x)
    scaled, scale, condition = _scale(np.asarray(found.jac, dtype=np.float64))
    if not (condition < _LARGEST_CONDITION and fit.parameters[:2].min() > 0.0):
        return None
    rms_px = _measure_rms(fit, views)
    variance = rms_px**2 * sum(len(view.pixels) for view in views) / freedom
    covariance = np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale) * variance
    shared = LENS + len(fit.warp)
    return replace(fit, rms_px=rms_px, covariance=covariance[:shared, :shared])


def _scale(jacobian: _FloatArray) -> tuple[_FloatArray, _FloatArray, float]:
    """Return a Jacobian with columns of length one, their lengths before, and its condition number."""
    lengths = np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(float).tiny)
    scaled = jacobian / lengths
    if not np.isfinite(scaled).all():
        return scaled, lengths, np.inf
    return scaled, lengths, float(np.linalg.cond(scaled))


def _measure_rms(fit: Fit, views: Sequence[ObservedView]) -> float:
    """Return the root mean square distance between corners and their reprojections [px]."""
    off = np.vstack([fit.errors_px(view, pose) for view, pose in zip(views, fit.poses, strict=True)])
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def estimate_focal_change(fit: Fit, view: ObservedView, pose: _FloatArray) -> tuple[float, float]:
    """Return the relative change of the focal length that fits one view alone, and its standard deviation.

    The rest of the lens is held. The deviation is infinite if the view does not separate focal length from distance.
    """
    px, by_shared, by_pose = fit.project(view, pose)
    by_focal = by_shared[:, :2] @ fit.parameters[:2]
    scaled, scale, condition = _scale(np.column_stack((by_focal, by_pose)))
    off = (view.pixels - px).ravel()
    if len(off) <= 1 + _POSE or condition > _LARGEST_CONDITION:
        return 0.0, float("inf")
    inverse = np.linalg.inv(scaled.T @ scaled)
    step = inverse @ (scaled.T @ off)
    left = off - scaled @ step
    variance = float(left @ left) / (len(off) - 1 - _POSE)
    return float(step[0] / scale[0]), float(np.sqrt(inverse[0, 0] * variance) / scale[0])


def predict_sigma_px(fit: Fit, view: ObservedView, pose: _FloatArray) -> float:
    """Return the root mean square error that the uncertainty of the lens gives the corners of a view, its pose fitted.

    Infinite if the views do not determine the lens.
    """
    if fit.lens_covariance is None:
        return float("inf")
    _, by_shared, by_pose = fit.project(view, pose)
    moves = by_shared[:, :LENS] @ root_of(fit.lens_covariance)
    left = moves - by_pose @ np.linalg.lstsq(by_pose, moves, rcond=None)[0]
    return float(np.sqrt(np.sum(left**2) / len(view.pixels)))


def widen_by_views(fit: Fit, views: Sequence[ObservedView]) -> Fit:
    """Return the fit with the covariance by the scatter between views, if that is significant."""
    if fit.covariance is None or len(views) < _LEAST_VIEWS:
        return fit
    pulls = Pulls.of(fit, views)
    total = pulls.information.sum(axis=0) + pulls.prior
    scale = np.sqrt(np.diag(total))
    # In these units the covariance by the corners' noise is the identity.
    root = np.linalg.inv(np.linalg.cholesky(total / np.outer(scale, scale))).T / scale[:, None]
    shares, scores = root.T @ pulls.information @ root, pulls.scores @ root
    if np.linalg.eigvalsh(shares).max() > _LARGEST_SHARE or not _is_significant(shares, scores):
        return fit
    count, number = scores.shape[1], len(views)
    left = np.linalg.solve(np.eye(count) - shares, scores[:, :, None])[:, :, 0]
    values, vectors = np.linalg.eigh((number - 1.0) / number * left.T @ left + root.T @ pulls.prior @ root)
    scatter = vectors * np.maximum(values, 1.0) @ vectors.T
    return replace(fit, covariance=root @ scatter @ root.T, by_views=True)


def _is_significant(shares: _FloatArray, scores: _FloatArray) -> bool:
    """Return whether the views scatter more than independent corners allow, over all parameters together."""
    values, vectors = np.linalg.eigh(shares)
    turned = np.einsum("vpk,vp->vk", vectors, scores)
    count = scores.shape[1]
    ratio = float(np.sum(turned**2 / (1.0 - values))) / count
    sigma = float(np.sqrt(2.0 * np.sum(values**2))) / count
    return bool(ratio > 1.0 + _LEAST_SIGMAS * sigma)
