"""What the engine of campaigns costs: overhead of tasks of 100 ms, cost of a batch, speed-up, and memory.

`python -m tests.benchmarks engine`. The tasks of the first two tables wait instead of computing, so that other load on
the processor counts little; in the third some compute.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Event

import numpy as np
from dask.distributed import LocalCluster

from labrig.analysis.cluster import open_cluster
from labrig.analysis.engine import BATCH_S_A_WORKER, Pool, open_process_pool, run_in_order
from labrig.devices.clocks import SystemClock
from tests.benchmarks.table import print_rows

WORKERS = 2
TASK_S = 0.1
LONG_TASKS = 200
SHORT_TASKS = 2000
REPETITIONS = 3
LIMIT_OVERHEAD = 0.10
LIMIT_SPEED_UP = 1.8
MANY_TASKS, MANY_WORKERS = 10**6, 1000


def wait_long(_: int) -> None:
    """Take 100 ms, not of the processor."""
    Event().wait(TASK_S)


def wait_short(_: int) -> None:
    """Take 1 ms, not of the processor."""
    Event().wait(0.001)


def compute(seed: int) -> float:
    """Take some milliseconds of the processor."""
    total = 0.0
    for number in range(60_000):
        total += (seed ^ number) % 7 / 3.0
    return float(np.float64(total))


@contextmanager
def open_local_cluster(workers: int) -> Iterator[LocalCluster]:
    """Give a dask cluster of processes that the loopback alone reaches."""
    with LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address=None,
        scheduler_kwargs={"dashboard": False},
        silence_logs=50,
    ) as cluster:
        yield cluster


@dataclass(frozen=True)
class _Cost:
    """What a pool costs: overhead at long tasks, processor time of a batch [s], share of the time of short tasks."""

    name: str
    overhead: float
    batch_s: float
    share: float


def print_table() -> None:
    """Print the four tables."""
    with open_process_pool(WORKERS, "waited") as pool:
        costs = [_measure_pool("process pool", pool)]
    with open_local_cluster(WORKERS) as cluster, open_cluster(cluster.scheduler_address, "waited") as pool:
        costs.append(_measure_pool("dask, local workers", pool))
    print_rows(
        (
            f"{WORKERS} workers",
            f"overhead at {TASK_S:g} s tasks",
            "limit",
            "ms a batch",
            "1 ms tasks, of the time",
        ),
        [
            [
                cost.name,
                f"{cost.overhead:.1%}",
                f"{LIMIT_OVERHEAD:.0%}",
                f"{1e3 * cost.batch_s:.2f}",
                f"{cost.share:.0%}",
            ]
            for cost in costs
        ],
    )
    print("a batch: processor time of this process, which schedules; for dask, with its scheduler\n")
    _print_reach(costs)
    _print_speed_up()
    _print_memory()


def _measure_pool(name: str, pool: Pool) -> _Cost:
    list(run_in_order(pool, wait_short, range(20)))  # workers have begun
    long_s = _time(lambda: list(run_in_order(pool, wait_long, range(LONG_TASKS), clock=SystemClock())))
    before_s = time.process_time()
    list(run_in_order(pool, wait_short, range(SHORT_TASKS)))
    batch_s = (time.process_time() - before_s) / SHORT_TASKS
    short_s = _time(lambda: list(run_in_order(pool, wait_short, range(SHORT_TASKS), clock=SystemClock())))
    return _Cost(
        name,
        overhead=long_s * WORKERS / (LONG_TASKS * TASK_S) - 1.0,
        batch_s=batch_s,
        share=SHORT_TASKS * 0.001 / WORKERS / short_s,
    )


def _print_reach(costs: Sequence[_Cost]) -> None:
    """Print where it would end: the time that one scheduler takes for a million tasks, and that the workers take."""
    batch_tasks = max(1, round(BATCH_S_A_WORKER * MANY_WORKERS / TASK_S))
    ideal_s = MANY_TASKS * TASK_S / MANY_WORKERS
    rows = []
    for cost in costs:
        scheduling_s = MANY_TASKS / batch_tasks * cost.batch_s
        most = BATCH_S_A_WORKER * MANY_WORKERS / cost.batch_s
        rows.append(
            [
                cost.name,
                f"{ideal_s:.0f}",
                f"{scheduling_s:.0f}",
                f"{scheduling_s / ideal_s:.2f}",
                f"{most:.0f}",
            ]
        )
    what = f"{MANY_TASKS} tasks of {TASK_S:g} s, {MANY_WORKERS} workers"
    print_rows((what, "tasks s", "scheduling s", "share", "most workers"), rows)
    print(
        f"computed from ms a batch, for batches of {batch_tasks} tasks, as the engine makes them for so many\n"
        "workers; above a share of 1, or beyond the most workers, everything waits for the scheduler\n"
    )


def _print_speed_up() -> None:
    load = os.getloadavg()[0]
    rows = []
    for name, call, tasks in (("that compute 7 ms", compute, 300), ("that wait 100 ms", wait_long, 60)):
        one_s, both_s = (
            min(_time_alone(workers, call, tasks) for _ in range(REPETITIONS)) for workers in (1, WORKERS)
        )
        row = [
            f"{tasks} {name}",
            f"{one_s:.2f}",
            f"{both_s:.2f}",
            f"{one_s / both_s:.2f}",
            LIMIT_SPEED_UP,
            f"{load:.1f}",
        ]
        rows.append(row)
    print_rows(("tasks", "1 process s", f"{WORKERS} processes s", "ratio", "limit", "load before"), rows)
    print(
        "load: processes that want the processor already; above 0.2 the ratio of those that compute says little\n"
    )


def _time_alone(workers: int, call: Callable[[int], object], tasks: int) -> float:
    with open_process_pool(workers, "computed") as pool:
        return _time(lambda: list(run_in_order(pool, call, range(tasks), clock=SystemClock())))


def _print_memory() -> None:
    rows = []
    for tasks in (1_000, 10_000, 100_000):
        command = [sys.executable, "-m", "tests.benchmarks.engine_memory", str(tasks)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        rows.append([tasks, *done.stdout.split()])
    print_rows(("tasks of 1 ms", "parent before MB", "its peak MB", "allocated at once kB"), rows)
    print("peak: resident memory; allocated: the most that Python held since the first task, by tracemalloc")


def _time(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started
