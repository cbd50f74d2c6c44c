"""Free rolls: many starts at once, each brought to the target by damped least squares; the best feasible path wins.

Starts come from a fixed seed, so the same problem gives the same plan. The arcs of a start turn roughly alternately,
and together they are long enough to reach the target. In each round, the starts first settle on the target, and those
that come nearest to keeping off the obstacles are then mended. Later rounds draw more widely and mend more.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from labrig.needle.kinematics import FloatArray, path_frames, path_jacobian
from labrig.steering.mending import mend_paths, rank_by_lack
from labrig.steering.problem import Surroundings
from labrig.steering.resolved_rate import solve_damped
from labrig.steering.score import pick_best_feasible

QUICK_ROUNDS = 3
_ROUNDS = 36
_STARTS = 64
_STEPS = 7
_LONGEST_ARC_RAD = np.pi / 2
_DAMPING = 1e-3


@dataclass(frozen=True)
class _Draw:
    """How widely the starts of a round are drawn, how many of them are mended, and in how many steps.

    longest : largest length of a start, as a share of the distance; roll_sd_rad : of a roll about half a turn.
    """

    longest: float
    roll_sd_rad: float
    mended: int
    steps: int


_FIRST, _LATER = _Draw(1.3, 0.9, 24, 8), _Draw(1.6, 1.2, 64, 16)


def search_space(around: Surroundings, known: Sequence[FloatArray]) -> Iterator[FloatArray | None]:
    """Yield the best path (n, 2) with free rolls of each round or of those (M, n, 2) that are known, or None."""
    rng = np.random.default_rng(0)
    problem = around.problem
    distance = float(np.linalg.norm(around.target_mm))
    fewest = max(1, int(np.ceil(distance / (problem.radius_mm * _LONGEST_ARC_RAD))))
    for round_number in range(_ROUNDS):
        draw = _FIRST if round_number < QUICK_ROUNDS else _LATER
        arcs = min(fewest + 1 + round_number % 3, problem.max_arcs)
        psi = _settle(_draw_starts(rng, arcs, distance / problem.radius_mm, draw), around)
        if pick_best_feasible([psi], around) is None:
            psi = mend_paths(rank_by_lack(psi, around, draw.mended), around, draw.steps)
        yield pick_best_feasible([psi, *known], around)


def _draw_starts(rng: np.random.Generator, arcs: int, turning_rad: float, draw: _Draw) -> FloatArray:
    psi = np.empty((_STARTS, arcs, 2))
    share = rng.dirichlet(np.full(arcs, 2.0), _STARTS)
    psi[..., 0] = np.minimum(
        share * turning_rad * rng.uniform(1.0, draw.longest, (_STARTS, 1)), _LONGEST_ARC_RAD
    )
    psi[..., 1] = np.pi + rng.normal(0.0, draw.roll_sd_rad, (_STARTS, arcs))
    psi[:, 0, 1] = rng.uniform(-np.pi, np.pi, _STARTS)
    return psi


def _settle(psi: FloatArray, around: Surroundings) -> FloatArray:
    """Return the paths after a few damped Newton steps of their tips towards the target."""
    radius_mm = around.problem.radius_mm
    for _ in range(_STEPS):
        frames = path_frames(psi, radius_mm)
        error = around.target_mm - frames.positions_mm[:, -1]
        jacobian = path_jacobian(radius_mm, frames)
        step = solve_damped(jacobian, error, _DAMPING * radius_mm**2)
        psi = psi + np.clip(step.reshape(psi.shape), -0.5, 0.5)
        psi[..., 0] = np.clip(psi[..., 0], 0.0, np.pi)
    return psi
