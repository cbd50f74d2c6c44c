"""The closed loop with camera, bus and record: `labrig run protocols/insertion.yaml`, and virtual insertions beside it.

`insertion` prints what comes of twenty seeds. `world-agrees` makes whole runs and virtual insertions with the same
fresh seeds, so that gel and disturbances are the same and each seed is a pair. Mean and 90 % quantile of the true final
error are equivalent if the 90 % interval of their difference lies within `WITHIN_MM` (two one-sided tests at 5 %):
Student's interval for the mean, the percentiles of a bootstrap over seeds for the quantile. A run of the rig takes some
seconds. LABRIG_BENCHMARK_WORLDS sets the number of seeds, 200 unless set.
"""

import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import ttest_1samp

from labrig.needle.kinematics import FloatArray
from tests.benchmarks.table import measure, print_rows, read_count
from tests.benchmarks.virtual import PROTOCOL, RIG, insert

SEEDS = range(1, 21)
LARGEST_ERROR_MM, LONGEST_S = 1.0, 15.0
FRESH = range(800_001, 800_001 + read_count("WORLDS", 200))
WITHIN_MM = 0.05
QUANTILE = 0.9
_CONFIDENCE = 0.9
_RESAMPLED = 10_000
_FIGURES = ("true_target_error_mm", "target_error_mm", "true_min_clearance_mm")


def _run(seed: int) -> tuple[dict[str, Any], dict[str, Any], int, float]:
    """Return document and result of a whole run, the number of turns in tissue, and the wall time [s]."""
    with tempfile.TemporaryDirectory() as folder:
        where = ["--rig", str(RIG), "--runs-dir", folder, "--seed", str(seed)]
        done = measure([sys.executable, "-m", "labrig", "run", str(PROTOCOL), *where, "--json"])
        document: dict[str, Any] = json.loads(done.out)
        events = map(
            json.loads, (Path(document["run"]) / "events.jsonl").read_text(encoding="utf-8").splitlines()
        )
        turns = sum(event["kind"] == "flip" and event["depth_mm"] > 0 for event in events)
    return document, document.get("result") or {}, turns, done.wall_s


def print_table() -> None:
    """Run every seed, and print its figures and how many seeds keep the limits."""
    runs = [_run(seed) for seed in SEEDS]
    results = [result for _, result, _, _ in runs]
    rows = [
        [
            seed, document.get("exit_status"), document.get("reason") or "-",
            *("-" if result.get(name) is None else f"{result[name]:.3f}" for name in _FIGURES), turns, f"{wall_s:.1f}",
        ]
        for seed, (document, result, turns, wall_s) in zip(SEEDS, runs, strict=True)
    ]  # fmt: skip
    heads = (
        "seed",
        "exit status",
        "reason",
        "true error mm",
        "measured mm",
        "clearance mm",
        "turns",
        "wall s",
    )
    print_rows(heads, rows)
    known = [result[_FIGURES[0]] for result in results if result.get(_FIGURES[0]) is not None]
    within = sum(error <= LARGEST_ERROR_MM for error in known)
    print_rows(
        ("figure", "measured", "limit"),
        [
            [f"within {LARGEST_ERROR_MM:g} mm", within, len(SEEDS)],
            ["mean true error, mm", f"{sum(known) / max(len(known), 1):.3f}", "0.4"],
            [
                f"95 % intervals in space that hold the true error, of {len(SEEDS)}",
                sum(map(_holds, results)),
                "-",
            ],
            ["longest wall time, s", f"{max(wall_s for *_, wall_s in runs):.1f}", f"{LONGEST_S:g}"],
        ],
    )


def _holds(result: dict[str, Any]) -> bool:
    """Return whether the true error lies in its interval in space."""
    true_mm, interval_mm = (
        result.get(f"{name}_mm") for name in ("true_target_error", "target_error_interval")
    )
    return None not in (true_mm, interval_mm) and interval_mm[0] <= true_mm <= interval_mm[1]


def print_agreement() -> None:
    """Print both means and quantiles, and the intervals of their differences."""
    rig = _read_ends([_run(seed)[1] for seed in FRESH])
    with ProcessPoolExecutor() as executor:
        world = _read_ends([outcome.values for outcome in executor.map(insert, FRESH, chunksize=4)])
    measured = (f"{np.nanmean(ends[1]):.4f}" for ends in (rig, world))
    rows: list[list[object]] = [
        _compare("mean", rig[0], world[0], np.mean, _bound_mean),
        _compare("90 % quantile", rig[0], world[0], _find_quantile, _bound_quantile),
        ["mean as measured", *measured, "-", "-", "-"],
        ["reached", *(f"{np.mean(ends[2] == 1.0):.1%}" for ends in (rig, world)), "-", "-", "-"],
    ]
    heads = ("true final error, mm", "rig", "world", "world - rig", "90 % interval", f"within {WITHIN_MM:g}")
    print_rows(heads, rows)
    together = float(np.corrcoef(rig[0], world[0])[0, 1])
    print(f"{len(FRESH)} seeds from {FRESH.start}; correlation of the errors of a seed {together:.2f}\n")


def _read_ends(values: Sequence[Mapping[str, Any]]) -> FloatArray:
    """Return true final errors, errors as measured, and whether insertions reached, (3, N)."""
    names = (*_FIGURES[:2], "reached")
    return np.array(
        [[np.nan if each[name] is None else float(each[name]) for each in values] for name in names]
    )


def _compare(
    name: str,
    rig_mm: FloatArray,
    world_mm: FloatArray,
    describe: Callable[[FloatArray], Any],
    bound: Callable[[FloatArray, FloatArray], tuple[float, float]],
) -> list[object]:
    low_mm, high_mm = bound(rig_mm, world_mm)
    of_rig, of_world = float(describe(rig_mm)), float(describe(world_mm))
    equivalent = low_mm > -WITHIN_MM and high_mm < WITHIN_MM
    figures = (f"{of_rig:.4f}", f"{of_world:.4f}", f"{of_world - of_rig:+.4f}")
    return [name, *figures, f"{low_mm:+.4f} to {high_mm:+.4f}", "yes" if equivalent else "NO"]


def _bound_mean(rig_mm: FloatArray, world_mm: FloatArray) -> tuple[float, float]:
    """Return the interval of the mean difference of pairs."""
    low, high = ttest_1samp(world_mm - rig_mm, 0.0).confidence_interval(_CONFIDENCE)
    return float(low), float(high)


def _bound_quantile(rig_mm: FloatArray, world_mm: FloatArray) -> tuple[float, float]:
    """Return the interval of the difference of the quantiles, by a bootstrap over pairs."""
    drawn = np.random.default_rng(0).integers(len(rig_mm), size=(_RESAMPLED, len(rig_mm)))
    differences = _find_quantile(world_mm[drawn]) - _find_quantile(rig_mm[drawn])
    low, high = np.quantile(differences, (0.5 - _CONFIDENCE / 2, 0.5 + _CONFIDENCE / 2)).tolist()
    return low, high


def _find_quantile(values: FloatArray) -> FloatArray:
    return np.asarray(np.quantile(values, QUANTILE, axis=-1))
