"""A planner that shares no code and no formula with labrig's: it follows every path of a grid step by step.

Paths are integrated by the midpoint rule with steps of about half a millimetre. Each arc's angle is from a grid, signs
alternate, and a path that touches an obstacle or points backwards ends there. A path is a solution if a point of it
lies within the tolerance; the limits on arcs, angle and length are those of the planner.
"""

import math

import numpy as np
from numpy.typing import NDArray

from labrig.steering.problem import PlanProblem

STEP_RAD = math.radians(1.0)
ANGLES_PER_ARC = 45  # of 2 degrees each
BEAM = 30_000


def oracle_solves(problem: PlanProblem) -> bool:
    """Return whether some path of the grid reaches the target of a planar problem."""
    states = np.array([[0.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0, -1.0]])  # y, z, heading, length, sign
    walls = np.array([(*each.position_mm[1:], each.radius_mm) for each in problem.obstacles]).reshape(-1, 3)
    step, gap = problem.radius_mm * STEP_RAD, problem.diameter_mm / 2 + problem.clearance_mm
    for _ in range(problem.max_arcs):
        ends = []
        walking = states
        for count in range(1, 2 * ANGLES_PER_ARC + 1):
            walking = _step_forward(walking, step)
            walking = walking[_find_allowed(walking, walls, gap, problem.max_length_mm)]
            if not len(walking):
                break
            if np.any(np.linalg.norm(walking[:, :2] - problem.target_mm[1:], axis=1) <= problem.tolerance_mm):
                return True
            if count % 2 == 0:
                ends.append(walking * np.array([1, 1, 1, 1, -1]))
        if not ends:
            return False
        states = _thin(np.concatenate(ends))
    return False


def _step_forward(states: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    y, z, heading, length, sign = states.T
    middle = heading + sign * STEP_RAD / 2
    return np.stack(
        (
            y + step * np.sin(middle), z + step * np.cos(middle), heading + sign * STEP_RAD, length + step,
            sign,
        ),
        axis=1,
    )  # fmt: skip


def _find_allowed(
    states: NDArray[np.float64], walls: NDArray[np.float64], gap: float, max_length: float
) -> NDArray[np.bool_]:
    fine = (np.abs(states[:, 2]) <= math.pi / 2 + 1e-9) & (states[:, 3] <= max_length)
    for y, z, radius in walls:
        fine &= np.hypot(states[:, 0] - y, states[:, 1] - z) >= radius + gap
    return fine


def _thin(states: NDArray[np.float64]) -> NDArray[np.float64]:
    """Keep a state per cell of 0.5 mm and 2 degrees, and an even selection of these."""
    cells = np.round(states[:, [0, 1, 2, 4]] / np.array([0.5, 0.5, math.radians(2.0), 1.0])).astype(int)
    _, first = np.unique(cells, axis=0, return_index=True)
    return states[first[:: len(first) // BEAM + 1]]


def integrate_path(arcs: list[tuple[float, float]], radius: float, step: float = 0.02) -> NDArray[np.float64]:
    """Return points (N, 3) of a path of (roll, angle) arcs from the origin along z, by steps of `step` mm.

    The needle's frame is turned by its angular velocity alone, without the closed forms of an arc.
    """
    place, frame, points = np.zeros(3), np.eye(3), [np.zeros(3)]
    for roll, angle in arcs:
        turn = np.array(
            [[math.cos(roll), -math.sin(roll), 0], [math.sin(roll), math.cos(roll), 0], [0.0, 0.0, 1.0]]
        )
        frame = frame @ turn
        count = max(1, math.ceil(angle * radius / step))
        half = angle / count / 2
        for _ in range(count):
            for part in range(2):
                y, z = frame[:, 1].copy(), frame[:, 2].copy()
                frame[:, 1] = math.cos(half) * y + math.sin(half) * z
                frame[:, 2] = math.cos(half) * z - math.sin(half) * y
                if part == 0:
                    place = place + angle * radius / count * frame[:, 2]
            points.append(place)
    return np.array(points)
