"""Closed loop without a camera: planner, estimator, steering step and turns in drawn worlds.

The reference world has disturbances with which the paper's policy does as the paper reports (`reference_world`). The
hard world adds heading noise out of the plane, torsion, layers, slip, cavities, shifted obstacles and a target that
moves. Each world draws what the policy assumes (`worlds`), target and two obstacles come from the planner's problems,
and the tip is sighted about every millimetre (`blind_insertion`). The figures are those of the world's own truth, in
space. LABRIG_BENCHMARK_WORLDS sets the number of worlds.
"""

import os
import statistics
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from scipy.stats import binomtest

from tests.benchmarks.blind_insertion import InsertionEnd, Policy, insert
from tests.benchmarks.table import print_rows
from tests.benchmarks.worlds import draw_world, read_world

WORLDS = int(os.environ.get("LABRIG_BENCHMARK_WORLDS", "200"))
WAYS: tuple[tuple[str, Policy], ...] = (
    ("reference", "default"),
    ("reference", "paper"),
    ("hard", "default"),
    ("hard", "paper"),
)
TOLERANCE_MM = 2.0


def print_table() -> None:
    """Print where the default policy and the paper's end in both worlds, and what the default policy says of it."""
    done = {way: _insert_all(*way) for way in WAYS}
    heads = (
        "world", "policy", "within 2 mm", "mean mm", "median", "95 %", "worst", "in plane", "|x|", "touched", "turns",
        "stops", "CPU s",
    )  # fmt: skip
    print_rows(heads, [_row(*way, *ends) for way, ends in done.items()])
    print(
        "limits for the default policy in the reference world: within 2 mm in 99 %, mean 0.4 mm, none touched"
    )
    judged = (
        "world", "reached", "reached in plane only", "missed", "false successes", "below (95 %)", "interval covers",
        "between (95 %)",
    )  # fmt: skip
    print_rows(
        judged, [_judge(world, ends) for (world, policy), (ends, _) in done.items() if policy == "default"]
    )
    print("limits in the hard world: false successes below 1 %, the interval covers 93 to 97 %")


def _insert_all(name: str, policy: Policy) -> tuple[list[InsertionEnd], float]:
    """Return the end in every world, and the mean CPU time of one [s]."""
    with ProcessPoolExecutor() as executor:
        timed = list(executor.map(partial(_time_insertion, name, policy), range(WORLDS), chunksize=4))
    return [end for end, _ in timed], statistics.mean(cpu_s for _, cpu_s in timed)


def _time_insertion(name: str, policy: Policy, seed: int) -> tuple[InsertionEnd, float]:
    began_s = time.process_time()
    end = insert(draw_world(read_world(name), seed), policy)
    return end, time.process_time() - began_s


def _row(name: str, policy: str, ends: Sequence[InsertionEnd], cpu_s: float) -> list[object]:
    errors = [end.error_mm for end in ends]
    stops = Counter(end.stop for end in ends).most_common()
    return [
        name, policy, f"{100 * statistics.mean(error <= TOLERANCE_MM for error in errors):.1f} %",
        f"{statistics.mean(errors):.2f}", f"{statistics.median(errors):.2f}", f"{np.percentile(errors, 95):.2f}",
        f"{max(errors):.2f}", f"{statistics.mean(end.in_plane_mm for end in ends):.2f}",
        f"{statistics.mean(end.out_of_plane_mm for end in ends):.2f}", sum(end.clearance_mm < 0 for end in ends),
        f"{statistics.mean(end.turns for end in ends):.0f}", ", ".join(f"{stop} {count}" for stop, count in stops),
        f"{cpu_s:.2f}",
    ]  # fmt: skip


def _judge(name: str, ends: Sequence[InsertionEnd]) -> list[object]:
    """Return what the policy says and how often it is right, with 95 % intervals (Clopper-Pearson, Wilson)."""
    said = Counter(end.outcome for end in ends)
    false = sum(end.outcome == "reached" and end.error_mm > TOLERANCE_MM for end in ends)
    most = binomtest(false, len(ends)).proportion_ci(0.95, "exact").high
    held = sum(end.interval_mm[0] <= end.error_mm <= end.interval_mm[1] for end in ends)
    share = binomtest(held, len(ends)).proportion_ci(0.95, "wilson")
    return [
        name, said["reached"], said["reached_in_plane_only"], said["missed"], false, f"{100 * most:.2f} %",
        f"{100 * held / len(ends):.1f} %", f"{100 * share.low:.1f} to {100 * share.high:.1f} %",
    ]  # fmt: skip
