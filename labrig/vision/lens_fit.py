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

Each view is compared with the camera that the other views give, by one step of Gauss and Newton. It is bad if its
corners are off from where that camera puts them by more than 0.3 px, and by more than three times what is expected: the
median over all views and the uncertainty of that camera, together. It is bad too if the focal length that fits it alone
differs by more than 0.6 % and five standard deviations: a change of zoom or focus hardly shows in the corners, because
the pose absorbs it. Views are left out one by one, the worst first, and the rest is fitted and tested anew. In eight
careful views a focal length that is off by 1 % is found, and one off by 0.5 % is not.
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
from labrig.vision.intrinsics import PARAMETERS, ViewResidual, measure_rms

_FloatArray = NDArray[np.float64]

LENS = len(PARAMETERS)
_POSE = 6
# Fits until the noise that weighs the prior of the warp has settled, and scipy's tolerance of each.
_REWEIGHTINGS = 3
_TOLERANCE = 1e-12
# Above this condition number of the scaled Jacobian a parameter is undetermined.
_LARGEST_CONDITION = 3e6
# Fewer views say nothing about one another.
_LEAST_VIEWS = 3
# A view that determines a parameter by itself, by its share of the information, has nothing to be compared with.
_LARGEST_SHARE = 0.999
# Fewer views say too little about their scatter, which is significant so many standard deviations above that of
# independent corners.
_LEAST_SCATTERED, _LEAST_SIGMAS = 5, 4.0
# In good sets, the worst view is 1.4 to 2.3 times the median.
_OUTLIER_FACTOR, _OUTLIER_PX = 3.0, 0.3
# A view is odd if its focal length differs by more than this share and this many standard deviations.
_LEAST_APART, _APART_SIGMAS = 0.006, 5.0


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

    def project(self, shared: _FloatArray, pose: _FloatArray) -> tuple[_FloatArray, _FloatArray, _FloatArray]:
        """Return where a lens shows the corners with the board in a pose (6,), (N, 2) [px], and the derivatives.

        The derivatives are with respect to `shared`, lens and warp (9 + W,), and to the pose: (2 N, 9 + W), (2 N, 6).
        """
        fx, fy, cx, cy = shared[:4]
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        bent = self.board.copy()
        bent[:, 2] += self.warp_shapes @ shared[LENS:]
        found, slopes = cv2.projectPoints(bent, pose[:3], pose[3:], matrix, shared[4:LENS])
        jacobian: _FloatArray = np.asarray(slopes, dtype=np.float64)
        by_pose, by_lens = jacobian[:, :_POSE], jacobian[:, _POSE : _POSE + LENS]
        # A point that rises along the board's z moves as if the whole board were shifted that way.
        by_height = by_pose[:, 3:] @ np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64)[:, 2]
        by_warp = by_height[:, None] * np.repeat(self.warp_shapes, 2, axis=0)
        return np.asarray(found, np.float64).reshape(-1, 2), np.hstack((by_lens, by_warp)), by_pose

    def errors_px(self, shared: _FloatArray, pose: _FloatArray) -> _FloatArray:
        """Return by how much the corners are off where they appear, (N, 2)."""
        return self.project(shared, pose)[0] - self.pixels


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted camera, the common warp of the boards before it, and their poses.

    Attributes
    ----------
    views : tuple of ObservedView
    shared : ndarray (9 + W,)
        Lens in the order of `PARAMETERS`, and warp in prior standard deviations.
    poses : ndarray (V, 6)
        Rotation vector, then shift [mm], of each board.
    covariance : ndarray (9 + W, 9 + W) or None
        Of `shared`; None if the views do not determine it.
    """

    views: tuple[ObservedView, ...]
    shared: _FloatArray
    poses: _FloatArray
    covariance: _FloatArray | None = None

    def errors_px(self) -> list[_FloatArray]:
        """Return by how much the corners of each view are off, (N, 2)."""
        return [view.errors_px(self.shared, pose) for view, pose in zip(self.views, self.poses, strict=True)]

    @property
    def freedom(self) -> int:
        """Number of observations above the unknowns."""
        return sum(view.pixels.size - _POSE for view in self.views) - LENS

    @property
    def noise_px(self) -> float:
        """Standard deviation of the corners' coordinates."""
        squares = float(np.sum(np.vstack(self.errors_px()) ** 2))
        return float(np.sqrt(max(squares / max(self.freedom, 1), np.finfo(float).tiny)))


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
    if fit.freedom <= 0 or _find_covariance(fit) is None:
        return fit
    for _ in range(_REWEIGHTINGS):
        fit = _minimise(fit)
    return replace(fit, covariance=_find_covariance(fit))


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
    no_warp = np.zeros(views[0].warp_shapes.shape[1])
    poses = np.array([np.ravel(np.vstack(pose)) for pose in zip(turns, shifts, strict=True)], dtype=float)
    return Fit(tuple(views), np.concatenate((focal, np.ravel(lens)[:5], no_warp)), poses)


