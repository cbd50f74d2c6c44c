"""A gel in a rehearsal, with a person who pauses, skips, has repeated and takes back; by their keys."""

import json
from pathlib import Path

from labrig.record.events import TrialStart, TrialStop
from labrig.record.reader import open_run
from tests.cli.conftest import RIG, SWEEP, Labrig
from tests.rehearsing import REHEARSED, agree, run_at_terminal

HOLES = {
    "specimens": "[{name: gel 13 %, gelatin_percent: 13}]",
    "insertions_per_specimen": 3,
    "insertion.length_mm": 5,
    "insertion.speed_mm_s": 5,
    "insertion.withdraw_speed_mm_s": 5,
    "sheath.speed_mm_s": 30,
    "analysis.window_start_mm": 0.5,
    "analysis.window_end_mm": 0.5,
    "analysis.min_window_mm": 2,
    "rig.axes.insertion.max_speed": 40,
    "rig.axes.insertion.acceleration": 200,
    "rig.axes.linear.max_speed": 40,
    "rig.axes.linear.acceleration": 200,
}
SETTINGS = [word for key, value in (REHEARSED | HOLES).items() for word in ("--set", f"{key}={value}")]
KEYS = {
    "Shift specimen gel 13 % to hole 2": ["r", "u", "t bubbles at the wall", "s"],
    "Shift specimen gel 13 % to hole 3": ["r"],
    "Paused": ["c"],
}
"""What is chosen at a question before it is answered, in order."""


def test_a_gel_is_made_with_a_pause_a_skip_a_repetition_and_an_undo(labrig: Labrig, tmp_path: Path) -> None:
    """The first Ctrl+C pauses after the insertion; the record is sound; the report tells all four."""
    left = {question: list(keys) for question, keys in KEYS.items()}
    asked: list[str] = []
    pressed: list[str] = []

    def answer(question: str) -> str:
        asked.append(question)
        keys = next((keys for start, keys in left.items() if question.startswith(start)), [])
        return keys.pop(0) if keys else agree(question)

    def press(shown: str) -> str:
        if pressed or "withdrawing" not in shown:
            return ""
        pressed.append("Ctrl+C")
        return "\x03"

    done = run_at_terminal(
        "run", SWEEP, "--rig", RIG, "--runs-dir", tmp_path, "--run-name", "r", *SETTINGS,
        answer=answer, press=press,
    )  # fmt: skip
    assert done.exit_code in {0, 1}, done.shown
    assert "Ctrl+C: pausing after this insertion; Ctrl+C again stops now" in done.shown
    assert "hole 3 of 3, gel 1 of 1" in done.shown
    assert left == {question: [] for question in KEYS}
    run = open_run(tmp_path / "r")
    kinds = [line["kind"] for line in run.lines("events")]
    assert [kinds.count(kind) for kind in ("pause", "skip", "repeat", "undo", "note")] == [1, 1, 2, 1, 1]
    assert [trial.left_out for trial in run.read_trials(TrialStart, TrialStop)] == ["repeated", "", ""]
    assert labrig("runs", "check", tmp_path / "r").exit_code == 0
    result = json.loads((tmp_path / "r" / "analysis" / "001" / "result.json").read_text())
    assert result["left_out"] == {"skipped": 1, "marked_bad": 0, "repeated": 1}
    assert [group["trials"] for group in result["specimens"]] == [2]
    page = (tmp_path / "r" / "report.html").read_text(encoding="utf-8")
    for words in (
        "by Ctrl+C.",
        "Trial 2 was skipped.",
        "Trial 1 was to be made again",
        "Taken back: the repetition.",
        "bubbles at the wall",
    ):
        assert words in page


def test_ctrl_c_stops_at_once_where_a_program_reads(tmp_path: Path) -> None:
    """With --json the first Ctrl+C ends the run with 130."""
    pressed: list[str] = []

    def press(shown: str) -> str:
        if pressed or "withdrawing" not in shown:
            return ""
        pressed.append("Ctrl+C")
        return "\x03"

    done = run_at_terminal(
        "run", SWEEP, "--rig", RIG, "--runs-dir", tmp_path, "--run-name", "r", *SETTINGS, "--json",
        press=press,
    )  # fmt: skip
    assert (done.exit_code, "Ctrl+C: pausing" in done.shown) == (130, False)
