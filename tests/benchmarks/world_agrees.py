"""Do virtual insertions end where those of the whole simulated rig end, with camera, bus and record?

Both make protocols/insertion.yaml on the simulated rig with the same fresh seeds, so that gel and disturbances are
the same and each seed is a pair. Mean and 90 % quantile of the true final error are equivalent if the 90 % interval of
their difference lies within `WITHIN_MM` (two one-sided tests at 5 %): Student's interval for the mean, the percentiles
of a bootstrap over seeds for the quantile. The errors of sightings are fitted anew to the rig's runs, beside those that
are drawn, which other seeds gave.

A run of the rig takes some seconds. LABRIG_BENCHMARK_WORLDS sets the number of seeds, 200 unless set. Without
LABRIG_BENCHMARK_RUNS_DIR the runs are made in a temporary folder; with it they are kept in that folder, without
pictures, and those that are there already are not made again.
"""

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from labrig.experiments.registry import find_experiment
from labrig.needle.kinematics import FloatArray
from labrig.runner.dry_run import simulate
from tests.benchmarks.table import print_rows
from tests.benchmarks.virtual_runs import PROTOCOL, RIG, read_policy, read_simulated_rig

SEEDS = range(800_001, 800_001 + int(os.environ.get("LABRIG_BENCHMARK_WORLDS", "200")))
WITHIN_MM = 0.05
QUANTILE = 0.9
_CONFIDENCE = 0.9
_RESAMPLED = 10_000
_BULKY = ("frames", "can.log")


@dataclass(frozen=True)
class Ends:
    """Ends of insertions by both depths, (N,) each: true final error, error as measured, and whether they reached."""

    true_mm: FloatArray
    measured_mm: FloatArray
    reached: FloatArray

    @classmethod
    def of(cls, values: Sequence[dict[str, Any]]) -> "Ends":
        """Return the ends of runs by their values."""
        columns = (
            [np.nan if value[name] is None else float(value[name]) for value in values]
            for name in ("true_target_error_mm", "target_error_mm", "reached")
        )
        return cls(*map(np.array, columns))


def print_table() -> None:
    """Print both means and quantiles, and the intervals of their differences."""
    kept = os.environ.get("LABRIG_BENCHMARK_RUNS_DIR")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(kept or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        rig = Ends.of([_run(folder, seed) for seed in SEEDS])
    with ProcessPoolExecutor() as executor:
        world = Ends.of(list(executor.map(_simulate, SEEDS, chunksize=4)))
    _print_agreement(rig, world)


def _print_agreement(rig: Ends, world: Ends) -> None:
    rows: list[list[object]] = [
        _compare("mean", rig.true_mm, world.true_mm, np.mean, _bound_mean),
        _compare("90 % quantile", rig.true_mm, world.true_mm, _find_quantile, _bound_quantile),
        [
            "mean as measured",
            *(f"{np.nanmean(ends.measured_mm):.4f}" for ends in (rig, world)),
            "-",
            "-",
            "-",
        ],
        ["reached", *(f"{np.mean(ends.reached == 1.0):.1%}" for ends in (rig, world)), "-", "-", "-"],
    ]
    heads = ("true final error, mm", "rig", "world", "world - rig", "90 % interval", f"within {WITHIN_MM:g}")
    print_rows(heads, rows)
    together = float(np.corrcoef(rig.true_mm, world.true_mm)[0, 1])
    print(f"{len(SEEDS)} seeds from {SEEDS.start}; correlation of the errors of a seed {together:.2f}\n")


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
    differences = (world_mm - rig_mm).tolist()
    mean, error = statistics.mean(differences), statistics.stdev(differences) / len(differences) ** 0.5
    reach = float(student.ppf(0.5 + _CONFIDENCE / 2, len(differences) - 1)) * error
    return mean - reach, mean + reach


def _bound_quantile(rig_mm: FloatArray, world_mm: FloatArray) -> tuple[float, float]:
    """Return the interval of the difference of the quantiles, by a bootstrap over pairs."""
    drawn = np.random.default_rng(0).integers(len(rig_mm), size=(_RESAMPLED, len(rig_mm)))
    differences = _find_quantile(world_mm[drawn]) - _find_quantile(rig_mm[drawn])
    low, high = np.quantile(differences, (0.5 - _CONFIDENCE / 2, 0.5 + _CONFIDENCE / 2)).tolist()
    return low, high


def _find_quantile(values: FloatArray) -> FloatArray:
    return np.asarray(np.quantile(values, QUANTILE, axis=-1))


def _simulate(seed: int) -> dict[str, Any]:
    return dict(
        simulate(find_experiment("insertion"), read_policy("default"), read_simulated_rig(), seed).values
    )


def _run(folder: Path, seed: int) -> dict[str, Any]:
    """Return the result of a whole run on the simulated rig, made now unless the folder has it."""
    name, answer = f"seed-{seed}", folder / f"seed-{seed}.json"
    if not answer.exists():
        where = ["--rig", str(RIG), "--runs-dir", str(folder), "--run-name", name, "--seed", str(seed)]
        command = [sys.executable, "-m", "labrig", "run", str(PROTOCOL), *where, "--json"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        for bulky in _BULKY:
            shutil.rmtree(folder / name / bulky, ignore_errors=True)
            (folder / name / bulky).unlink(missing_ok=True)
        answer.write_text(done.stdout, encoding="utf-8")
    result: dict[str, Any] = json.loads(answer.read_text(encoding="utf-8"))["result"]
    return result
