"""Camera, poses and warp of the board from corners by least squares, with the covariance of every parameter.

OpenCV's fit, which takes the board for flat, is where scipy's Levenberg and Marquardt starts; the derivatives are those
of `cv2.projectPoints`. The warp of the board is known a priori within a standard deviation, which is one
more observation for each of its parameters. Its weight is that of the corners' noise, so the fit is repeated until
that has settled.

Least squares takes the errors of all corners for independent. Those of one photograph are not if the board was bent
otherwise than in the others, if its light shifts edges, or if the lens model does not fit there. What each view pulls
the lens by then scatters more than independent corners allow. The covariance that holds for any errors within a view is
the sandwich over views (Liang & Zeger 1986, Biometrika 73:13), with the correction for few views that makes it a
jackknife over views to first order: CR3 of Bell & McCaffrey (2002, Survey Methodology 28:169); their CR2, unbiased for
independent corners, tells whether it is needed. It is as uncertain as views are few, so it is used only where the
scatter is significant, and never states less than the corners' noise.

A printed board on a plate is bent by tenths of a millimetre. A fit that takes it for flat changes the focal length
instead: of twelve views of a board 200 mm long, a warp of 0.3 mm puts it off by eight stated standard deviations. So
the height of the board is a parabola along its rows plus one along its columns, as in mrcal, and both are fitted with
the camera. A view may show a part of the board at an unknown place, because a shifted parabola differs from the first
one by a tilt alone. A board as wide as high may also be seen turned by 90 degrees, so its two parabolas are taken to be
equal. A twist of the board is not in the model, nor in mrcal's: one of 0.3 mm makes the error of fx 4.4 times larger.
The scatter between views shows it: the stated deviation is 1.13 of the actual error over 200 sets of
twelve views.

Before the views are seen, each height is zero within 1.5 mm per metre of the board's diagonal, one standard deviation.
Where the views cannot tell it, it stays there, and this deviation is in the uncertainty of the lens.

Each view is compared with the camera that the other views give. It is bad if its corners are off from where that camera
puts them by more than 0.3 px, and by more than three times what is expected: the median over all views and the
uncertainty of the lens that predicts them, together. It is bad too if the focal length that fits it alone differs by
more than 0.6 % and five standard deviations: a change of zoom or focus hardly shows in the corners, because the pose
absorbs it. Views are left out one by one, the worst first, and the rest is fitted and tested anew. In eight careful
views a focal length that is off by 1 % is found, and one off by 0.5 % is not.
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
from labrig.vision.intrinsics import PARAMETERS, BoardWarp, ViewResidual, root_of

_FloatArray = NDArray[np.float64]

LENS = len(PARAMETERS)
_PRIOR_PER_DIAGONAL = 1.5e-3
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
class WarpModel:
    """The parabolas of a board.

    Attributes
    ----------
    middle_mm, half_mm : ndarray (2,)
        Middle of all corners, and half the length of the largest view along rows and columns.
    prior_mm : float
        Standard deviation of a height before the views are seen.
    """

    middle_mm: _FloatArray
    half_mm: _FloatArray
    prior_mm: float

    @classmethod
    def of_boards(cls, boards_mm: Sequence[_FloatArray]) -> "WarpModel":
        """Return the model for a board of which each view shows some corners (N, 2)."""
        corners = np.vstack(boards_mm)
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        half = 0.5 * np.max([np.ptp(board, axis=0) for board in boards_mm], axis=0)
        prior = 2.0 * _PRIOR_PER_DIAGONAL * float(np.hypot(*half))
        return cls(middle, half, prior)

    def shapes(self, board_mm: _FloatArray) -> _FloatArray:
        """Return the heights (N, W) [mm] of corners (N, 2) along z, for one prior deviation of each parabola."""
        parabolas = self.prior_mm * (1.0 - ((board_mm - self.middle_mm) / self.half_mm) ** 2)
        may_turn = np.isclose(self.half_mm[0], self.half_mm[1])
        return np.asarray(parabolas.sum(axis=1, keepdims=True) if may_turn else parabolas)

    def describe(self, warp: _FloatArray, sigma: _FloatArray, *, away: bool) -> BoardWarp:
        """Return the fitted warp [prior deviations] in mm; `away` if z of the board points away from the camera."""
        row, column = np.broadcast_to((-1.0 if away else 1.0) * self.prior_mm * warp, 2)
        sigma_row, sigma_column = np.broadcast_to(self.prior_mm * sigma, 2)
        return BoardWarp(float(row), float(column), float(sigma_row), float(sigma_column), self.prior_mm)


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
    scale : ndarray (P,)
        Square root of the information of each parameter alone, with all poses known.
    """

    information: _FloatArray
    scores: _FloatArray
    prior: _FloatArray
    scale: _FloatArray

    @classmethod
    def of(cls, fit: Fit, views: Sequence[ObservedView]) -> "Pulls":
        """Return the pulls of the views of a fit, in units of the corners' noise."""
        parts, squares, alone = [], 0.0, np.zeros(LENS + len(fit.warp))
        for view, pose in zip(views, fit.poses, strict=True):
            px, shared, by_pose = fit.project(view, pose)
            off = (view.pixels - px).ravel()
            alone += np.sum(shared**2, axis=0)
            shared = _without_pose(shared, by_pose)
            parts.append((shared.T @ shared, shared.T @ off))
            squares += float(off @ off)
        variance = max(squares / max(_count_freedom(views), 1), np.finfo(float).tiny)
        information, scores = (np.array(part) / variance for part in zip(*parts, strict=True))
        prior = np.diag(np.concatenate((np.zeros(LENS), np.ones(len(fit.warp)))))
        scale = np.sqrt(np.maximum(alone / variance + np.diag(prior), np.finfo(float).tiny))
        return cls(information, scores, prior, scale)

    def find_covariance(self, without: int | None = None) -> _FloatArray | None:
        """Return the covariance (P, P) by the corners' noise, of all views or of the others; None if undetermined."""
        total = self.information.sum(axis=0) + self.prior
        if without is not None:
            total = total - self.information[without]
        scaled = total / np.outer(self.scale, self.scale)
        # Of what the poses explain, rounding is left: it must not be scaled up to look like information.
        if not np.isfinite(scaled).all() or np.linalg.eigvalsh(scaled)[0] < _LARGEST_CONDITION**-2:
            return None
        return np.asarray(np.linalg.inv(scaled) / np.outer(self.scale, self.scale))

    def leave_out(self, fit: Fit, index: int) -> Fit | None:
        """Return the camera of the other views, by a step of Gauss and Newton; None if they do not determine it."""
        covariance = self.find_covariance(without=index)
        if covariance is None:
            return None
        step = -covariance @ self.scores[index]
        parameters, warp = fit.parameters + step[:LENS], fit.warp + step[LENS:]
        return replace(fit, parameters=parameters, warp=warp, covariance=covariance)


