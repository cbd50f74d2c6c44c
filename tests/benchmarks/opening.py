"""The cost of checking every picture of a run when it is opened: the report of a sweep of 600 pictures.

`labrig report` from start to exit, in processor time, against the same without the check, which reads no picture that
the page does not show. The two take turns, each in a process of its own; the ratio is that of the medians.
"""

import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.benchmarks.table import print_rows

PROTOCOL = Path(__file__).parents[2] / "protocols" / "steerability.yaml"
SETTINGS = ("insertions_per_specimen=7", "insertion.frame_every_mm=2")
TURNS = 9
MOST = 1.1
_CHECKED = """
from labrig.cli.main import run_command
assert run_command(["report", RUN]) == 0
"""
_UNCHECKED = """
from pathlib import Path
from labrig.cli import main, record
from labrig.runner.whole_run import write_page
from labrig.experiments.registry import load_run_result
from labrig.record.reader import open_run
run = open_run(Path(RUN))
print(write_page(run, load_run_result(run)))
"""
_ALONE = """
from pathlib import Path
from labrig.record.reader import open_run
started_s = time.process_time()
run = open_run(Path(RUN), read_pictures={checked})
for picture in run.pictures:
    assert picture.size
"""


def print_table() -> None:
    """Print the processor time of a report with and without the check, and of reading every picture."""
    with tempfile.TemporaryDirectory() as folder:
        run = _make_run(Path(folder))
        pictures = len(list((run / "frames").iterdir()))
        rows = [
            _row("labrig report, from start to exit", run, _UNCHECKED, _CHECKED),
            _row(
                "open, and decode every picture",
                run,
                _ALONE.format(checked=False),
                _ALONE.format(checked=True),
            ),
        ]
    print_rows((f"a sweep of {pictures} pictures", "unchecked s", "checked s", "ratio", "limit"), rows)


def _make_run(folder: Path) -> Path:
    command = [sys.executable, "-m", "labrig", "run", str(PROTOCOL), "--runs-dir", str(folder)]
    for setting in SETTINGS:
        command += ["--set", setting]
    subprocess.run([*command, "--run-name", "sweep"], check=True, capture_output=True)
    return folder / "sweep"


def _row(what: str, run: Path, unchecked: str, checked: str) -> list[object]:
    turns = [(_cpu_s(run, unchecked), _cpu_s(run, checked)) for _ in range(TURNS)]
    before_s, after_s = (statistics.median(turn[side] for turn in turns) for side in (0, 1))
    return [what, f"{before_s:.2f}", f"{after_s:.2f}", f"{after_s / before_s:.3f}", MOST]


def _cpu_s(run: Path, code: str) -> float:
    """Return the processor time [s] of a program in a process of its own, since its start or its `started_s`."""
    lines = ("import time", "started_s = 0.0", f"RUN = {str(run)!r}", code)
    program = "\n".join((*lines, "print(time.process_time() - started_s)"))
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    return float(done.stdout.split()[-1])
