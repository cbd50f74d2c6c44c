"""The time to list and search 5,000 runs, with files cached."""

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

from labrig.record.catalogue import list_runs
from tests.benchmarks.table import print_rows
from tests.record.runs import STARTED

RUNS = 5000
SEARCH = "diameter_mm=1.2 and exit_status=success and seed<100"
LIMIT_S = 1.0
SWEEP = Path(__file__).parents[1] / "records" / "insertion"
REPETITIONS = 5


def print_table(runs: int = RUNS) -> None:
    """Print the time of a list and a search: the command from start to exit, and the query alone."""
    with tempfile.TemporaryDirectory() as folder:
        runs_dir = Path(folder)
        make_runs(runs_dir, runs)
        command = [sys.executable, "-m", "labrig", "runs", "--runs-dir"]
        rows: list[tuple[str, float, float | None]] = [
            ("labrig runs, from start to exit", _command_s([*command, folder]), LIMIT_S),
            ("labrig runs --where, likewise", _command_s([*command, folder, "--where", SEARCH]), None),
            ("labrig runs of an empty folder", _command_s([*command, f"{folder}/none"]), None),
            ("the list alone", _median_s(lambda: list_runs(runs_dir)), None),
            ("the search alone", _median_s(lambda: list_runs(runs_dir, SEARCH)), None),
        ]
    print_rows(
        [f"{runs} runs", "ms", "limit ms"],
        [
            [what, f"{1e3 * took:.0f}", "-" if limit is None else f"{1e3 * limit:.0f}"]
            for what, took, limit in rows
        ],
    )


def make_runs(runs_dir: Path, runs: int) -> None:
    """Make runs with the manifest of a kept insertion, started an hour apart."""
    manifest, protocol = ((SWEEP / name).read_text() for name in ("manifest.json", "protocol.yaml"))
    started = next(line for line in manifest.splitlines() if line.startswith('"started"'))
    for number in range(runs):
        run = runs_dir / f"run-{number:05d}"
        run.mkdir()
        later = (STARTED + timedelta(hours=number)).isoformat(timespec="seconds")
        (run / "manifest.json").write_text(manifest.replace(started, f'"started":"{later}",'))
        (run / "protocol.yaml").write_text(protocol)


def children_s() -> float:
    """Return the processor time [s] of the processes that were started and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _command_s(command: list[str]) -> float:
    """Return the median wall time [s] of a command whose table goes into a pipe."""
    return _median_s(lambda: subprocess.run(command, check=True, capture_output=True))


def _median_s(call: Callable[[], object]) -> float:
    times = []
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times)
