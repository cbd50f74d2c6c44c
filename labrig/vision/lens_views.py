"""Which views of a board belong to the camera: bad views are named and left out.

Each view is compared with the camera that the other views give. It is bad if its corners are off from where that camera
puts them by more than 0.3 px, and by more than three times what is expected: the median over all views and the
uncertainty of the lens that predicts them, together. It is bad too if the focal length that fits it alone differs by
more than 0.6 % and five standard deviations: a change of zoom or focus hardly shows in the corners, because the pose
absorbs it. Views are left out one by one, the worst first, and the rest is fitted and tested anew. In eight careful
views a focal length that is off by 1 % is found, and one off by 0.5 % is not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.vision.lens_fit import (
    Fit,
    ObservedView,
    Pulls,
    estimate_focal_change,
    fit_camera,
    predict_sigma_px,
)

_FloatArray = NDArray[np.float64]

LEAST_VIEWS = 3
# In good sets, the worst view is 1.4 to 2.3 times the median.
_OUTLIER_FACTOR, _OUTLIER_PX = 3.0, 0.3
# A view is odd if its focal length differs by more than this share and this many standard deviations.
_LEAST_APART, _LEAST_SIGMAS = 0.006, 5.0


@dataclass(frozen=True)
class BadView:
    """A view that is left out: the error of its corners as the other views predict them [px], and why."""

    rms_px: float
    reason: str


@dataclass(frozen=True, eq=False)
class Selection:
    """The views that were kept, and the camera fitted to them.

    Attributes
    ----------
    fit : Fit
    kept : tuple of int
    predicted_px : ndarray (K,)
        Error of each kept view as the others predict it; empty with fewer than three views.
    bad : mapping of int to BadView
    """

    fit: Fit
    kept: tuple[int, ...]
    predicted_px: _FloatArray
    bad: Mapping[int, BadView]


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
    bad: dict[int, BadView] = {}
    while True:
        chosen = [views[index] for index in kept]
        fit = fit_camera(chosen, size)
        predictions = _predict(fit, chosen)
        found = _find_bad(predictions)
        if found is None:
            return Selection(fit, tuple(kept), np.array([view.error_px for view in predictions]), bad)
        worst, reason = found
        bad[kept[worst]] = BadView(predictions[worst].error_px, reason)
        del kept[worst]


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
    return abs(view.longer) / max(_LEAST_APART, _LEAST_SIGMAS * view.sigma)
