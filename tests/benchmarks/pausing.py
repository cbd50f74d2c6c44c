"""A gel of eighteen insertions of 40 mm on the served rig, by the keys of a person who takes their time.

The person pauses, skips a hole, has an insertion made again, takes that back once, and in a second run presses Ctrl+C
twice. Printed are what the record says of it; the time that was said to be left after the first tenth, beside what it
was; and the time from the second Ctrl+C to standstill, at the shaft of the simulated insertion axis.
"""

import random
import re
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from labrig.record.check import check_run
from labrig.record.events import TrialStart, TrialStop
from labrig.record.reader import Run, open_run
from tests.benchmarks.table import print_rows
from tests.rehearsing import ROOT, ServingRig, serve_rehearsal

INSERTIONS = 18
_GEL = "specimens=[{name: gel 13 %, gelatin_percent: 13}]"
_SLOWEST_S = 240.0
_TAKES_S = {"Shift": (3.0, 6.0), "Mount": (8.0, 12.0)}
"""How long the person takes for a question that begins so, in seconds from and to; for others about one."""

_LEFT = re.compile(r"about (\d+) minutes? of yours and (\d+) of the rig's left\s*>> Shift")
_MOVES_MM = 0.002
_WATCHED_S = 1.5
"""For how long the shaft is watched after the second Ctrl+C [s]; labrig takes longer to end."""


@dataclass
class PacedPerson:
    """Answers after a while, and chooses at some holes."""

    bench: ServingRig
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
        return keys.pop(0) if keys else self.bench.obeys(question)


@dataclass
class Presses:
    """Presses Ctrl+C once for each of some words that are shown, and watches the insertion axis after the last."""

    bench: ServingRig
    words: list[str]
    seen: list[tuple[float, float]] = field(default_factory=list)
    pressed_s: float = 0.0
    watches: bool = False

    def __call__(self, shown: str) -> str:
        """Return the keys that are pressed now."""
        if not self.words or self.words[0] not in shown:
            return ""
        self.words.pop(0)
        if self.watches and not self.words:
            self.pressed_s = time.monotonic()
            threading.Thread(target=self._watch, daemon=True).start()
        return "\x03"

    def _watch(self) -> None:
        while not self.seen or self.seen[-1][0] < _WATCHED_S:
            position_mm = float(self.bench.does("scale insertion").rpartition(": ")[2])
            self.seen.append((time.monotonic() - self.pressed_s, position_mm))

    @property
    def standstill_s(self) -> float:
        """When the shaft was last seen to move, after the last key [s]."""
        end_mm = self.seen[-1][1]
        return max((t_s for t_s, mm in self.seen if abs(mm - end_mm) > _MOVES_MM), default=0.0)


def print_table(insertions: int = INSERTIONS) -> None:
    """Print what a person did, how well the time that is left was known, and how fast a second Ctrl+C stops."""
    with tempfile.TemporaryDirectory() as folder:
        runs = Path(folder) / "runs"
        with serve_rehearsal(Path(folder) / "rig", "--seed", "7") as bench:
            tenth = max(2, round(insertions / 10) + 1)
            chooses = {str(tenth): ["r", "u", "s"], str(tenth + 1): ["r"]}
            shown = _run(
                bench, runs, insertions, PacedPerson(bench, chooses), Presses(bench, ["withdrawing"])
            )
            presses = Presses(bench, ["withdrawing", "pausing after"], watches=True)
            _run(bench, runs, 1, PacedPerson(bench, {}), presses, name="stopped")
        rows = [*_describe(open_run(runs / "r")), *_compare_left(shown, open_run(runs / "r"), tenth)]
        rows.append(
            [
                "second Ctrl+C to standstill while withdrawing at 5 mm/s, ms",
                f"{1000 * presses.standstill_s:.0f}",
            ]
        )
    print_rows(("a gel by the keys of a person", ""), rows)


def _run(
    bench: ServingRig, runs: Path, insertions: int, person: PacedPerson, presses: Presses, name: str = "r"
) -> str:
    settings = [
        word for setting in (_GEL, f"insertions_per_specimen={insertions}") for word in ("--set", setting)
    ]
    done = bench.run(
        "run", ROOT / "protocols" / "steerability.yaml", "--rig", bench.rig, "--runs-dir", runs, "--run-name", name,
        *settings, answer=person, press=presses, patience_s=_SLOWEST_S * insertions,
    )  # fmt: skip
    return done.shown


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
