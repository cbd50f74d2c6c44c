"""Tip estimator: heading against the paper's filter and against its bound, consistency, and the time of an update."""

import math
import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from labrig.steering.estimator import step_tip
from labrig.steering.parameters import EstimatorMethod
from tests.benchmarks.table import multiply, print_rows
from tests.steering.insertions import (
    RADIUS_MM,
    follow,
    heading_errors_rad,
    heading_rmse_deg,
    insert,
    mean_nees_in_band,
    scattered_rmse_deg,
    settings,
    streak_rmse_deg,
)
from tests.steering.plain_ekf import bound_heading_rad2

RUNS = multiply(40)
SCATTERED = ((0.0, "-"), (0.05, "1.4"), (0.2, "1.5"))
BOUND_FIRST_SEED = 10_000
UNKNOWN_RADIUS_MM = 0.02 * RADIUS_MM
METHODS: tuple[EstimatorMethod, ...] = ("paper", "error-state")


def print_table() -> None:
    """Print five tables of simulated insertions of 100 mm in steps of 1 mm, each with two flips."""
    _print_headings()
    print()
    _print_bound()
    print(flush=True)
    _print_consistency()
    print()
    _print_false_sightings()
    print()
    _print_times()


def _print_headings() -> None:
    rows = []
    for planar, limit in ((True, 0.75), (False, 0.6)):
        paper, default = (heading_rmse_deg(RUNS, settings(planar, method=method)) for method in METHODS)
        curved = heading_rmse_deg(RUNS, settings(planar, radius_sd_mm=UNKNOWN_RADIUS_MM))
        ratio = default / paper
        rows.append(
            [_world(planar), f"{paper:.2f}", f"{default:.2f}", f"{curved:.2f}", f"{ratio:.2f}", limit]
        )
    print_rows(("heading RMSE, deg", "paper", "error-state", "curvature estimated", "ratio", "at most"), rows)


def _print_bound() -> None:
    """Print the heading's error over the least that a filter can have; the interval is that of the drawn runs."""
    rows = []
    for planar in (True, False):
        for name, radius_sd_mm in (("known", 0.0), ("estimated", UNKNOWN_RADIUS_MM)):
            with ProcessPoolExecutor() as executor:
                seeds = range(BOUND_FIRST_SEED, BOUND_FIRST_SEED + RUNS)
                compare = partial(_compare_with_bound, planar=planar, radius_sd_mm=radius_sd_mm)
                errors, bounds = np.array(list(executor.map(compare, seeds, chunksize=10))).T
            rmse, bound = (math.degrees(math.sqrt(squares.mean())) for squares in (errors, bounds))
            share = 0.5 * 1.96 * float(errors.std(ddof=1) / errors.mean()) / math.sqrt(RUNS)
            between = f"{rmse / bound * (1.0 - share):.3f} to {rmse / bound * (1.0 + share):.3f}"
            rows.append(
                [_world(planar), name, f"{rmse:.3f}", f"{bound:.3f}", f"{rmse / bound:.3f}", between, "1.05"]
            )
    print_rows(("heading, deg", "radius", "RMSE", "posterior bound", "ratio", "95 %", "at most"), rows)


def _compare_with_bound(seed: int, planar: bool, radius_sd_mm: float) -> tuple[float, float]:
    """Return the mean squared error of the heading in an insertion, and its bound [rad^2]."""
    curvature = np.random.default_rng([seed, 7]).normal(1.0 / RADIUS_MM, radius_sd_mm / RADIUS_MM**2)
    insertion = insert(seed, planar, 1.0 / curvature)
    states = follow(insertion, settings(planar, radius_sd_mm=radius_sd_mm))
    errors = heading_errors_rad(np.stack([state.pose for state in states]), insertion.truth)
    return float(np.mean(errors**2)), float(np.mean(bound_heading_rad2(seed, planar, radius_sd_mm)))


def _print_consistency() -> None:
    rows = []
    for planar in (True, False):
        for name, radius_sd_mm in (("known", 0.0), ("estimated", UNKNOWN_RADIUS_MM)):
            share, mean = mean_nees_in_band(RUNS, planar, radius_sd_mm)
            rows.append([_world(planar), name, f"{100 * share:.0f} %", "90 %", f"{mean:.2f}"])
    print_rows(("mean NEES", "radius", "steps in the 95 % band", "at least", "over degrees of freedom"), rows)


def _print_false_sightings() -> None:
    rows = [
        *([f"{share:.0%}", f"{scattered_rmse_deg(RUNS, share):.2f}", most] for share, most in SCATTERED),
        ["six in a row", f"{streak_rmse_deg(RUNS):.2f}", "4"],
    ]
    print_rows(("false sightings: heading RMSE, deg", "found", "at most"), rows)


def _print_times() -> None:
    rows = []
    for method in METHODS:
        chosen = settings(False, method=method)
        insertion = insert(0, False)
        times = []
        for _ in range(20):
            for state, observation in zip(follow(insertion, chosen), insertion.observations, strict=False):
                started = time.perf_counter()
                step_tip(state, observation, chosen)
                times.append(1e6 * (time.perf_counter() - started))
        tail = statistics.quantiles(times, n=20)[-1]
        rows.append([method, f"{statistics.median(times):.0f}", f"{tail:.0f}", "100"])
    print_rows(("an update, us", "median", "95 %", "at most"), rows)


def _world(planar: bool) -> str:
    return "in the plane" if planar else "in space"
