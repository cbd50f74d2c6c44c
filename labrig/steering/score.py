"""Which of many candidate paths are feasible, and which of these is best."""

import numpy as np
from numpy.typing import NDArray

from labrig.needle import path_frames
from labrig.steering.clearance import path_distances
from labrig.steering.problem import Surroundings

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_RADIUS_ERROR = 0.01
_ROUNDING = 1e-9
_NO_ARC_RAD = 1e-9


def feasible(psi: FloatArray, around: Surroundings) -> BoolArray:
    """Return which paths (M, n, 2) reach the target, keep off the obstacles, and stay within the caps, (M,)."""
    problem = around.problem
    frames = path_frames(psi, problem.radius_mm)
    errors = np.linalg.norm(frames.positions_mm[:, -1] - around.target_mm, axis=-1)
    # With a cap of 90 degrees or less an arc whose ends point forwards points forwards everywhere.
    headings = frames.rotations[:, :, 2, 2].min(axis=-1)
    good = (errors <= problem.tolerance_mm) & (headings >= np.cos(problem.max_heading_rad) - _ROUNDING)
    good &= np.all((psi[..., 0] >= 0) & (psi[..., 0] <= np.pi), axis=-1)
    good &= problem.radius_mm * psi[..., 0].sum(axis=-1) <= problem.max_length_mm + _ROUNDING
    if len(around.centres_mm):
        chosen = np.flatnonzero(good)
        apart = path_distances(psi[chosen], problem.radius_mm, around.centres_mm)
        good[chosen] = np.all(apart >= around.keep_off_mm - _ROUNDING, axis=-1)
    return np.asarray(good)


def costs(psi: FloatArray, around: Surroundings) -> FloatArray:
    """Return the weighted cost of each path (M, n, 2), (M,); `PlanWeights` says what costs what."""
    weights, radius_mm = around.problem.weights, around.problem.radius_mm
    tips = path_frames(psi, radius_mm).positions_mm[:, -1]
    # The lengths inserted and the rolls stay as planned while the radius is another one.
    wider = psi * np.array([1 / (1 + _RADIUS_ERROR), 1.0])
    moved = path_frames(wider, radius_mm * (1 + _RADIUS_ERROR)).positions_mm[:, -1] - tips
    cost = weights.length_per_mm * radius_mm * psi[..., 0].sum(axis=-1)
    cost = cost + weights.turn * (psi[..., 0] > _NO_ARC_RAD).sum(axis=-1)
    cost += weights.target_error_per_mm * np.linalg.norm(tips - around.target_mm, axis=-1)
    cost += weights.curvature_per_mm * np.linalg.norm(moved, axis=-1)
    if len(around.centres_mm):
        gaps = path_distances(psi, radius_mm, around.centres_mm) - around.needle_and_obstacle_mm
        cost += weights.clearance_per_mm * np.maximum(
            weights.comfortable_clearance_mm - gaps.min(axis=-1), 0.0
        )
    return np.asarray(cost)


def best(psi: FloatArray, around: Surroundings) -> FloatArray:
    """Return the path (n, 2) of least cost among paths (M, n, 2)."""
    return np.asarray(psi[np.argmin(costs(psi, around))])
