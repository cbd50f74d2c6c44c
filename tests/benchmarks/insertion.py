"""The closed loop with camera, bus and record: `labrig run protocols/insertion.yaml`, and virtual insertions beside it.

A virtual insertion with the seed of a run has its gel and disturbances, so that each seed is a pair; seeds of which
either has no error are counted and left out. Mean and 90 % quantile of the true final error are equivalent if the 90 %
interval of their difference lies within `WITHIN_MM` (two one-sided tests at 5 %): Student's interval for the mean, the
percentiles of a bootstrap over seeds for the quantile. Two hundred seeds tell that; a run takes some seconds.
"""

import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import ttest_1samp

from labrig.needle.kinematics import FloatArray
from tests.benchmarks.table import measure, multiply, print_rows
from tests.benchmarks.virtual import PROTOCOL, RIG, insert

SEEDS = range(1, 1 + multiply(20))
LARGEST_ERROR_MM, LONGEST_S = 1.0, 15.0
WITHIN_MM = 0.05
QUANTILE = 0.9
_CONFIDENCE = 0.9
_RESAMPLED = 10_000
_FIGURES = ("true_target_error_mm", "target_error_mm", "true_min_clearance_mm")


def _run(seed: int) -> dict[str, Any]:
    """Return what came of a whole run: its end, values of its result, turns in tissue, and the wall time [s]."""
    with tempfile.TemporaryDirectory() as folder:
        where = ["--rig", str(RIG), "--runs-dir", folder, "--seed", str(seed)]
        command = [sys.executable, "-m", "labrig", "run", str(PROTOCOL), *where, "--json"]
        done = measure(command, failures=(1, 3))  # missed, and stopped
        document: dict[str, Any] = json.loads(done.out)
        lines = (Path(document["run"]) / "events.jsonl").read_text(encoding="utf-8").splitlines()
    turns = sum(event["kind"] == "flip" and event["depth_mm"] > 0 for event in map(json.loads, lines))
    result = document.get("result") or {}
    low_mm, high_mm = result.get("target_error_interval_mm") or (None, None)
    ended = {"exit_status": document.get("exit_status"), "reason": document.get("reason") or "-"}
    figures = {name: result.get(name) for name in (*_FIGURES, "reached")}
    return {**ended, **figures, "turns": turns, "low_mm": low_mm, "high_mm": high_mm, "wall_s": done.wall_s}


def print_table() -> None:
    """Run every seed, and print its figures, how many seeds keep the limits, and whether virtual insertions agree."""
    with ThreadPoolExecutor(2) as pool:
        runs = pd.DataFrame(pool.map(_run, SEEDS), index=SEEDS)
    true_mm, longest_s = runs[_FIGURES[0]].astype(float), runs["wall_s"].max()
    heads = ("true error mm", "measured mm", "clearance mm")
    rows = [
        (seed, run.exit_status, run.reason, *(_write(run[name]) for name in _FIGURES), run.turns, f"{run.wall_s:.1f}")
        for seed, run in runs.iterrows()
    ]  # fmt: skip
    print_rows(("seed", "exit status", "reason", *heads, "turns", "wall s"), rows)
    held = true_mm.between(runs["low_mm"].astype(float), runs["high_mm"].astype(float))
    print_rows(
        ("figure", "measured", "limit"),
        [
            [f"within {LARGEST_ERROR_MM:g} mm", (true_mm <= LARGEST_ERROR_MM).sum(), len(SEEDS)],
            ["mean true error, mm", f"{true_mm.mean():.3f}", "0.4"],
            [f"95 % intervals in space that hold the true error, of {len(SEEDS)}", held.sum(), "-"],
            ["longest wall time, two at once, s", f"{longest_s:.1f}", f"{LONGEST_S:g}"],
        ],
    )
    _print_agreement(runs)


def _write(value_mm: float | None) -> str:
    return "-" if value_mm is None or np.isnan(value_mm) else f"{value_mm:.3f}"


def _print_agreement(rig: pd.DataFrame) -> None:
    """Print the means and quantiles of runs and of virtual insertions, and the intervals of their differences."""
    with ProcessPoolExecutor() as executor:
        world = pd.DataFrame((dict(end.values) for end in executor.map(insert, SEEDS, chunksize=4)), SEEDS)
    names = [*_FIGURES[:2], "reached"]
    both = [ends.reindex(columns=names).astype(float) for ends in (rig, world)]
    pairs = pd.concat([ends[names[0]] for ends in both], axis=1).dropna().to_numpy().T
    mean = ttest_1samp(pairs[1] - pairs[0], 0.0).confidence_interval(_CONFIDENCE)
    rows: list[list[object]] = [
        _compare("mean", pairs.mean(axis=1), (float(mean.low), float(mean.high))),
        _compare("90 % quantile", np.quantile(pairs, QUANTILE, axis=1), _bound_quantile(pairs)),
        ["mean as measured", *(f"{ends[names[1]].mean():.4f}" for ends in both), "-", "-", "-"],
        ["reached", *(f"{(ends['reached'] == 1.0).mean():.1%}" for ends in both), "-", "-", "-"],
    ]
    heads = ("true final error, mm", "rig", "world", "world - rig", "90 % interval", f"within {WITHIN_MM:g}")
    print_rows(heads, rows)
    left_out = len(SEEDS) - pairs.shape[1]
    print(f"{left_out} seeds left out; correlation of the errors of a seed {np.corrcoef(pairs)[0, 1]:.2f}\n")


def _compare(name: str, figures_mm: FloatArray, bounds_mm: tuple[float, float]) -> list[object]:
    """Return a row of a figure of rig and world, and the interval of its difference."""
    (of_rig, of_world), (low_mm, high_mm) = figures_mm.tolist(), bounds_mm
    apart = low_mm > WITHIN_MM or high_mm < -WITHIN_MM
    equivalent = "yes" if low_mm > -WITHIN_MM and high_mm < WITHIN_MM else "NO" if apart else "not told"
    figures = (f"{of_rig:.4f}", f"{of_world:.4f}", f"{of_world - of_rig:+.4f}")
    return [name, *figures, f"{low_mm:+.4f} to {high_mm:+.4f}", equivalent]


def _bound_quantile(pairs_mm: FloatArray) -> tuple[float, float]:
    """Return the interval of the difference of the quantiles, by a bootstrap over pairs."""
    count = pairs_mm.shape[1]
    drawn = np.random.default_rng(0).integers(count, size=(_RESAMPLED, count))
    of_rig, of_world = np.quantile(pairs_mm[:, drawn], QUANTILE, axis=-1)
    low, high = np.quantile(of_world - of_rig, (0.5 - _CONFIDENCE / 2, 0.5 + _CONFIDENCE / 2)).tolist()
    return low, high