@contextmanager
def _single_thread() -> Iterator[None]:
    """Run OpenCV in one thread: with several threads the last digits of a camera change from call to call."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def _minimise(fit: Fit) -> Fit:
    """Return the least-squares fit next to a fit, the corners' noise being that of the fit."""
    noise_px, end = fit.noise_px, len(fit.shared)

    def unpack(values: _FloatArray) -> Fit:
        return replace(fit, shared=values[:end], poses=values[end:].reshape(-1, _POSE))

    def residuals(values: _FloatArray) -> _FloatArray:
        off = [errors.ravel() for errors in unpack(values).errors_px()]
        return np.concatenate((*off, noise_px * values[LENS:end]))

    def jacobian(values: _FloatArray) -> _FloatArray:
        at = unpack(values)
        slopes = [view.project(at.shared, pose)[1:] for view, pose in zip(fit.views, at.poses, strict=True)]
        by_shared = np.vstack([by_shared for by_shared, _ in slopes])
        corners = np.hstack((by_shared, block_diag(*(by_pose for _, by_pose in slopes))))
        return np.vstack((corners, noise_px * np.eye(len(values))[LENS:end]))

    # Levenberg and Marquardt, as in MINPACK; a step that makes the fit worse is never taken.
    found = least_squares(
        residuals,
        np.concatenate((fit.shared, fit.poses.ravel())),
        jacobian,
        method="lm",
        x_scale="jac",
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
    )
    return unpack(found.x)


def _list_pulls(fit: Fit) -> list[tuple[_FloatArray, _FloatArray]]:
    """Return each view's slopes (2 N, 9 + W) and errors (2 N,) in units of the noise, its own pose eliminated."""
    noise_px, pulls = fit.noise_px, []
    for view, pose in zip(fit.views, fit.poses, strict=True):
        px, by_shared, by_pose = view.project(fit.shared, pose)
        columns = np.column_stack((by_shared, (view.pixels - px).ravel()))
        basis = np.linalg.qr(by_pose)[0]
        left = (columns - basis @ (basis.T @ columns)) / noise_px
        pulls.append((left[:, :-1], left[:, -1]))
    return pulls


def _find_prior(fit: Fit) -> _FloatArray:
    """Return the information of the prior of the warp (9 + W, 9 + W)."""
    return np.diag((np.arange(len(fit.shared)) >= LENS).astype(float))


def _find_covariance(fit: Fit) -> _FloatArray | None:
    """Return the covariance of lens and warp by the corners' noise; None if the views do not determine them."""
    prior = _find_prior(fit)
    total = prior + np.sum([slopes.T @ slopes for slopes, _ in _list_pulls(fit)], axis=0)
    alone = np.vstack(
        [view.project(fit.shared, pose)[1] for view, pose in zip(fit.views, fit.poses, strict=True)]
    )
    scale = np.sqrt(np.sum((alone / fit.noise_px) ** 2, axis=0) + np.diag(prior))
    scaled = total / np.outer(scale, scale)
    # Of what the poses explain, rounding is left: it must not be scaled up to look like information.
    if not np.isfinite(scaled).all() or np.linalg.eigvalsh(scaled)[0] < _LARGEST_CONDITION**-2:
        return None
    return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale))


@dataclass(frozen=True, eq=False)
class _Comparison:
    """Each of V views beside the camera of the others.

    `error_px` (V,) is how far the corners are off, `sigma_px` (V,) how far that camera's uncertainty puts them,
    `longer` and `sigma` (V,) the relative excess of a view's own focal length. The covariance is `root @ root.T`; in
    its units a view has a share (V, P, P) of the information, and a score (V, P), and leaving it out moves the camera
    by a step (V, P).
    """

    error_px: _FloatArray
    sigma_px: _FloatArray
    longer: _FloatArray
    sigma: _FloatArray
    root: _FloatArray
    shares: _FloatArray
    scores: _FloatArray
    steps: _FloatArray


