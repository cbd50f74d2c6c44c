"""Closed loop without a camera: planner, estimator, steering step and turns in drawn worlds.

The reference world has disturbances so large that the paper's policy does as the paper reports. The
hard world adds heading noise out of the plane, torsion, layers, slip, cavities, shifted obstacles and a target that
moves. Each world draws what the policy assumes (`worlds`), target and two obstacles come from the planner's problems,
the tip is sighted about every millimetre, and at the end a shaft is measured whose width and length tell its depth
(`blind_insertion`). The figures are those of the world's own truth, in space; intervals are of 95 %.

`closed-loop` prints both policies in both worlds.
LABRIG_BENCHMARK_WORLDS sets the number of worlds, 200 by default, LABRIG_BENCHMARK_FIRST_SEED the first of their seeds,
and LABRIG_BENCHMARK_WORKERS the number of processes, one for each processor by default.
"""

import math
import os
import statistics
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from tests.benchmarks.blind_insertion import InsertionEnd, Policy, insert
from tests.benchmarks.table import print_rows, read_count
from tests.benchmarks.worlds import draw_world, read_world

WORLDS = read_count("WORLDS", 200)
FIRST_SEED = read_count("FIRST_SEED", 0)
WORKERS = read_count("WORKERS", os.cpu_count() or 1)
POLICIES: tuple[Policy, ...] = ("default", "paper")
TOLERANCE_MM = 2.0
_WORST = 5

Row = tuple[object, object, object]
Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]


def print_table(*names: str) -> None:
    """Print where the default policy and the paper's end in worlds, and what the default policy says of it."""
    seeds = range(FIRST_SEED, FIRST_SEED + WORLDS)
    for name in names or ("reference", "hard"):
        for policy in POLICIES:
            with ProcessPoolExecutor(WORKERS) as executor:
                timed = list(executor.map(partial(_time_insertion, name, policy), seeds, chunksize=2))
            ends = [end for end, _ in timed]
            rows = _describe_ends(ends, statistics.mean(cpu_s for _, cpu_s in timed))
            if policy == "default":
                rows += _judge(ends)
            print_rows((f"{name} world, {policy} policy", f"{len(ends)} worlds", ""), rows)
            print(flush=True)
    print(
        "limits of the default policy: reference world, within 2 mm in 99 %, mean 0.4 mm, none touched; hard world, "
        "upper end of false successes 1 %, the interval covers 93 to 97 %"
    )


def _time_insertion(name: str, policy: Policy, seed: int) -> tuple[InsertionEnd, float]:
    began_s = time.process_time()
    end = insert(draw_world(read_world(name), seed), policy)
    return end, time.process_time() - began_s


def _describe_ends(ends: Sequence[InsertionEnd], cpu_s: float) -> list[Row]:
    errors_mm = np.array([end.error_mm for end in ends])
    in_plane_mm = np.array([end.in_plane_mm for end in ends])
    worst = sorted(range(len(ends)), key=lambda index: -errors_mm[index])[:_WORST]
    return [
        (f"within {TOLERANCE_MM:g} mm in space", *_share(errors_mm <= TOLERANCE_MM)),
        (f"within {TOLERANCE_MM:g} mm in the plane", *_share(in_plane_mm <= TOLERANCE_MM)),
        ("mean error", f"{errors_mm.mean():.2f} mm", f"standard error {_standard_error(errors_mm):.2f}"),
        ("median, 95th percentile, largest", _list_mm(np.quantile(errors_mm, (0.5, 0.95, 1.0))), ""),
        ("mean in the plane", f"{in_plane_mm.mean():.2f} mm", f"standard error {_standard_error(in_plane_mm):.2f}"),
        ("mean |x|", f"{statistics.mean(end.out_of_plane_mm for end in ends):.2f} mm", ""),
        ("touched an obstacle", sum(end.clearance_mm < 0 for end in ends), ""),
        ("turns, and CPU time, of one", f"{statistics.mean(end.turns for end in ends):.0f}", f"{cpu_s:.2f} s"),
        ("stops", ", ".join(f"{stop} {count}" for stop, count in Counter(end.stop for end in ends).most_common()), ""),
        ("largest errors", ", ".join(f"{errors_mm[i]:.1f}" for i in worst), "seeds " + _list_seeds(worst)),
    ]  # fmt: skip


def _judge(ends: Sequence[InsertionEnd]) -> list[Row]:
    """Return what the policy says and how often it is right."""
    errors_mm = np.array([end.error_mm for end in ends])
    low_mm, high_mm = np.array([end.interval_mm for end in ends]).T
    reached = np.array([_says_success(end) for end in ends])
    false = reached & (errors_mm > TOLERANCE_MM)
    said = Counter(end.outcome for end in ends)
    return [
        ("says success", *_share(reached)),
        ("false successes", int(false.sum()), _bound(false)),
        ("says reached in plane only, missed", f"{said['reached_in_plane_only']}, {said['missed']}", ""),
        ("the interval covers the error", *_share((errors_mm >= low_mm) & (errors_mm <= high_mm))),
        ("error below the interval, above it", f"{(errors_mm < low_mm).sum()}, {(errors_mm > high_mm).sum()}", ""),
    ]  # fmt: skip


def _says_success(end: InsertionEnd) -> bool:
    return end.stop == "target_reached" and not end.left_plane and end.interval_mm[1] <= TOLERANCE_MM


def _share(true: Flags) -> tuple[str, str]:
    """Return a share and its interval by Wilson."""
    limits = binomtest(int(true.sum()), len(true)).proportion_ci(0.95, "wilson")
    return f"{true.sum()}, {100 * true.mean():.1f} %", f"{100 * limits.low:.1f} to {100 * limits.high:.1f} %"


def _bound(true: Flags) -> str:
    """Return the interval of a share by Clopper and Pearson."""
    limits = binomtest(int(true.sum()), len(true)).proportion_ci(0.95, "exact")
    return f"{100 * limits.low:.2f} to {100 * limits.high:.2f} %"


def _standard_error(values: Floats) -> float:
    return float(values.std(ddof=1)) / math.sqrt(len(values))


def _list_mm(values: Floats) -> str:
    return ", ".join(f"{value:.2f}" for value in values) + " mm"


def _list_seeds(indices: Sequence[int] | NDArray[np.intp]) -> str:
    return ", ".join(str(FIRST_SEED + int(index)) for index in indices[:12]) or "-"
