"""Free rolls: many starts at once, each brought to the target by damped least squares; the best feasible path wins.

Starts come from a fixed seed, so the same problem gives the same plan. The arcs of a start turn roughly alternately,
and together they are long enough to reach the target. Rounds are added until a path is found.
"""

import numpy as np

from labrig.needle.kinematics import FloatArray, path_frames, path_jacobian
from labrig.steering.problem import Surroundings
from labrig.steering.resolved_rate import solve_damped
from labrig.steering.score import pick_best_feasible

_STARTS = 192
_STEPS = 7
_ROUNDS = 12
_QUICK_ROUNDS = 3
_LONGEST_ARC_RAD = np.pi / 2
_DAMPING = 1e-3


def search_space(around: Surroundings, *, thorough: bool) -> FloatArray | None:
    """Return the best path (n, 2) with free rolls, or None; a thorough search makes more rounds before that."""
    rng = np.random.default_rng(0)
    problem = around.problem
    distance = float(np.linalg.norm(around.target_mm))
    fewest = max(1, int(np.ceil(distance / (problem.radius_mm * _LONGEST_ARC_RAD))))
    for round_number in range(_ROUNDS if thorough else _QUICK_ROUNDS):
        arcs = min(fewest + 1 + round_number % 3, problem.max_arcs)
        psi = _settle(_draw_starts(rng, arcs, distance / problem.radius_mm), around)
        path = pick_best_feasible(psi, around)
        if path is not None:
            return path
    return None


def _draw_starts(rng: np.random.Generator, arcs: int, turning_rad: float) -> FloatArray:
    psi = np.empty((_STARTS, arcs, 2))
    share = rng.dirichlet(np.full(arcs, 2.0), _STARTS)
    psi[..., 0] = np.minimum(share * turning_rad * rng.uniform(1.0, 1.3, (_STARTS, 1)), _LONGEST_ARC_RAD)
    psi[..., 1] = np.pi + rng.normal(0.0, 0.9, (_STARTS, arcs))
    psi[:, 0, 1] = rng.uniform(-np.pi, np.pi, _STARTS)
    return psi


def _settle(psi: FloatArray, around: Surroundings) -> FloatArray:
    """Return the paths after a few damped Newton steps of their tips towards the target."""
    radius_mm = around.problem.radius_mm
    for _ in range(_STEPS):
        error = around.target_mm - path_frames(psi, radius_mm).positions_mm[:, -1]
        jacobian = path_jacobian(psi, radius_mm)
        step = solve_damped(jacobian, error, _DAMPING * radius_mm**2)
        psi = psi + np.clip(step.reshape(psi.shape), -0.5, 0.5)
        psi[..., 0] = np.clip(psi[..., 0], 0.0, np.pi)
    return psi
