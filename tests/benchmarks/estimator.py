"""Tip estimator: heading against the paper's filter, consistency, and the time of an update."""

import statistics
import time
from dataclasses import replace

from labrig.steering.estimator import step_tip
from labrig.steering.tip import EstimatorMethod
from tests.benchmarks.table import print_rows
from tests.steering.false_sightings import WATCHFUL, scattered_rmse_deg, streak_rmse_deg
from tests.steering.insertions import (
    RADIUS_MM,
    follow,
    heading_rmse_deg,
    insert,
    mean_nees_in_band,
    settings,
)

RUNS = 200
METHODS: tuple[EstimatorMethod, ...] = ("paper", "error-state")


def print_table() -> None:
    """Print four tables of 200 simulated insertions of 100 mm in steps of 1 mm, each with two flips."""
    _print_headings()
    print()
    _print_consistency()
    print()
    _print_false_sightings()
    print()
    _print_times()


def _print_headings() -> None:
    rows = []
    for planar, limit in ((True, 0.75), (False, 0.6)):
        paper, default = (heading_rmse_deg(RUNS, settings(planar, method=method)) for method in METHODS)
        curved = heading_rmse_deg(RUNS, settings(planar, radius_sd_mm=0.02 * RADIUS_MM))
        ratio = default / paper
        rows.append(
            [_world(planar), f"{paper:.2f}", f"{default:.2f}", f"{curved:.2f}", f"{ratio:.2f}", limit]
        )
    heads = ("heading RMSE, deg", "paper", "error-state", "curvature estimated", "ratio", "at most")
    print_rows(heads, rows)


def _print_consistency() -> None:
    rows = []
    for planar in (True, False):
        for name, radius_sd_mm in (("known", 0.0), ("estimated", 0.02 * RADIUS_MM)):
            share, mean = mean_nees_in_band(RUNS, planar, radius_sd_mm)
            rows.append([_world(planar), name, f"{100 * share:.0f} %", "90 %", f"{mean:.2f}"])
    print_rows(("mean NEES", "radius", "steps in the 95 % band", "at least", "over degrees of freedom"), rows)


def _print_false_sightings() -> None:
    before = replace(WATCHFUL, robust=False)
    rows = [
        ["none", *(f"{scattered_rmse_deg(RUNS, 0.0, chosen):.2f}" for chosen in (before, WATCHFUL)), "-"],
        ["5 %", *(f"{scattered_rmse_deg(RUNS, 0.05, chosen):.2f}" for chosen in (before, WATCHFUL)), "1.4"],
        ["20 %", *(f"{scattered_rmse_deg(RUNS, 0.2, chosen):.2f}" for chosen in (before, WATCHFUL)), "1.5"],
        ["six in a row", *(f"{streak_rmse_deg(RUNS, chosen):.2f}" for chosen in (before, WATCHFUL)), "4"],
    ]
    print_rows(("false sightings: heading RMSE, deg", "robust: false", "default", "at most"), rows)


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
