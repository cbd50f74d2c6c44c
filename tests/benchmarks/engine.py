"""What the engine of campaigns costs: overhead of tasks of 100 ms, cost of a batch, speed-up, and memory.

`python -m tests.benchmarks engine`. The tasks of the first two tables wait instead of computing, so that other load on
the processor counts little; those of the third compute.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
    """Take some ten milliseconds of the processor."""
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


def print_table() -> None:
    """Print the four tables."""
    rows = []
    with open_process_pool(WORKERS, "waited") as pool:
        rows.append(_measure_pool("process pool", pool))
    with open_local_cluster(WORKERS) as cluster, open_cluster(cluster.scheduler_address, "waited") as pool:
        rows.append(_measure_pool("dask, two local workers", pool))
    heads = (
        f"{WORKERS} workers",
        f"overhead of {TASK_S:g} s tasks %",
        "limit %",
        "ms a batch",
        "1 ms tasks: % of the time",
    )
    print_rows(heads, [row[:5] for row in rows])
    print(
        "ms a batch: processor time of this process, which schedules, for a batch of a task; for dask\n"
        "with its scheduler\n"
    )
    _print_reach(rows)
    _print_speed_up()
    _print_memory()


def _measure_pool(name: str, pool: Pool) -> list[object]:
    """Return the overhead at long tasks, the cost of a batch, and the share of the time that short tasks take."""
    list(run_in_order(pool, wait_short, range(20)))  # workers have begun
    long_s = _time(lambda: list(run_in_order(pool, wait_long, range(LONG_TASKS), clock=SystemClock())))
    overhead = long_s * WORKERS / (LONG_TASKS * TASK_S) - 1.0
    before_s = time.process_time()
    list(run_in_order(pool, wait_short, range(SHORT_TASKS)))
    batch_s = (time.process_time() - before_s) / SHORT_TASKS
    short_s = _time(lambda: list(run_in_order(pool, wait_short, range(SHORT_TASKS), clock=SystemClock())))
    share = SHORT_TASKS * 0.001 / WORKERS / short_s
    return [
        name,
        f"{100 * overhead:.1f}",
        f"{100 * LIMIT_OVERHEAD:.0f}",
        f"{1e3 * batch_s:.2f}",
        f"{100 * share:.0f}",
        batch_s,
    ]


def _print_reach(rows: list[list[object]]) -> None:
    """Print where it would end: the time that one scheduler takes for a million tasks, and that the workers take."""
    tasks_a_batch = max(1, round(BATCH_S_A_WORKER * MANY_WORKERS / TASK_S))
    reach = []
    for name, *_, batch_s in rows:
        scheduling_s = MANY_TASKS / tasks_a_batch * float(str(batch_s))
        ideal_s = MANY_TASKS * TASK_S / MANY_WORKERS
        most = BATCH_S_A_WORKER * MANY_WORKERS / float(str(batch_s))
        reach.append(
            [name, f"{ideal_s:.0f}", f"{scheduling_s:.0f}", f"{scheduling_s / ideal_s:.2f}", f"{most:.0f}"]
        )
    print_rows(
        (
            f"{MANY_TASKS} tasks of {TASK_S:g} s, {MANY_WORKERS} workers",
            "tasks s",
            "scheduling s",
            "share",
            "most workers",
        ),
        reach,
    )
    print(
        f"computed from ms a batch, for batches of {tasks_a_batch} tasks, as the engine makes them for so many\n"
        "workers; above a share of 1, or beyond the most workers, everything waits for the scheduler\n"
    )


def _print_speed_up() -> None:
    load = os.getloadavg()[0]
    times_s = {workers: min(_time_computing(workers) for _ in range(3)) for workers in (1, WORKERS)}
    ratio = times_s[1] / times_s[WORKERS]
    print_rows(
        ("300 computing tasks", "1 process s", f"{WORKERS} processes s", "ratio", "limit", "load before"),
        [
            [
                "process pool",
                f"{times_s[1]:.2f}",
                f"{times_s[WORKERS]:.2f}",
                f"{ratio:.2f}",
                LIMIT_SPEED_UP,
                f"{load:.1f}",
            ]
        ],
    )
    print("load: processes that want the processor already; above 0.2 the ratio says little\n")


def _time_computing(workers: int) -> float:
    with open_process_pool(workers, "computed") as pool:
        return _time(lambda: list(run_in_order(pool, compute, range(300), clock=SystemClock())))


def _print_memory() -> None:
    rows = []
    for tasks in (1_000, 10_000, 100_000):
        command = [
            sys.executable,
            "-c",
            f"from tests.benchmarks.engine import print_peak; print_peak({tasks})",
        ]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        rows.append([tasks, done.stdout.strip()])
    print_rows(("tasks of 1 ms", "peak memory of the parent MB"), rows)


def _time(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started
