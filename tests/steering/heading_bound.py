"""The posterior Cramer-Rao bound of the heading, by the recursion of Tichavsky, Muravchik and Nehorai (1998).

With the error in the tip's own frame, a step leads to the same error whatever the pose: pose exp(e) step = pose step
exp(Ad(step^-1) e). Observations with equal noise along all axes tell as much at every pose. So nothing in the recursion
needs an expectation over the paths, and it is that of Riccati with the world's own sizes. It is written here without
the filter and its formulas.
"""

import math

import numpy as np

from tests.steering.insertions import (
    PROCESS_SD_RAD,
    RADIUS_MM,
    SIGMA_MM,
    START_SD_RAD,
    STEPS,
    Floats,
    SimulatedInsertion,
)

_STEP_MM, _CHANGE = 1.0, 1e-7
_TANGENT = (3, 4)


def bound_heading_rad2(insertion: SimulatedInsertion, planar: bool, radius_sd_mm: float = 0.0) -> Floats:
    """Return the bounds of the heading's squared error after each step (T + 1,) for the rolls of an insertion.

    With `radius_sd_mm` the curvature is unknown, with the standard deviation that belongs to it.
    """
    seen = np.eye(7)[[1, 2] if planar else [0, 1, 2]]
    told = seen.T @ seen / SIGMA_MM**2
    turning = np.array((1.0, 0.0, 0.0) if planar else (1.0, 1.0, 1.0))
    process = np.diag((0.0, 0.0, 0.0, *(PROCESS_SD_RAD**2 * turning), 0.0))
    start = (*(SIGMA_MM**2 * seen.sum(axis=0)[:3]), *(START_SD_RAD**2 * turning))
    bound: Floats = np.diag(np.array((*start, (radius_sd_mm / RADIUS_MM**2) ** 2)))
    squares = [_sum_tangent(bound)]
    for roll_rad in insertion.roll_rad[:STEPS]:
        step = _propagate_error(float(roll_rad))
        bound = np.asarray(step @ bound @ step.T + process)
        # (bound^-1 + told)^-1, also where a part of the state is known and the bound has no inverse.
        bound = np.asarray(np.linalg.solve(np.eye(7) + bound @ told, bound), dtype=np.float64)
        squares.append(_sum_tangent(bound))
    return np.array(squares)


def _sum_tangent(bound: Floats) -> float:
    return float(sum(bound[axis, axis] for axis in _TANGENT))


def _propagate_error(roll_rad: float) -> Floats:
    """Return what becomes of the errors of place, orientation and curvature (7,) over a step."""
    curvature = 1.0 / RADIUS_MM
    step = _roll_and_bend(roll_rad, curvature)
    back, place = step[:3, :3].T, step[:3, 3]
    slopes = np.eye(7)
    slopes[:3, :3] = slopes[3:6, 3:6] = back
    slopes[:3, 3:6] = back @ np.column_stack([np.cross(axis, place) for axis in np.eye(3)])
    ahead, behind = (
        np.linalg.inv(step) @ _roll_and_bend(roll_rad, curvature + change) for change in (_CHANGE, -_CHANGE)
    )
    change = (ahead - behind) / (2.0 * _CHANGE)
    slopes[:6, 6] = (*change[:3, 3], change[2, 1], change[0, 2], change[1, 0])
    return slopes


def _roll_and_bend(roll_rad: float, curvature: float) -> Floats:
    """Return a roll about the needle's axis, and then a step along an arc, (4, 4)."""
    angle = _STEP_MM * curvature
    (sine, cosine), (rolled_sine, rolled_cosine) = (
        (math.sin(turn), math.cos(turn)) for turn in (angle, roll_rad)
    )
    roll, arc = np.eye(4), np.eye(4)
    roll[:2, :2] = ((rolled_cosine, -rolled_sine), (rolled_sine, rolled_cosine))
    arc[1:3, 1:3] = ((cosine, -sine), (sine, cosine))
    arc[1:3, 3] = (cosine - 1.0) / curvature, sine / curvature
    return roll @ arc