def _without_pose(columns: _FloatArray, by_pose: _FloatArray) -> _FloatArray:
    """Return columns without the part that a change of the pose explains."""
    basis = np.linalg.qr(by_pose)[0]
    return np.asarray(columns - basis @ (basis.T @ columns))


def _count_freedom(views: Sequence[ObservedView]) -> int:
    return sum(view.pixels.size - _POSE for view in views) - LENS


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
    flat = _fit_flat_board(views, size)
    flat = replace(flat, rms_px=_measure_rms(flat, views))
    if _count_freedom(views) <= 0 or Pulls.of(flat, views).find_covariance() is None:
        return flat
    fit = _minimise(flat, views)
    covariance = Pulls.of(fit, views).find_covariance()
    if covariance is None or fit.parameters[:2].min() <= 0.0:
        return flat
    return replace(fit, rms_px=_measure_rms(fit, views), covariance=covariance)


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


def _minimise(fit: Fit, views: Sequence[ObservedView]) -> Fit:
    """Return the minimum next to a fit."""
    corners = sum(len(view.pixels) for view in views)
    for _ in range(_REWEIGHTINGS):
        noise_px = _measure_rms(fit, views) * np.sqrt(corners / _count_freedom(views))
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
    return fit


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
    alone, off = _without_pose(np.column_stack((by_focal, (view.pixels - px).ravel())), by_pose).T
    told, freedom = float(alone @ alone), len(off) - 1 - _POSE
    if freedom <= 0 or told * _LARGEST_CONDITION**2 < by_focal @ by_focal:
        return 0.0, float("inf")
    change = float(alone @ off) / told
    left = off - change * alone
    return change, float(np.sqrt(left @ left / freedom / told))


def predict_sigma_px(fit: Fit, view: ObservedView, pose: _FloatArray) -> float:
    """Return the root mean square error that the uncertainty of the lens gives the corners of a view, its pose fitted.

    Infinite if the views do not determine the lens.
    """
    if fit.lens_covariance is None:
        return float("inf")
    _, by_shared, by_pose = fit.project(view, pose)
    left = _without_pose(by_shared[:, :LENS] @ root_of(fit.lens_covariance), by_pose)
    return float(np.sqrt(np.sum(left**2) / len(view.pixels)))


def widen_by_views(fit: Fit, views: Sequence[ObservedView]) -> Fit:
    """Return the fit with the covariance by the scatter between views, if that is significant."""
    if fit.covariance is None or len(views) < _LEAST_VIEWS:
        return fit
    pulls = Pulls.of(fit, views)
    # In these units the covariance by the corners' noise is the identity.
    sigma = np.sqrt(np.diag(fit.covariance))
    root = np.linalg.cholesky(fit.covariance / np.outer(sigma, sigma)) * sigma[:, None]
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


LEAST_VIEWS = 3
# In good sets, the worst view is 1.4 to 2.3 times the median.
_OUTLIER_FACTOR, _OUTLIER_PX = 3.0, 0.3
# A view is odd if its focal length differs by more than this share and this many standard deviations.
_LEAST_APART, _APART_SIGMAS = 0.006, 5.0


