"""The last millimetres: which bends bring the tip nearest to the target, reached or not.

The planner's paths end at the target or there is none. Near the target the needle can no longer go everywhere, and
what counts is how near it comes. So the few things that it can still do are tried: go on, turn, go on and then turn,
turn and then back; each until it passes the target at its nearest, which is known in closed form.
"""

import numpy as np
from numpy.typing import NDArray

from labrig.needle.kinematics import path_frames
from labrig.steering.clearance import path_distances
from labrig.steering.problem import Surroundings

FloatArray = NDArray[np.float64]

_LENGTHS = 32
_ROLLS = 16
_FARTHEST = 1.1


def nearest_approach(around: Surroundings) -> FloatArray | None:
    """Return the path (n, 2) of one to three arcs that costs least by miss and turns, or None.

    A path that comes nearer to an obstacle than the clearance asked for is none.
    """
    psi = _with_last_arc(_beginnings(around), around)
    if len(around.centres_mm):
        apart = path_distances(psi, around.problem.radius_mm, around.centres_mm)
        psi = psi[np.all(apart >= around.keep_off_mm, axis=-1)]
    if not len(psi):
        return None
    ends = path_frames(psi, around.problem.radius_mm).positions_mm[:, -1]
    weights = around.problem.weights
    cost = weights.target_error_per_mm * np.linalg.norm(ends - around.target_mm, axis=-1)
    turned = (np.cos(psi[..., 1]) < 1.0 - 1e-12) & (psi[..., 0] > 0)
    return _without_empty_arcs(psi[np.argmin(cost + weights.turn * turned.sum(axis=-1))])


def _beginnings(around: Surroundings) -> FloatArray:
    """Return paths (M, 3, 2) whose last arc is still empty: roll and angle of two arcs, and the last roll."""
    farthest = _FARTHEST * float(np.linalg.norm(around.target_mm)) / around.problem.radius_mm
    angles = np.linspace(0.0, farthest, _LENGTHS)
    turns = np.array([np.pi]) if around.problem.planar else 2 * np.pi * np.arange(1, _ROLLS) / _ROLLS
    either = np.concatenate(([0.0], turns))
    go_on = [(0.0, 0.0, 0.0, 0.0, roll) for roll in either]
    once = [(angle, 0.0, 0.0, 0.0, roll) for angle in angles[1:] for roll in turns]
    back = [(0.0, 0.0, angle, roll, last) for angle in angles[1:] for roll in turns for last in turns]
    rows = np.array(go_on + once + back)
    psi = np.zeros((len(rows), 3, 2))
    psi[:, 0], psi[:, 1], psi[:, 2, 1] = rows[:, :2], rows[:, 2:4], rows[:, 4]
    return psi


def _with_last_arc(psi: FloatArray, around: Surroundings) -> FloatArray:
    """Return the paths with a last arc that ends where it passes the target at its nearest."""
    radius_mm = around.problem.radius_mm
    frames = path_frames(psi, radius_mm)
    to_target = around.target_mm - frames.positions_mm[:, -1]
    local = np.einsum("mab,ma->mb", frames.rotations[:, -1], to_target)
    angle = np.arctan2(local[:, 2], local[:, 1] + radius_mm)
    closed = psi.copy()
    closed[:, -1, 0] = np.maximum(angle, 0.0)
    return closed


def _without_empty_arcs(path: FloatArray) -> FloatArray:
    """Return a path without the arcs of no length; their rolls go to the arc that follows."""
    kept, roll = [], 0.0
    for angle, turn in path:
        roll += turn
        if angle > 0:
            kept.append((angle, roll))
            roll = 0.0
    return np.array(kept).reshape(-1, 2)