def _compare_views(fit: Fit) -> _Comparison | None:
    """Compare each view with the camera of the others; None if that says nothing about one of them."""
    if fit.covariance is None or len(fit.views) < _LEAST_VIEWS:
        return None
    sigma = np.sqrt(np.diag(fit.covariance))
    root = np.linalg.cholesky(fit.covariance / np.outer(sigma, sigma)) * sigma[:, None]
    pulls = _list_pulls(fit)
    shares = np.array([root.T @ slopes.T @ slopes @ root for slopes, _ in pulls])
    scores = np.array([root.T @ slopes.T @ off for slopes, off in pulls])
    if np.linalg.eigvalsh(shares).max() > _LARGEST_SHARE:
        return None
    others = np.linalg.inv(np.eye(len(root)) - shares)
    steps = np.einsum("vij,vj->vi", others, scores)
    rows = []
    for view, (slopes, off), share, other, step in zip(fit.views, pulls, shares, others, steps, strict=True):
        left = off + slopes @ (root @ step)
        by_focal = slopes[:, :2] @ fit.shared[:2]
        told = max(float(by_focal @ by_focal), np.finfo(float).tiny)
        longer = float(by_focal @ left) / told
        rest = left - longer * by_focal
        freedom = max(len(rest) - 1 - _POSE, 1)
        focal = np.sqrt((root @ other @ root.T)[0, 0]) / fit.shared[0]
        squares = float(left @ left), float(np.sum(share * other))
        px = fit.noise_px * np.sqrt(np.array(squares) / len(view.pixels))
        rows.append((*px, longer, np.hypot(np.sqrt(rest @ rest / freedom / told), focal)))
    error_px, sigma_px, longer, apart = np.array(rows).T
    return _Comparison(error_px, sigma_px, longer, apart, root, shares, scores, steps)


def _find_bad(views: _Comparison) -> tuple[int, str] | None:
    """Return the worst bad view, and why it is bad."""
    limits = np.hypot(np.median(views.error_px), views.sigma_px)
    off = views.error_px / np.maximum(_OUTLIER_PX, _OUTLIER_FACTOR * limits)
    worst = int(np.argmax(off))
    if off[worst] > 1.0:
        return worst, f"its corners are {views.error_px[worst]:.2f} px from where the other views put them"
    apart = np.abs(views.longer) / np.maximum(_LEAST_APART, _APART_SIGMAS * views.sigma)
    oddest = int(np.argmax(apart))
    if apart[oddest] <= 1.0:
        return None
    longer = float(views.longer[oddest])
    return oddest, (
        f"the focal length that fits it alone is about {100.0 * abs(longer):.1f} % "
        f"{'longer' if longer > 0.0 else 'shorter'} than that of the other views: zoom or focus changed, or the "
        "board was bent, moving or blurred"
    )


def _widen_by_views(fit: Fit, views: _Comparison) -> Fit:
    """Return the fit with the covariance by the scatter between views, if that is significant."""
    number, count = views.scores.shape
    ratio = float(np.sum(views.scores * views.steps)) / count
    sigma = float(np.sqrt(2.0 * np.sum(views.shares**2))) / count
    if number < _LEAST_SCATTERED or ratio <= 1.0 + _LEAST_SIGMAS * sigma:
        return fit
    jackknife = (number - 1.0) / number * views.steps.T @ views.steps
    values, vectors = np.linalg.eigh(jackknife + views.root.T @ _find_prior(fit) @ views.root)
    # In these units the covariance by the corners' noise is the identity.
    spread = views.root @ (vectors * np.sqrt(np.maximum(values, 1.0)))
    return replace(fit, covariance=spread @ spread.T)


@dataclass(frozen=True, eq=False)
class Selection:
    """The camera fitted to the views that do not contradict the others.

    Attributes
    ----------
    fit : Fit
    holdout_px : float or None
        Rms error of each kept view as the others predict it; None if they do not.
    residuals : tuple of ViewResidual
        What every view contributed, or why it was left out.
    """

    fit: Fit
    holdout_px: float | None
    residuals: tuple[ViewResidual, ...]


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
        fit = fit_camera([views[index] for index in kept], size)
        compared = _compare_views(fit)
        bad = None if compared is None else _find_bad(compared)
        if compared is None or bad is None:
            break
        worst, reason = bad
        view, error_px = views[kept.pop(worst)], float(compared.error_px[worst])
        residuals[views.index(view)] = ViewResidual(
            view.name, error_px, used=False, reason=reason, corners_px=_list_pairs(view.pixels)
        )
    for index, errors in zip(kept, fit.errors_px(), strict=True):
        corners, rms_px = views[index].pixels, measure_rms(errors)
        residuals[index] = ViewResidual(
            views[index].name,
            rms_px,
            used=True,
            corners_px=_list_pairs(corners),
            errors_px=_list_pairs(errors),
        )
    told = tuple(residuals[index] for index in range(len(views)))
    if compared is None:
        return Selection(fit, None, told)
    return Selection(_widen_by_views(fit, compared), float(np.sqrt(np.mean(compared.error_px**2))), told)


def _list_pairs(points: _FloatArray) -> tuple[tuple[float, float], ...]:
    return tuple((float(u), float(v)) for u, v in points)
