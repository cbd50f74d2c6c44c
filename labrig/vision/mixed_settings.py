"""Whether all views of a board have the same focal length: a bad view does not, and neither do views of two settings.

If zoom, focus or camera changed between the views, the fit spreads the change over all of them: the residual hardly
grows, and the fitted focal length belongs to no setting. So the focal length of each view is estimated on its own, with
the rest of the lens held. If these values fall into two groups, the lens is fitted to the larger group alone, and every
view is odd whose focal length differs from that by more than 0.6 % and five standard deviations. The deviation is that
of the view and of the lens, together, and larger by as much as the views of the larger group scatter more than theirs
allow. In eight careful views a change of 1 % is found, and a change of 0.5 % is not.

A single odd view is a bad one: blurred, moved, or of a board that was bent in the hand. Several odd views are of
another setting if at least two of them, and more than half, agree: their focal lengths differ from their median by no
more than 0.6 %, three standard deviations, or a quarter of the change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.errors import CalibrationRefusedError
from labrig.vision.bundle import Fit, ObservedView, estimate_focal_change

_FloatArray = NDArray[np.float64]

# A view is odd if its focal length differs by more than this share and this many standard deviations.
_LEAST_APART = 0.006
_LEAST_SIGMAS = 5.0
# Odd views agree within this share, this many standard deviations, or this share of the change.
_AGREEMENT = 0.006
_AGREEMENT_SIGMAS = 3.0
_AGREEMENT_SHARE = 0.25
_LEAST_AGREEING = 2
# Standard deviations between two groups above which the larger group is fitted alone.
_SUSPICIOUS_SIGMAS = 3.0
# Largest relative standard deviation of the focal length with which a view takes part in the grouping.
_LARGEST_SIGMA = 0.02
_LEAST_OF_A_SETTING = 3
_ROUNDS = 4
# Median of the magnitude of normally distributed values, in standard deviations.
_MEDIAN_OF_NORMAL = 0.6745


@dataclass(frozen=True)
class OddView:
    """A view whose focal length alone differs from that of the rest.

    Attributes
    ----------
    index : int
        Which view.
    longer : float
        Relative excess of its focal length.
    sigma : float
        Standard deviation of `longer`.
    """

    index: int
    longer: float
    sigma: float

    @property
    def sigmas(self) -> float:
        """By how many standard deviations it differs."""
        return abs(self.longer) / self.sigma

    @property
    def reason(self) -> str:
        """Return why the view is left out."""
        return (
            f"the focal length that fits it alone is {describe_change(self.longer)} than that of the other views "
            f"({self.sigmas:.0f} sigma): the focus changed, or the board was bent, moving or blurred"
        )


@dataclass(frozen=True)
class OtherSetting:
    """Views of another camera setting than the majority, and the relative excess of their focal length."""

    others: tuple[str, ...]
    longer: float

    @property
    def reason(self) -> str:
        """Return why the calibration is refused."""
        return (
            "the views are of two cameras, or of one whose zoom or focus changed: the focal length of "
            f"{', '.join(self.others)} is {describe_change(self.longer)} than that of the rest: photograph all of "
            "them with one camera, autofocus switched off, or leave these out"
        )


def describe_change(longer: float) -> str:
    """Return in words how a focal length differs."""
    return f"about {100.0 * abs(longer):.1f} % {'longer' if longer > 0.0 else 'shorter'}"


def find_odd_views(
    fit: Fit, views: Sequence[ObservedView], refit: Callable[[list[ObservedView]], Fit]
) -> tuple[OddView, ...]:
    """Return the views with another focal length than most.

    There are none either if no camera explains the larger group alone.

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
            return ()
        try:
            alone = refit([views[int(index)] for index in kept])
        except CalibrationRefusedError:
            return ()
        changes = _estimate_changes(alone.with_views(views), views)
        longer, sigmas = changes[:, 0], np.hypot(changes[:, 1], alone.focal_sigma)
        last, kept = kept, np.flatnonzero(~_is_odd(longer, sigmas))
        if np.array_equal(last, kept):
            break
    widened = sigmas * max(1.0, _compare_scatter(longer[last], sigmas[last]))
    odd = np.flatnonzero(_is_odd(longer, widened) & (sigmas < _LARGEST_SIGMA))
    return tuple(OddView(int(index), float(longer[index]), float(widened[index])) for index in odd)


def measure_scatter(fit: Fit, views: Sequence[ObservedView]) -> float:
    """Return the scatter of the views' focal lengths over what their sigmas allow; about 1 in a good fit."""
    longer, sigmas = _estimate_changes(fit, views).T
    return _compare_scatter(longer, np.hypot(sigmas, fit.focal_sigma))


def _compare_scatter(longer: _FloatArray, sigmas: _FloatArray) -> float:
    return float(np.median(np.abs(longer) / sigmas)) / _MEDIAN_OF_NORMAL


def _is_odd(longer: _FloatArray, sigmas: _FloatArray) -> NDArray[np.bool_]:
    return np.asarray(np.abs(longer) > np.maximum(_LEAST_APART, _LEAST_SIGMAS * sigmas))


def find_other_setting(odd: Sequence[OddView], views: Sequence[ObservedView]) -> OtherSetting | None:
    """Return the other camera setting that several odd views agree on; None if each is bad in its own way."""
    if len(odd) < _LEAST_AGREEING:
        return None
    longer, sigmas = np.array([(view.longer, view.sigma) for view in odd]).T
    middle = float(np.median(longer))
    within = np.maximum(max(_AGREEMENT, _AGREEMENT_SHARE * abs(middle)), _AGREEMENT_SIGMAS * sigmas)
    agree = (np.abs(longer - middle) <= within) & (np.sign(longer) == np.sign(middle))
    if agree.sum() < max(_LEAST_AGREEING, 0.5 * (len(odd) + 1)):
        return None
    names = tuple(views[view.index].name for view, does in zip(odd, agree, strict=True) if does)
    return OtherSetting(names, float(np.average(longer[agree], weights=1.0 / sigmas[agree] ** 2)))


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
