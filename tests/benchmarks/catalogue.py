"""The time to list and search 5,000 runs, and the processor time to search 3,000 sweeps without an index."""

import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

from labrig.record.catalogue import list_runs
from labrig.record.run_index import INDEX_FILE
from labrig.record.search import find_runs
from tests.benchmarks.table import print_rows
from tests.record.runs import STARTED, closed_run

RUNS = 5000
SEARCH = "diameter_mm=1.2 and exit_status=success and seed<100"
LIMIT_S = 0.3
SWEEPS = 3000
COLD_LIMIT_S = 5.0
SWEEP = Path(__file__).parents[1] / "records" / "steerability"
REPETITIONS = 7


def print_table(runs: int = RUNS) -> None:
    """Print the time of a list and a search: the command from start to exit, and the query alone."""
    with tempfile.TemporaryDirectory() as folder:
        runs_dir = Path(folder)
        make_runs(runs_dir, runs)
        first_s = _best_s(lambda: list_runs(runs_dir), 1)
        first_search_s = _best_s(lambda: find_runs(runs_dir, SEARCH), 1)
        command = [sys.executable, "-m", "labrig", "runs", "--runs-dir"]
        rows: list[tuple[str, float, float | None]] = [
            ("labrig runs, from start to exit", _command_s([*command, folder]), LIMIT_S),
            ("labrig runs --where, likewise", _command_s([*command, folder, "--where", SEARCH]), LIMIT_S),
            ("labrig runs of an empty folder", _command_s([*command, f"{folder}/none"]), None),
            ("the list alone", _best_s(lambda: list_runs(runs_dir), REPETITIONS), None),
            ("the search alone", _best_s(lambda: find_runs(runs_dir, SEARCH), REPETITIONS), None),
            ("the list, index lost: made again", first_s, None),
            ("the search, likewise", first_search_s, None),
        ]
    with tempfile.TemporaryDirectory() as folder:
        cold_s = _search_cold_s(Path(folder), SWEEPS)
        rows.append((f"labrig runs --where of {SWEEPS} sweeps, index lost, processor", cold_s, COLD_LIMIT_S))
    print_rows(
        [f"{runs} runs", "ms", "limit ms"],
        [
            [what, f"{1e3 * took:.0f}", "-" if limit is None else f"{1e3 * limit:.0f}"]
            for what, took, limit in rows
        ],
    )


def _command_s(command: list[str]) -> float:
    """Return the median wall time [s] of a command whose table goes into a pipe."""
    times = []
    for _ in range(REPETITIONS):
        started = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        times.append(time.perf_counter() - started)
    return statistics.median(times)


def _search_cold_s(runs_dir: Path, runs: int) -> float:
    """Return the median processor time [s] of a search among copies of a sweep, of which nothing is known yet."""
    for number in range(runs):
        shutil.copytree(SWEEP, runs_dir / f"{number:05d}", ignore=shutil.ignore_patterns("*.png", "can.log"))
    command = [sys.executable, "-m", "labrig", "runs", "--runs-dir", str(runs_dir)]
    times = []
    for _ in range(REPETITIONS):
        (runs_dir / INDEX_FILE).unlink(missing_ok=True)
        before_s = children_s()
        subprocess.run([*command, "--where", "gelatin_percent=13"], check=True, capture_output=True)
        times.append(children_s() - before_s)
    return statistics.median(times)


def children_s() -> float:
    """Return the processor time [s] of the processes that this one has started, and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _best_s(work: Callable[[], object], repetitions: int) -> float:
    times = []
    for _ in range(repetitions):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return min(times)


def make_runs(runs_dir: Path, runs: int) -> None:
    """Make a run as a recorder does, and copies under other names without the pictures."""
    first = closed_run(runs_dir, "00000", started=STARTED + timedelta(seconds=1))
    for number in range(1, runs):
        shutil.copytree(first, runs_dir / f"{number:05d}", ignore=shutil.ignore_patterns("*.png"))
