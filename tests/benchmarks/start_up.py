"""The start-up time of commands beside a bare Python in the same run."""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from labrig.lab import RUNS_DIR_VARIABLE
from tests.benchmarks.catalogue import RUNS, SEARCH, children_s, make_runs
from tests.benchmarks.table import print_rows

REPEATS = 20
BARE = "python -c pass"
COMMANDS: tuple[tuple[str, tuple[str, ...], int | None], ...] = (
    ("--help", ("--help",), 300),
    ("run --help", ("run", "--help"), None),
    ("manual", ("manual",), None),
    ("runs of an empty folder", ("runs", "--runs-dir", "none"), None),
    (f"runs, {RUNS} of them", ("runs",), 300),
    (f"runs --where, {RUNS} of them", ("runs", "--where", SEARCH), 300),
    ("check", ("check", "protocols/steerability.yaml"), None),
)
"""The name of each command line, its words, and its limit [ms]."""


def print_table() -> None:
    """Print the time of twenty runs of each command, in turns, from start to exit.

    The processor time is the least of them: it hardly depends on what else the computer does.
    """
    labrig = str(Path(sys.executable).with_name("labrig"))
    commands = [(BARE, [sys.executable, "-c", "pass"], None)] + [
        (f"labrig {name}", [labrig, *words], limit_ms) for name, words, limit_ms in COMMANDS
    ]
    with tempfile.TemporaryDirectory() as folder:
        make_runs(Path(folder), RUNS)
        # Compiled modules are kept, as they are in an installed labrig.
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment[RUNS_DIR_VARIABLE] = folder
        for _, command, _ in commands:  # makes what is kept: compiled modules, and the index of the runs
            _time_ms(command, environment)
        rounds = [[_time_ms(command, environment) for _, command, _ in commands] for _ in range(REPEATS)]
    taken = list(zip(*rounds, strict=True))
    walls = [statistics.median(wall for wall, _ in times) for times in taken]
    least = [min(processor for _, processor in times) for times in taken]
    rows = [
        [
            name,
            f"{wall:.0f}",
            f"{wall / walls[0]:.1f}",
            f"{processor:.0f}",
            f"{processor / least[0]:.1f}",
            "-" if limit_ms is None else str(limit_ms),
        ]
        for (name, _, limit_ms), wall, processor in zip(commands, walls, least, strict=True)
    ]
    heads = ("command", "median ms", "times bare", "least processor ms", "times bare", "limit ms")
    print_rows(heads, rows)


def _time_ms(command: list[str], environment: Mapping[str, str]) -> tuple[float, float]:
    """Return wall and processor time [ms] of a command whose output goes into a pipe."""
    before_s, started = children_s(), time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env=environment)
    return 1000 * (time.perf_counter() - started), 1000 * (children_s() - before_s)
