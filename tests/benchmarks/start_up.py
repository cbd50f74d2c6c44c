"""The time of commands from start to exit, beside a bare Python in the same run; and of lists of 5,000 runs."""

import os
import statistics
import sys
import tempfile
from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path

from labrig.lab import RUNS_DIR_VARIABLE
from tests.benchmarks.table import measure, multiply, print_rows
from tests.record.runs import STARTED

REPEATS, RUNS = multiply(7), 5000
KEPT = Path(__file__).parents[1] / "records" / "insertion"
SEARCH = "diameter_mm=1.2 and exit_status=success and seed<100"
BARE = "python -c pass"
Commands = Mapping[str, tuple[tuple[str, ...], int | None]]
"""The name of each command line, its words, and its limit [ms]."""
START_UP: Commands = {
    "--help": (("--help",), 300), "run --help": (("run", "--help"), None), "manual": (("manual",), None),
    "check": (("check", "protocols/steerability.yaml"), None),
}  # fmt: skip
LISTS: Commands = {
    "runs of an empty folder": (("runs", "--runs-dir", "none"), None),
    f"runs, {RUNS} of them": (("runs",), 1000),
    f"runs --where, {RUNS} of them": (("runs", "--where", SEARCH), None),
}


def print_start_up() -> None:
    """Print the time of commands that read no runs."""
    _print_times(START_UP, {})


def print_catalogue() -> None:
    """Print the time to list and search 5,000 runs, with files cached."""
    with tempfile.TemporaryDirectory() as folder:
        _make_runs(Path(folder))
        _print_times(LISTS, {RUNS_DIR_VARIABLE: folder})


def _print_times(commands: Commands, variables: Mapping[str, str]) -> None:
    """Print the median time of each command, in turns, from start to exit.

    The processor time is the least of them: it hardly depends on what else the computer does.
    """
    labrig = str(Path(sys.executable).with_name("labrig"))
    lines = [[sys.executable, "-c", "pass"], *([labrig, *words] for words, _ in commands.values())]
    # Compiled modules are kept, as they are in an installed labrig.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment |= variables
    rounds = [[measure(line, environment=environment) for line in lines] for _ in range(1 + REPEATS)]
    taken = list(zip(*rounds[1:], strict=True))  # the first makes what is kept
    walls = [1e3 * statistics.median(done.wall_s for done in each) for each in taken]
    least = [1e3 * min(done.cpu_s for done in each) for each in taken]
    limits = {BARE: None, **{f"labrig {name}": limit_ms for name, (_, limit_ms) in commands.items()}}
    print_rows(
        ("command", "median ms", "times bare", "least processor ms", "times bare", "limit ms"),
        [
            [name, f"{wall:.0f}", f"{wall / walls[0]:.1f}", f"{cpu:.0f}", f"{cpu / least[0]:.1f}", limit_ms or "-"]
            for (name, limit_ms), wall, cpu in zip(limits.items(), walls, least, strict=True)
        ],
    )  # fmt: skip


def _make_runs(runs_dir: Path) -> None:
    """Make runs with the manifest of a kept insertion, started an hour apart."""
    manifest, protocol = ((KEPT / name).read_text() for name in ("manifest.json", "protocol.yaml"))
    started = next(line for line in manifest.splitlines() if line.startswith('"started"'))
    for number in range(RUNS):
        run = runs_dir / f"run-{number:05d}"
        run.mkdir()
        later = (STARTED + timedelta(hours=number)).isoformat(timespec="seconds")
        (run / "manifest.json").write_text(manifest.replace(started, f'"started":"{later}",'))
        (run / "protocol.yaml").write_text(protocol)
