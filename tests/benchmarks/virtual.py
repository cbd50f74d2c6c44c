"""Virtual insertions a second: by one process and by two, for three policies.

The insertions are those of protocols/insertion.yaml on the simulated rig, of about 105 mm. `every 20 mm` replans as the
paper does, with labrig's planner and filter; `paper` has the paper's planner and filter too. A second process gives at
most what the computer has: a busy or hyper-threaded core is no whole one. LABRIG_BENCHMARK_WORLDS sets how many
insertions each figure is from, 20 unless set. Where the time goes: `python -m cProfile -s tottime -m labrig campaign`.
"""

import os
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

from labrig.experiments.registry import find_experiment
from labrig.runner.dry_run import simulate
from tests.benchmarks.table import print_rows
from tests.benchmarks.virtual_runs import POLICIES, read_policy, read_simulated_rig

INSERTIONS = int(os.environ.get("LABRIG_BENCHMARK_WORLDS", "20"))
SEEDS = range(300_000, 300_000 + INSERTIONS)
WANTED = {"default": "10", "every 20 mm": "40"}
"""Insertions a second that are wanted of two processes."""


def print_table() -> None:
    """Print the rates of each policy."""
    rows = []
    for policy in POLICIES:
        (one_s, cpu_s), (two_s, _) = (_time(policy, workers) for workers in (1, 2))
        rates = (f"{INSERTIONS / one_s:.1f}", f"{INSERTIONS / two_s:.1f}", f"{one_s / two_s:.2f}")
        rows.append([policy, *rates, WANTED.get(policy, "-"), f"{cpu_s / INSERTIONS:.3f}"])
    heads = ("policy", "1 process, 1/s", "2 processes, 1/s", "ratio", "wanted of 2", "processor s each")
    print_rows(heads, rows)


def _time(policy: str, workers: int) -> tuple[float, float]:
    """Return the wall time of the insertions by so many processes, and their processor time [s]."""
    with ProcessPoolExecutor(workers, get_context("fork")) as pool:
        list(pool.map(partial(_insert, policy), range(2 * workers)))  # imports, and the first plan
        began_s = time.perf_counter()
        cpu_s = sum(pool.map(partial(_insert, policy), SEEDS))
        return time.perf_counter() - began_s, cpu_s


def _insert(policy: str, seed: int) -> float:
    """Make an insertion, and return its processor time [s]."""
    began_s = time.process_time()
    simulate(find_experiment("insertion"), read_policy(policy), read_simulated_rig(), seed)
    return time.process_time() - began_s
