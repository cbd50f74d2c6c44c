"""The last millimetres: the path that brings the tip nearest to the target, whether or not it reaches it.

A planner's path ends at the target. Near the target the needle can no longer go everywhere, and what counts is how
near it comes. So the few manoeuvres that are left are tried: go on, turn, go on and then turn, turn and turn back.
Each ends where it passes the target at its nearest, which is known in closed form.
"""

from functools import cache

import numpy as np

from labrig.needle.kinematics import FloatArray, path_frames
from labrig.steering.clearance import path_distances
from labrig.steering.problem import Surroundings
from labrig.steering.score import ROUNDING, find_cheapest
from labrig.steering.tip import freeze

_LENGTHS = 32
_ROLLS = 16
_FARTHEST = 1.1


def find_nearest_approach(around: Surroundings, error_per_mm: float) -> FloatArray | None:
    """Return the path (n, 2) of one to three arcs with the least cost of miss and turns, or None.

    A path that comes nearer to an obstacle than the requested clearance, or is too long, does not count. A millimetre
    of miss costs `error_per_mm`, a turn what `PlanWeights` says.
    """
    radius_mm = around.problem.radius_mm
    psi = _add_last_arc(_list_beginnings(around), around)
    frames = path_frames(psi, radius_mm)
    cost = error_per_mm * np.linalg.norm(frames.positions_mm[:, -1] - around.target_mm, axis=-1)
    turned = (np.cos(psi[..., 1]) < 1.0 - 1e-12) & (psi[..., 0] > ROUNDING)
    cost += around.problem.weights.turn * turned.sum(axis=-1)
    apart = path_distances(psi, radius_mm, around.centres_mm, frames)
    too_long = radius_mm * psi[..., 0].sum(axis=-1) > around.problem.max_length_mm + ROUNDING
    cost[np.any(apart < around.keep_off_mm - ROUNDING, axis=-1) | too_long] = np.inf
    best = find_cheapest(cost)
    return None if np.isinf(cost[best]) else _drop_empty_arcs(psi[best])


def _list_beginnings(around: Surroundings) -> FloatArray:
    """Return paths (M, 3, 2) whose last arc is still empty: roll and angle of two arcs, and the last roll."""
    psi = _list_manoeuvres(around.problem.planar).copy()
    psi[..., 0] *= _FARTHEST * float(np.linalg.norm(around.target_mm)) / around.problem.radius_mm
    return psi


@cache
def _list_manoeuvres(planar: bool) -> FloatArray:
    """Return the beginnings of paths for a farthest angle of one."""
    angles = np.linspace(0.0, 1.0, _LENGTHS)[1:]
    turns = np.array([np.pi]) if planar else 2 * np.pi * np.arange(1, _ROLLS) / _ROLLS
    go_on = [(0.0, 0.0, 0.0, 0.0, roll) for roll in (0.0, *turns)]
    once = [(angle, 0.0, 0.0, 0.0, roll) for angle in angles for roll in turns]
    back = [(0.0, 0.0, angle, roll, last) for angle in angles for roll in turns for last in turns]
    rows = np.array(go_on + once + back)
    psi = np.zeros((len(rows), 3, 2))
    psi[:, 0], psi[:, 1], psi[:, 2, 1] = rows[:, :2], rows[:, 2:4], rows[:, 4]
    return freeze(psi)


def _add_last_arc(psi: FloatArray, around: Surroundings) -> FloatArray:
    """Return the paths with a last arc up to where it passes the target at its nearest, or up to the largest length."""
    radius_mm = around.problem.radius_mm
    frames = path_frames(psi, radius_mm)
    local = np.einsum("mab,ma->mb", frames.rotations[:, -1], around.target_mm - frames.positions_mm[:, -1])
    left = np.maximum(around.problem.max_length_mm / radius_mm - psi[..., 0].sum(axis=-1), 0.0)
    psi[:, -1, 0] = np.clip(np.arctan2(local[:, 2], local[:, 1] + radius_mm), 0.0, left)
    return psi


def _drop_empty_arcs(path: FloatArray) -> FloatArray:
    """Return a path without its arcs of zero length; their rolls go to the next arc."""
    kept, roll = [], 0.0
    for angle, turn in path:
        roll += turn
        if angle > ROUNDING:
            kept.append((angle, roll))
            roll = 0.0
    return np.array(kept).reshape(-1, 2)
