"""Whether all views of a board come from one camera setting.

If zoom, focus or camera changed between the views, the fit spreads the change over all of them: the residual hardly
grows, and the fitted focal length belongs to no setting. So the focal length of each view is estimated on its own, with
the rest of the lens held. If these values fall into two groups, the lens is fitted to the larger group alone, and every
view that contradicts this lens is of another setting. In eight careful views a change of 1 % is found, and a change of
0.5 % is not.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.errors import CalibrationRefusedError
from labrig.vision.bundle import Fit, ObservedView, estimate_focal_change

_FloatArray = NDArray[np.float64]

# A view is of another setting if its focal length differs by more than this share and this many standard deviations.
_LEAST_APART = 0.006
_LEAST_SIGMAS = 5.0
# Standard deviations between two groups above which the larger group is fitted alone.
_SUSPICIOUS_SIGMAS = 3.0
# Largest relative standard deviation of the focal length with which a view takes part in the grouping.
_LARGEST_SIGMA = 0.02
_LEAST_OF_A_SETTING = 3
_ROUNDS = 4


@dataclass(frozen=True)
class OtherSetting:
    """Views of another camera setting than the majority, and the relative excess of their focal length."""

    others: tuple[str, ...]
    longer: float

    @property
    def difference(self) -> str:
        """Return in words how the focal length differs."""
        return f"about {100.0 * abs(self.longer):.1f} % {'longer' if self.longer > 0.0 else 'shorter'}"

    @property
    def reason(self) -> str:
        """Return why the calibration is refused."""
        return (
            "the views are of two cameras, or of one whose zoom or focus changed: the focal length of "
            f"{', '.join(self.others)} is {self.difference} than that of the rest: photograph all of them with one "
            "camera, autofocus switched off, or leave these out"
        )


def find_other_setting(
    fit: Fit, views: Sequence[ObservedView], refit: Callable[[list[ObservedView]], Fit]
) -> OtherSetting | None:
    """Return the views of another camera setting than most; None if there is no evidence for another setting.

    There is none either if no camera explains the larger group alone.

    Parameters
    ----------
    fit : Fit
        Fit to all views.
    views : sequence of ObservedView
    refit : callable
        Fits a camera to some of the views.
    """
    kept = _find_larger_group(_estimate_changes(fit, views))
    for _ in range(_ROUNDS):
        if kept is None or len(kept) < _LEAST_OF_A_SETTING or len(kept) == len(views):
            return None
        try:
            alone = refit([views[int(index)] for index in kept])
        except CalibrationRefusedError:
            return None
        changes = _estimate_changes(alone.with_views(views), views)
        sigmas = np.hypot(changes[:, 1], alone.focal_sigma)
        other = (np.abs(changes[:, 0]) > np.maximum(_LEAST_APART, _LEAST_SIGMAS * sigmas)) & (
            sigmas < _LARGEST_SIGMA
        )
        last, kept = kept, np.flatnonzero(~other)
        if np.array_equal(last, kept):
            break
    if not other.any():
        return None
    longer = float(np.average(changes[other, 0], weights=1.0 / changes[other, 1] ** 2))
    return OtherSetting(tuple(views[int(index)].name for index in np.flatnonzero(other)), longer)


def _estimate_changes(fit: Fit, views: Sequence[ObservedView]) -> _FloatArray:
    """Return for each view (V, 2) the relative change of its focal length, and the standard deviation of the change."""
    return np.array(
        [
            estimate_focal_change(fit, view, pose) if np.isfinite(pose).all() else (0.0, np.inf)
            for view, pose in zip(views, fit.poses, strict=True)
        ]
    )


def _find_larger_group(changes: _FloatArray) -> NDArray[np.intp] | None:
    """Return the larger of two groups of views; None if there is only one group."""
    known = np.flatnonzero(changes[:, 1] < _LARGEST_SIGMA)
    order = known[np.argsort(changes[known, 0])]
    if len(order) < _LEAST_OF_A_SETTING + 1:
        return None
    values, sigmas = changes[order].T
    significances = [_significance(values, sigmas, cut) for cut in range(1, len(order))]
    cut = 1 + int(np.argmax(significances))
    if significances[cut - 1] < _SUSPICIOUS_SIGMAS:
        return None
    larger = max(order[:cut], order[cut:], key=len)
    return np.sort(larger)


def _significance(values: _FloatArray, sigmas: _FloatArray, cut: int) -> float:
    """Return by how many standard deviations the means before and after a cut differ.

    The scatter within a group counts as uncertainty too.
    """
    means, variance = [], 0.0
    for part in (slice(None, cut), slice(cut, None)):
        weights = 1.0 / sigmas[part] ** 2
        means.append(float(np.average(values[part], weights=weights)))
        excess = float(np.average((values[part] - means[-1]) ** 2, weights=weights))
        variance += 1.0 / float(weights.sum()) + excess / len(weights)
    return (means[1] - means[0]) / float(np.sqrt(variance))
