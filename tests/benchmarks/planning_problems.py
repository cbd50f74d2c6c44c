"""The planning problems of the tables and the tests, drawn from seeds."""

import numpy as np
from numpy.typing import NDArray

from labrig.steering.planner import plan_path
from labrig.steering.problem import Obstacle, PlanProblem
from tests.benchmarks.oracle import integrate_path

RADIUS_MM, DIAMETER_MM, CLEARANCE_MM, TOLERANCE_MM = 27.6, 1.2, 0.6, 2.0
MAX_ARCS, MAX_LENGTH_MM = 6, 150.0


def draw_planar_problem(rng: np.random.Generator, obstacles: int) -> PlanProblem:
    """Return a planar problem: two obstacles have 8 mm and are near the line, other numbers are anywhere."""
    target = (0.0, rng.uniform(-15, 15), rng.uniform(95, 103))
    spheres = _draw_near_line(rng, target) if obstacles == 2 else _draw_anywhere(rng, obstacles)
    return PlanProblem(
        target, spheres, radius_mm=RADIUS_MM, diameter_mm=DIAMETER_MM, tolerance_mm=TOLERANCE_MM,
        clearance_mm=CLEARANCE_MM, max_arcs=MAX_ARCS, max_length_mm=MAX_LENGTH_MM, planar=True,
    )  # fmt: skip


def _draw_near_line(rng: np.random.Generator, target: tuple[float, float, float]) -> tuple[Obstacle, ...]:
    depths = (rng.uniform(28, 42), rng.uniform(60, 76))
    return tuple(Obstacle((0.0, target[1] * z / target[2] + rng.uniform(-6, 6), z), 8.0) for z in depths)


def _draw_anywhere(rng: np.random.Generator, count: int) -> tuple[Obstacle, ...]:
    return tuple(
        Obstacle((0.0, rng.uniform(-26, 26), rng.uniform(18, 86)), rng.uniform(3, 6)) for _ in range(count)
    )


def draw_spatial_problems(count: int, seed: int) -> list[PlanProblem]:
    """Return problems with three spheres around a witness path that block the plan made without them."""
    rng = np.random.default_rng(seed)
    problems: list[PlanProblem] = []
    while len(problems) < count:
        problem = _draw_around_witness(rng)
        if problem is not None:
            problems.append(problem)
    return problems


def _draw_witness(rng: np.random.Generator, angles_rad: tuple[float, float]) -> NDArray[np.float64] | None:
    """Return a path in space of three to five arcs; None if it turns back or is short."""
    arcs = int(rng.integers(3, 6))
    rolls = np.pi + rng.normal(0, 1, arcs)
    rolls[0] = rng.uniform(-np.pi, np.pi)
    witness = integrate_path(list(zip(rolls, rng.uniform(*angles_rad, arcs), strict=True)), RADIUS_MM, 0.3)
    return None if witness[-1, 2] < 75 or np.any(np.diff(witness[:, 2]) < 0.05) else witness


def _draw_around_witness(rng: np.random.Generator) -> PlanProblem | None:
    witness = _draw_witness(rng, (0.4, 1.1))
    if witness is None:
        return None
    target = (float(witness[-1, 0]), float(witness[-1, 1]), float(witness[-1, 2]))
    free = plan_path(PlanProblem(target))
    if not free.found:
        return None
    blocked = integrate_path([(arc.roll_rad, arc.angle_rad) for arc in free.arcs], RADIUS_MM, 0.3)
    spheres = _draw_spheres(rng, witness, blocked)
    return PlanProblem(target, spheres) if spheres else None


