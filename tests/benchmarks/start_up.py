"""The start-up time of commands beside a bare Python in the same run."""

import statistics
import subprocess
import sys
import time
from pathlib import Path

from tests.benchmarks.table import print_rows

REPEATS = 20
COMMANDS = (
    ("--help",),
    ("run", "--help"),
    ("runs", "--runs-dir", "none"),
    ("schema",),
    ("check", "protocols/steerability.yaml"),
)


def print_table() -> None:
    """Print median and fastest of twenty runs per command, in turns."""
    labrig = str(Path(sys.executable).with_name("labrig"))
    commands = {"python -c pass": [sys.executable, "-c", "pass"]} | {
        " ".join(["labrig", *words]): [labrig, *words] for words in COMMANDS
    }
    times: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(REPEATS):
        for name, command in commands.items():
            started = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            times[name].append(1000 * (time.perf_counter() - started))
    bare = statistics.median(times["python -c pass"])
    rows = [
        [
            name,
            f"{statistics.median(taken):.0f}",
            f"{min(taken):.0f}",
            f"{statistics.median(taken) / bare:.1f}",
        ]
        for name, taken in times.items()
    ]
    print_rows(("command", "median ms", "fastest ms", "times bare python"), rows)