@dataclass(frozen=True, eq=False)
class Selection:
    """The views that were kept, and the camera fitted to them.

    Attributes
    ----------
    fit : Fit
    kept : tuple of int
    predicted_px : ndarray (K,)
        Error of each kept view as the others predict it; empty with fewer than three views.
    residuals : tuple of ViewResidual
        What every view contributed, or why it was left out.
    """

    fit: Fit
    kept: tuple[int, ...]
    predicted_px: _FloatArray
    residuals: tuple[ViewResidual, ...]


@dataclass(frozen=True)
class _Prediction:
    """What the camera of the other views says about a view.

    error_px, sigma_px : how far its corners are off, and how far that camera's uncertainty puts them.
    longer, sigma : the relative excess of its own focal length, and its standard deviation.
    """

    error_px: float = np.inf
    sigma_px: float = 0.0
    longer: float = 0.0
    sigma: float = np.inf


def select_views(views: Sequence[ObservedView], size: tuple[int, int]) -> Selection:
    """Fit a camera to the views that do not contradict the others.

    Raises
    ------
    CalibrationRefusedError
        If no camera explains the views.
    """
    kept = list(range(len(views)))
    residuals: dict[int, ViewResidual] = {}
    while True:
        chosen = [views[index] for index in kept]
        fit = fit_camera(chosen, size)
        predictions = _predict(fit, chosen)
        found = _find_bad(predictions)
        if found is None:
            break
        worst, reason = found
        bad, error_px = kept.pop(worst), predictions[worst].error_px
        residuals[bad] = ViewResidual(
            views[bad].name, error_px, used=False, reason=reason, corners_px=_list_pairs(views[bad].pixels)
        )
    for index, view, pose in zip(kept, chosen, fit.poses, strict=True):
        corners, errors = (_list_pairs(points) for points in (view.pixels, fit.errors_px(view, pose)))
        rms_px = measure_rms_px(fit, pose, view)
        residuals[index] = ViewResidual(view.name, rms_px, used=True, corners_px=corners, errors_px=errors)
    told = tuple(residuals[index] for index in range(len(views)))
    return Selection(fit, tuple(kept), np.array([view.error_px for view in predictions]), told)


def _list_pairs(points: _FloatArray) -> tuple[tuple[float, float], ...]:
    return tuple((float(u), float(v)) for u, v in points)


def measure_rms_px(fit: Fit, pose: _FloatArray, view: ObservedView) -> float:
    """Return the root mean square distance between a view's corners and their reprojections [px]."""
    return float(np.sqrt(np.mean(np.sum(fit.errors_px(view, pose) ** 2, axis=1))))


def _predict(fit: Fit, views: Sequence[ObservedView]) -> list[_Prediction]:
    """Compare each view with the camera of the others; with fewer than three views nothing can be predicted."""
    if len(views) < LEAST_VIEWS:
        return []
    if fit.covariance is None:
        return [_Prediction()] * len(views)
    pulls = Pulls.of(fit, views)
    return [_predict_view(pulls.leave_out(fit, index), view) for index, view in enumerate(views)]


def _predict_view(others: Fit | None, view: ObservedView) -> _Prediction:
    pose = None if others is None else others.find_pose(view)
    if others is None or others.lens_covariance is None or pose is None:
        return _Prediction()
    longer, alone = estimate_focal_change(others, view, pose)
    focal = float(np.sqrt(others.lens_covariance[0, 0]) / others.parameters[0])
    error_px = measure_rms_px(others, pose, view)
    return _Prediction(error_px, predict_sigma_px(others, view, pose), longer, float(np.hypot(alone, focal)))


def _find_bad(predictions: Sequence[_Prediction]) -> tuple[int, str] | None:
    """Return the worst bad view, and why it is bad."""
    if not predictions or not np.isfinite(np.median([view.error_px for view in predictions])):
        return None
    errors, sigmas = np.array([(view.error_px, view.sigma_px) for view in predictions]).T
    limits = np.maximum(_OUTLIER_PX, _OUTLIER_FACTOR * np.hypot(np.median(errors), sigmas))
    worst = int(np.argmax(errors / limits))
    if errors[worst] > limits[worst]:
        return worst, f"its corners are {errors[worst]:.2f} px from where the other views put them"
    beyond = np.array([_measure_oddness(view) for view in predictions])
    oddest = int(np.argmax(beyond))
    if beyond[oddest] <= 1.0:
        return None
    view = predictions[oddest]
    return oddest, (
        f"the focal length that fits it alone is about {100.0 * abs(view.longer):.1f} % "
        f"{'longer' if view.longer > 0.0 else 'shorter'} than that of the other views: zoom or focus changed, or the "
        "board was bent, moving or blurred"
    )


def _measure_oddness(view: _Prediction) -> float:
    """Return a view's excess of focal length over its limit."""
    return abs(view.longer) / max(_LEAST_APART, _APART_SIGMAS * view.sigma)