def _draw_spheres(
    rng: np.random.Generator, witness: NDArray[np.float64], blocked: NDArray[np.float64]
) -> tuple[Obstacle, ...]:
    """Return three spheres that leave the witness its clearance, the first of which cuts the free plan, or ()."""
    spheres: list[Obstacle] = []
    for _ in range(300):
        path = witness if spheres else blocked
        middle = path[int(rng.integers(len(path) // 4, 3 * len(path) // 4))]
        x, y, z = (middle + rng.normal(0, 6, 3)).tolist()
        radius = float(rng.uniform(4, 8))
        far = (
            np.linalg.norm(witness - (x, y, z), axis=1).min() > radius + DIAMETER_MM / 2 + CLEARANCE_MM + 0.2
        )
        if far and (spheres or np.linalg.norm(blocked - (x, y, z), axis=1).min() < radius):
            spheres.append(Obstacle((x, y, z), radius))
        if len(spheres) == 3:
            return tuple(spheres)
    return ()


def draw_tunnel(rng: np.random.Generator, spare_mm: float) -> PlanProblem:
    """Return a planar problem with walls of discs on both sides of a witness path, from its start nearly to its end.

    They leave the needle's clearance and `spare_mm` more on each side.
    """
    while True:
        arcs = int(rng.integers(2, 6))
        rolls = np.full(arcs, np.pi)
        rolls[0] = rng.choice((0.0, np.pi))
        turns = list(zip(rolls.tolist(), rng.uniform(0.3, 1.1, arcs).tolist(), strict=True))
        witness = integrate_path(turns, RADIUS_MM, 0.2)
        if witness[-1, 2] < 60 or np.any(np.diff(witness[:, 2]) < 0.02):
            continue
        count = len(witness)
        places = range(count // 10, count - count // 12, 20)
        walls = _keep_clear(
            witness, [(k, side * np.pi / 2, 3.0, spare_mm) for k in places for side in (1, -1)]
        )
        if len(walls) >= 12:
            x, y, z = witness[-1].tolist()
            return PlanProblem((x, y, z), walls, planar=True)


def draw_rings(rng: np.random.Generator) -> PlanProblem:
    """Return a problem in space with ten rings of four tight spheres around a witness path."""
    while True:
        witness = _draw_witness(rng, (0.5, 1.3))
        if witness is None:
            continue
        spheres = []
        for share in np.linspace(0.15, 0.9, 10):
            first = rng.uniform(0, 2 * np.pi)
            for quarter in range(4):
                around = first + quarter * np.pi / 2
                spheres.append(
                    (int(share * len(witness)), around, rng.uniform(3, 6), rng.uniform(0.05, 0.15))
                )
        kept = _keep_clear(witness, spheres)
        if len(kept) >= 32:
            x, y, z = witness[-1].tolist()
            return PlanProblem((x, y, z), kept)


def _keep_clear(
    witness: NDArray[np.float64], spheres: list[tuple[int, float, float, float]]
) -> tuple[Obstacle, ...]:
    """Return spheres beside a path that leave all of it its clearance.

    Each is given by a place on the path, the angle about it from the x axis, its radius and the spare distance.
    """
    kept = []
    for place, angle_rad, radius, spare_mm in spheres:
        along = witness[place + 1] - witness[place - 1]
        along /= np.linalg.norm(along)
        second = np.cross(along, (1.0, 0.0, 0.0))
        second /= np.linalg.norm(second)
        first = np.cross(second, along)
        keep_off_mm = radius + DIAMETER_MM / 2 + CLEARANCE_MM
        side = first * np.cos(angle_rad) + second * np.sin(angle_rad)
        x, y, z = (witness[place] + side * (keep_off_mm + spare_mm)).tolist()
        if np.linalg.norm(witness - (x, y, z), axis=1).min() >= keep_off_mm + spare_mm / 3:
            kept.append(Obstacle((x, y, z), radius))
    return tuple(kept)


def find_faults(problem: PlanProblem) -> list[str]:
    """Plan, follow the plan by integration, and return its faults."""
    plan = plan_path(problem)
    if not plan.found:
        return [plan.reason or "no reason"]
    path = integrate_path([(arc.roll_rad, arc.angle_rad) for arc in plan.arcs], problem.radius_mm)
    found = []
    if np.linalg.norm(path[-1] - problem.target_mm) > problem.tolerance_mm + 1e-3:
        found.append("the target is missed")
    for obstacle in problem.obstacles:
        gap = np.linalg.norm(path - obstacle.position_mm, axis=1).min() - obstacle.radius_mm
        if gap < problem.diameter_mm / 2 + problem.clearance_mm - 1e-3:
            found.append("an obstacle is too near")
    if len(plan.arcs) > problem.max_arcs or (plan.length_mm or 0) > problem.max_length_mm + 1e-6:
        found.append("too many arcs or too long")
    if np.any(np.diff(path[:, 2]) < -1e-6):
        found.append("the path turns back")
    return found
