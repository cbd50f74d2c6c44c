"""The covariance of a lens from the scatter between views, where it is larger than the corners' noise explains.

Least squares takes the errors of all corners for independent. Those of one photograph are not if the board was bent
otherwise than in the others, if its light shifts edges, or if the lens model does not fit there. What each view pulls
the lens by then scatters more than independent corners allow. The covariance that holds for any errors within a view is
the sandwich over views (Liang & Zeger 1986, Biometrika 73:13), with the correction for few views that makes it a
jackknife over views to first order: CR3 of Bell & McCaffrey (2002, Survey Methodology 28:169); their CR2, unbiased for
independent corners, tells whether it is needed. It is as uncertain as views are few, so it is used only where the
scatter is significant, and never states less than the corners' noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labrig.vision.bundle import FREE, Fit, ObservedView, linearise_view

_FloatArray = NDArray[np.float64]

# Fewer views say too little about their scatter.
_LEAST_VIEWS = 5
# The scatter over what independent corners give is significant so many standard deviations above one.
_LEAST_SIGMAS = 4.0
# A view that determines a parameter by itself has nothing to be compared with: its largest share of the information.
_LARGEST_SHARE = 0.999


@dataclass(frozen=True, eq=False)
class _Pulls:
    """What views contribute, in units in which the covariance by the corners' noise is the identity.

    Attributes
    ----------
    root : ndarray (P, P)
        The covariance by the corners' noise is root times its transpose.
    shares : ndarray (V, P, P)
        Information of each view; those of the views and of the prior add up to the identity.
    scores : ndarray (V, P)
        Gradient of each view's sum of squares.
    prior : ndarray (P, P)
        Information of the prior of the warp.
    """

    root: _FloatArray
    shares: _FloatArray
    scores: _FloatArray
    prior: _FloatArray


def widen_by_views(fit: Fit, views: Sequence[ObservedView]) -> tuple[Fit, bool]:
    """Return the fit with the covariance by the scatter between views if that is significant, and whether it is."""
    if fit.covariance is None or len(views) < _LEAST_VIEWS:
        return fit, False
    pulls = _measure_pulls(fit, views)
    if np.linalg.eigvalsh(pulls.shares).max() > _LARGEST_SHARE or not _is_significant(pulls):
        return fit, False
    covariance = pulls.root @ _scatter(pulls) @ pulls.root.T
    free = FREE[fit.model]
    wider = np.zeros_like(fit.covariance)
    wider[np.ix_(free, free)] = covariance[: len(free), : len(free)]
    return replace(fit, covariance=wider, warp_sigma=np.sqrt(np.diag(covariance)[len(free) :])), True


def _measure_pulls(fit: Fit, views: Sequence[ObservedView]) -> _Pulls:
    """Return the pulls of the views on lens and warp; each view's own pose is eliminated."""
    information, sides, squares = [], [], 0.0
    for view, pose in zip(views, fit.poses, strict=True):
        shared, by_pose, residuals = linearise_view(fit, view, pose)
        basis = np.linalg.qr(by_pose)[0]
        shared = shared - basis @ (basis.T @ shared)
        information.append(shared.T @ shared)
        sides.append(shared.T @ residuals)
        squares += float(residuals @ residuals)
    lens, count = len(FREE[fit.model]), len(sides[0])
    variance = squares / (sum(view.pixels.size - fit.poses.shape[1] for view in views) - lens)
    prior = np.diag(np.concatenate((np.zeros(lens), np.ones(count - lens))))
    total = np.sum(information, axis=0) / variance + prior
    scale = np.sqrt(np.diag(total))
    root = np.linalg.inv(np.linalg.cholesky(total / np.outer(scale, scale))).T / scale[:, None]
    return _Pulls(
        root,
        root.T @ np.array(information) @ root / variance,
        np.array(sides) @ root / variance,
        root.T @ prior @ root,
    )


def _is_significant(pulls: _Pulls) -> bool:
    """Return whether the views scatter more than independent corners allow, over all parameters together."""
    values, vectors = np.linalg.eigh(pulls.shares)
    turned = np.einsum("vpk,vp->vk", vectors, pulls.scores)
    count = pulls.scores.shape[1]
    ratio = float(np.sum(turned**2 / (1.0 - values))) / count
    sigma = float(np.sqrt(2.0 * np.sum(values**2))) / count
    return bool(ratio > 1.0 + _LEAST_SIGMAS * sigma)


def _scatter(pulls: _Pulls) -> _FloatArray:
    """Return the covariance by the scatter between views (P, P), in no direction below that of the corners' noise."""
    count, views = pulls.scores.shape[1], len(pulls.scores)
    left = np.linalg.solve(np.eye(count) - pulls.shares, pulls.scores[:, :, None])[:, :, 0]
    values, vectors = np.linalg.eigh((views - 1.0) / views * left.T @ left + pulls.prior)
    return np.asarray(vectors * np.maximum(values, 1.0) @ vectors.T)
