"""A gel of eighteen insertions of 40 mm in a rehearsal, by the keys of a person who takes their time.

The person pauses, skips a hole, has an insertion made again, and takes that back once. Printed are what the record says
of it, and the time that was said to be left after the first tenth, beside what it was.
"""

import random
import re
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from labrig.record.check import check_run
from labrig.record.events import TrialStart, TrialStop
from labrig.record.reader import Run, open_run
from tests.benchmarks.table import print_rows
from tests.rehearsing import ROOT, agree, run_at_terminal

INSERTIONS = 18
_SLOWEST_S = 240.0
_TAKES_S = {"Shift": (3.0, 6.0), "Mount": (8.0, 12.0)}
"""How long the person takes for a question that begins so, in seconds from and to; for others about one."""

_LEFT = re.compile(r"about (\d+) minutes? of yours and (\d+) of the rig's left\s*>> Shift")


@dataclass
class PacedPerson:
    """Answers after a while, and chooses at some holes."""

    chooses: dict[str, list[str]]
    draws: random.Random = field(default_factory=lambda: random.Random(1))

    def __call__(self, question: str) -> str:
        """Return what is typed at a question."""
        first = question.split(maxsplit=1)[0]
        threading.Event().wait(self.draws.uniform(*_TAKES_S.get(first, (0.5, 1.5))))
        if first == "Paused":
            return "c"
        hole = re.search(r"to hole (\d+)", question)
        keys = self.chooses.get("" if hole is None else hole[1], [])
        return keys.pop(0) if keys else agree(question)


@dataclass
class PressesOnce:
    """Presses Ctrl+C once, when some words are shown."""

    words: str
    pressed: bool = False

    def __call__(self, shown: str) -> str:
        """Return the keys that are pressed now."""
        if self.pressed or self.words not in shown:
            return ""
        self.pressed = True
        return "\x03"


def print_table(insertions: int = INSERTIONS) -> None:
    """Print what a person did, and how well the time that is left was known."""
    tenth = max(2, round(insertions / 10) + 1)
    person = PacedPerson({str(tenth): ["r", "u", "s"], str(tenth + 1): ["r"]})
    settings = (
        "specimens=[{name: gel 13 %, gelatin_percent: 13}]",
        f"insertions_per_specimen={insertions}",
        "rig.clock=real",
        "rig.can.heartbeat.timeout_ms=10000",
    )
    with tempfile.TemporaryDirectory() as runs:
        done = run_at_terminal(
            "run", ROOT / "protocols" / "steerability.yaml", "--rig", ROOT / "calibration" / "rig-simulated.yaml",
            "--runs-dir", runs, "--run-name", "r", "--seed", 7,
            *(word for setting in settings for word in ("--set", setting)),
            answer=person, press=PressesOnce("withdrawing"), patience_s=_SLOWEST_S * insertions,
        )  # fmt: skip
        run = open_run(Path(runs) / "r")
        rows = [*_describe(run), *_compare_left(done.shown, run, tenth)]
    print_rows(("a gel by the keys of a person", ""), rows)


def _describe(run: Run) -> Iterator[list[object]]:
    yield ["run", run.manifest["exit_status"]]
    yield ["damage of the record", len(check_run(run.path).damage)]
    yield ["pauses", len(run.pauses)]
    yield ["skipped, repeated", f"{len(run.decisions.skipped)}, {len(run.decisions.repeated)}"]
    trials = run.read_trials(TrialStart, TrialStop)
    yield ["insertions made, evaluated", f"{len(trials)}, {sum(not trial.left_out for trial in trials)}"]


def _compare_left(shown: str, run: Run, tenth: int) -> Iterator[list[object]]:
    """Yield the time that was said to be left when a tenth was done, and what it was."""
    said = [sum(map(int, found)) for found in _LEFT.findall(shown)]
    ended_s = [stop.t_s for stop in run.read_events(TrialStop)]
    left_min = (ended_s[-1] - ended_s[tenth - 2]) / 60
    yield [f"left at hole {tenth}, as said, min", said[tenth - 1]]
    yield ["as it was, min", f"{left_min:.1f}"]
