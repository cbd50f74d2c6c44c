"""Which views of a board belong to the camera: bad views are named and left out.

A view is bad if its corners are off from where the other views put them by more than 0.3 px, and by more than three
times what is expected: the median over all views and the uncertainty of the lens that predicts them, together. It is
bad too if its focal length is odd (`mixed_settings`). Views are left out one by one, the worst first, and the rest is
fitted and tested anew. When several views agree on another focal length, they are of another camera setting: none of
them is bad, and the search ends.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labrig.vision.bundle import (
    Fit,
    LensModel,
    ObservedView,
    find_pose,
    fit_camera,
    predict_sigma_px,
    project,
)
from labrig.vision.lens_evidence import LEAST_DIFFERENT_VIEWS
from labrig.vision.mixed_settings import OtherSetting, find_odd_views, find_other_setting, measure_scatter

_FloatArray = NDArray[np.float64]

_FOLDS = 8
# In good sets, the worst view is 1.4 to 2.3 times the median.
_OUTLIER_FACTOR = 3.0
_OUTLIER_PX = 0.3


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
    other : OtherSetting or None
        Kept views that are of another camera setting than the rest.
    scatter : float
        Scatter of the focal lengths of single views over what their standard deviations allow.
    """

    fit: Fit
    kept: tuple[int, ...]
    predicted_px: _FloatArray
    bad: Mapping[int, BadView]
    other: OtherSetting | None
    scatter: float


def select_views(views: Sequence[ObservedView], size: tuple[int, int], model: LensModel) -> Selection:
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
        fit = fit_camera(chosen, size, model)
        predicted = _predict_errors(fit, chosen, size)
        found, other = _find_contradiction(fit, chosen, predicted, size)
        if found is None:
            return Selection(fit, tuple(kept), predicted[:, 0], bad, other, measure_scatter(fit, chosen))
        worst, reason = found
        bad[kept[worst]] = BadView(float(predicted[worst, 0]), reason)
        del kept[worst]


def measure_rms_px(fit: Fit, pose: _FloatArray, view: ObservedView) -> float:
    """Return the root mean square distance between a view's corners and their reprojections [px]."""
    errors = project(fit, pose, view) - view.pixels
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def _find_contradiction(
    fit: Fit, views: Sequence[ObservedView], predicted: _FloatArray, size: tuple[int, int]
) -> tuple[tuple[int, str] | None, OtherSetting | None]:
    """Return the worst bad view and why it is bad, or the other camera setting; None for what is not there."""
    if len(predicted) <= LEAST_DIFFERENT_VIEWS:
        return None, None
    errors, sigmas = predicted.T
    limits = np.maximum(_OUTLIER_PX, _OUTLIER_FACTOR * np.hypot(np.median(errors), sigmas))
    worst = int(np.argmax(errors / limits))
    if errors[worst] > limits[worst]:
        return (worst, f"its corners are {errors[worst]:.2f} px from where the other views put them"), None
    odd = find_odd_views(fit, views, lambda some: fit_camera(some, size, fit.model))
    other = find_other_setting(odd, views)
    if not odd or other is not None:
        return None, other
    oddest = max(odd, key=lambda view: view.sigmas)
    return (oddest.index, oddest.reason), None


def _predict_errors(fit: Fit, views: Sequence[ObservedView], size: tuple[int, int]) -> _FloatArray:
    """Return for each view (V, 2) its reprojection error through a camera fitted without it, and that camera's share.

    The share is the error that the uncertainty of that camera leads to, both in px. Only the pose is fitted to the view
    itself. Up to `_FOLDS` views are left out singly, more views in `_FOLDS` groups. With fewer than three views nothing
    can be predicted, and the result is empty.
    """
    if len(views) < LEAST_DIFFERENT_VIEWS:
        return np.empty((0, 2))
    predicted = np.tile((np.inf, 0.0), (len(views), 1))
    folds = min(len(views), _FOLDS)
    for fold in range(folds):
        rest = [index for index in range(len(views)) if index % folds != fold]
        without = _refit(fit, [views[index] for index in rest], size, rest)
        for index in range(fold, len(views), folds):
            pose = find_pose(without, views[index])
            if pose is not None:
                error = measure_rms_px(without, pose, views[index])
                predicted[index] = error, predict_sigma_px(without, views[index], pose)
    return predicted


def _refit(fit: Fit, views: Sequence[ObservedView], size: tuple[int, int], indices: list[int]) -> Fit:
    """Fit a camera to some of the views of a fit, from that fit if it leads to a minimum, which is quicker."""
    found = fit_camera(views, size, fit.model, replace(fit, poses=fit.poses[indices]))
    return fit_camera(views, size, fit.model) if found.covariance is None else found
