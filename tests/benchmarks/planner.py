"""The planner on random problems, against an oracle."""

import time
from collections.abc import Callable

import numpy as np

from labrig.steering.planner import plan_path
from labrig.steering.problem import PlanProblem
from tests.benchmarks.oracle import oracle_solves
from tests.benchmarks.planning_problems import (
    draw_planar_problem,
    draw_rings,
    draw_spatial_problems,
    draw_tunnel,
    find_faults,
)
from tests.benchmarks.table import multiply, print_rows

SETS = ((2, multiply(20)), (5, multiply(12)), (9, multiply(12)), (14, multiply(12)))
IN_SPACE = TIGHT = multiply(8)
TUNNELS, SPARE_MM = multiply(12), (0.05, 0.15, 0.4)


def print_table() -> None:
    """Print solved problems, misses against the oracle, and times, also as a share of the oracle's median."""
    rows = []
    for count, size in SETS:
        rng = np.random.default_rng(count)
        rows.append(_row(count, [draw_planar_problem(rng, count) for _ in range(size)]))
    rows.append(_row(3, draw_spatial_problems(IN_SPACE, seed=3)))
    heads = (
        "problems", "solved", "oracle", "alone", "bad", "median ms", "95 % ms", "worst ms", "of oracle's",
    )  # fmt: skip
    print_rows(heads, rows)
    print_tight()


def print_tight() -> None:
    """Print the problems with hardly any room: solved quickly and thoroughly, and the time to the first path."""
    rings = [draw_rings(np.random.default_rng([21, k])) for k in range(TIGHT)]
    tunnels = {
        spare_mm: [draw_tunnel(np.random.default_rng([7, place, k]), spare_mm) for k in range(TUNNELS)]
        for place, spare_mm in enumerate(SPARE_MM)
    }
    rows = [_tight_row("3-D, rings of 40 spheres, 0.05-0.15 mm to spare", rings)]
    rows += [
        _tight_row(f"planar tunnels, {spare_mm} mm to spare on each side", problems)
        for spare_mm, problems in tunnels.items()
    ]
    print()
    print_rows(("tight problems", "of", "solved quickly", "solved", "bad", "median ms", "worst ms"), rows)


def _tight_row(name: str, problems: list[PlanProblem]) -> list[object]:
    solved, bad, times = _solve(problems)
    quick = sum(plan_path(problem, effort="quick").found for problem in problems)
    return [name, len(problems), quick, sum(solved), bad, f"{np.median(times):.1f}", f"{max(times):.0f}"]


def _solve(problems: list[PlanProblem]) -> tuple[list[bool], int, list[float]]:
    """Return which problems are solved, how many of the plans have a fault, and the times [ms]."""
    solved, times = _time(lambda problem: plan_path(problem).found, problems)
    bad = sum(bool(find_faults(problem)) for problem, ok in zip(problems, solved, strict=True) if ok)
    return solved, bad, times


def _time(
    solve: Callable[[PlanProblem], bool], problems: list[PlanProblem]
) -> tuple[list[bool], list[float]]:
    solved, times = [], []
    for problem in problems:
        started = time.perf_counter()
        solved.append(solve(problem))
        times.append(1000 * (time.perf_counter() - started))
    return solved, times


def _row(count: int, problems: list[PlanProblem]) -> list[object]:
    solved, bad, times = _solve(problems)
    planar = problems[0].planar
    known, all_ms = _time(oracle_solves, problems) if planar else ([True] * len(problems), [np.nan])
    alone = sum(theirs and not ours for theirs, ours in zip(known, solved, strict=True))
    median, late = np.percentile(times, (50, 95))
    name = f"{len(problems)} {'planar' if planar else '3-D'}, {count} obstacles"
    return [
        name, sum(solved), sum(known) if planar else "witness", alone, bad, f"{median:.1f}", f"{late:.1f}",
        f"{max(times):.1f}", f"{median / np.median(all_ms):.3f}" if planar else "-",
    ]  # fmt: skip
