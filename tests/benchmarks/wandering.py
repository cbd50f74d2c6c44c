"""Whole insertions whose needle wanders out of the plane more than the protocol says: how many are false successes.

`python -m tests.benchmarks wandering`; the number of insertions in each row is `LABRIG_BENCHMARK_WORLDS`, 20 unless
set. They are virtual runs of protocols/insertion.yaml. A run judges itself by its last picture, which tells the
needle's depth by its width and length; the world knows where its tip is. Where the needle wanders as the protocol says,
the same runs show what that caution costs.
"""

import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

from labrig.experiments.registry import find_experiment
from labrig.runner.dry_run import simulate
from tests.benchmarks.table import print_rows
from tests.benchmarks.virtual_runs import read_policy, read_simulated_rig

INSERTIONS = int(os.environ.get("LABRIG_BENCHMARK_WORLDS", "20"))
SEEDS = range(740_000, 740_000 + INSERTIONS)
WANDERS_DEG = (0.05, 0.2, 0.3, 0.5)
TOLERANCE_MM = read_policy("default").target.tolerance_mm


def insert_wandering(wanders_deg: float, seed: int) -> tuple[str, float | None]:
    """Return the exit status of a virtual insertion, and the true distance of its tip from the target [mm]."""
    rig = read_simulated_rig()
    assert rig.world is not None
    disturbances = rig.world.disturbances.model_copy(update={"out_of_plane_deg_per_root_mm": wanders_deg})
    world = rig.world.model_copy(update={"disturbances": disturbances})
    outcome = simulate(
        find_experiment("insertion"), read_policy("default"), rig.model_copy(update={"world": world}), seed
    )
    error_mm = outcome.values["true_target_error_mm"]
    return str(outcome.exit_status), None if error_mm is None else float(error_mm)


def is_false_success(status: str, error_mm: float | None) -> bool:
    """Return whether a run that says success ended beyond the tolerance."""
    return status == "success" and error_mm is not None and error_mm > TOLERANCE_MM


def print_table() -> None:
    """Print a row for each wandering: how many insertions say success, and how many of these are false."""
    rows = []
    with ProcessPoolExecutor(os.cpu_count(), get_context("fork")) as pool:
        for wanders_deg in WANDERS_DEG:
            ends = list(pool.map(partial(insert_wandering, wanders_deg), SEEDS))
            beyond = sum((error or 0.0) > TOLERANCE_MM for _, error in ends)
            said = sum(status == "success" for status, _ in ends)
            rows.append(
                [f"{wanders_deg:g}", len(ends), beyond, said, sum(is_false_success(*end) for end in ends)]
            )
    print_rows(
        ("wanders, deg / mm^0.5", "insertions", "truly beyond", "say success", "false successes"), rows
    )
    print(f"seeds {SEEDS.start} to {SEEDS.stop - 1}; wanted: no false success")
