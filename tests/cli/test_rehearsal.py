"""A rehearsal of the bench: a simulated rig with a real clock, a person at a terminal, pauses and choices."""

import json
import re
import shlex
import shutil
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from labrig.cli.attendant import TerminalAttendant
from labrig.cli.signals import SignalNote
from labrig.record.events import TrialStart, TrialStop
from labrig.record.reader import open_run
from tests.cli.conftest import RIG, ROOT, SWEEP, Labrig
from tests.record.runs import ENDED, begin
from tests.rehearsing import REHEARSED, agree, run_at_terminal

CHAPTER = ROOT / "labrig" / "manual" / "tutorials" / "commissioning.md"
FAST = {
    "target.position_mm": "[0, 2, 20]",
    "insertion.max_length_mm": 30,
    "policy.near_mm": 0,
    "policy.final_mm": 0,
    "insertion.speed_mm_s": 10,
    "insertion.withdraw_speed_mm_s": 30,
    "insertion.frame_every_mm": 4,
    "roll_zero.length_mm": 10,
    "rig.axes.rotation.max_speed": 12.5,
    "rig.axes.rotation.acceleration": 80,
}
"""Less time for what the tests do not look at."""


def _read_commands(section: str) -> list[list[str]]:
    """Return the arguments of each labrig of a section of the chapter."""
    text = CHAPTER.read_text(encoding="utf-8").split(f"\n## {section}\n")[1].split("\n## ")[0]
    blocks = "".join(re.findall(r"```sh(?: bench)?\n(.*?)```", text, re.DOTALL))
    lines = [line for line in blocks.splitlines() if line.startswith("labrig ")]
    return [shlex.split(line.removeprefix("labrig ")) for line in lines]


@pytest.fixture(name="rig")
def _rig(tmp_path: Path) -> Path:
    """Return the rig file that the chapter makes."""
    rig, line = tmp_path / "rig-rehearsal.yaml", "kind: simulated\n"
    text = RIG.read_text(encoding="utf-8")
    assert line in text
    shutil.copytree(RIG.parent, tmp_path, dirs_exist_ok=True)
    rig.write_text(text.replace(line, f"{line}clock: real\n"), encoding="utf-8")
    return rig


def listen() -> tuple[list[str], Callable[[str], str]]:
    """Return the questions that a person will have been asked, and the person, who agrees to everything."""
    asked: list[str] = []

    def answer(question: str) -> str:
        asked.append(question)
        return agree(question)

    return asked, answer


@pytest.mark.slow
def test_an_axis_is_commissioned_as_the_chapter_says(rig: Path) -> None:
    """It moves at its speed, and is given its zero."""
    (jog,) = _read_commands("Move each axis")
    home = _read_commands("Home")[0]
    asked, answer = listen()
    for command in (jog, home):
        done = run_at_terminal(*command[:-1], rig, answer=answer)
        assert (done.exit_code, "FAIL" in done.shown) == (0, False), done.shown
    assert [question.split()[0] for question in asked] == ["The", "Confirm"]


@pytest.mark.slow
def test_a_steered_insertion_is_rehearsed_to_its_report(labrig: Labrig, rig: Path, tmp_path: Path) -> None:
    """Every question is asked, and the needle reaches the target by the pictures, in real time."""
    (command,) = _read_commands("The first insertion")
    settings = [word for key, value in (REHEARSED | FAST).items() for word in ("--set", f"{key}={value}")]
    asked, answer = listen()
    started_s = time.monotonic()
    at_rig = [str(rig) if word == "calibration/rig-rehearsal.yaml" else word for word in command]
    done = run_at_terminal(*at_rig, *settings, "--runs-dir", tmp_path, "--run-name", "r", answer=answer)
    took_s = time.monotonic() - started_s
    assert done.exit_code == 0, done.shown
    first_words = [question.split()[0] for question in asked]
    assert first_words == ["Mount", "Confirm", "Place", *4 * ["Shift"], "Place", "Look"]
    run = tmp_path / "r"
    assert labrig("runs", "check", run).exit_code == 0
    frames = [json.loads(line) for line in (run / "frames.jsonl").read_text().splitlines()]
    assert all(early["t_s"] < late["t_s"] for early, late in pairwise(frames))
    assert {frame["role"] for frame in frames if "t_bound_s" not in frame} == {"plan"}  # which is drawn
    assert 5.0 < frames[-1]["t_s"] - frames[0]["t_s"] < took_s
    result = json.loads((run / "analysis" / "001" / "result.json").read_text())
    assert result["reached"] is True


def test_nobody_answers_for_a_person_who_is_not_there(labrig: Labrig, rig: Path, tmp_path: Path) -> None:
    """Without a terminal a rehearsal ends at its first question, as on a bench, and --yes changes nothing."""
    protocol = ROOT / "protocols" / "steerability.yaml"
    patient = ("--set", "rig.can.heartbeat.timeout_ms=10000")
    done = labrig("run", protocol, "--rig", rig, "--runs-dir", tmp_path / "runs", "--yes", *patient)
    assert done.exit_code == 3
    assert "--yes answers only for a simulated rig without clock: real" in done.err
    assert "nobody is there to answer: Mount needle" in done.err


HOLES = {
    "specimens": "[{name: gel 13 %, gelatin_percent: 13}]",
    "insertions_per_specimen": 3,
    "insertion.length_mm": 5,
    "insertion.speed_mm_s": 5,
    "insertion.withdraw_speed_mm_s": 5,
    "analysis.window_start_mm": 0.5,
    "analysis.window_end_mm": 0.5,
    "analysis.min_window_mm": 2,
}
SETTINGS = [word for key, value in (REHEARSED | HOLES).items() for word in ("--set", f"{key}={value}")]
COMMAND = ("run", SWEEP, "--rig", RIG, *SETTINGS, "--run-name", "r", "--runs-dir")
KEYS = {
    "Shift specimen gel 13 % to hole 2": ["r", "u", "t bubbles at the wall", "s"],
    "Shift specimen gel 13 % to hole 3": ["r"],
    "Paused": ["c"],
}
"""What is chosen at a question before it is answered, in order."""


def press_once() -> Callable[[str], str]:
    """Return what presses Ctrl+C once, while the needle is withdrawn."""
    pressed: list[str] = []

    def press(shown: str) -> str:
        if pressed or "withdrawing" not in shown:
            return ""
        pressed.append("Ctrl+C")
        return "\x03"

    return press


def test_a_gel_is_made_with_a_pause_a_skip_a_repetition_and_an_undo(labrig: Labrig, tmp_path: Path) -> None:
    """The first Ctrl+C pauses after the insertion; the record is sound; the report tells all four."""
    left = {question: list(keys) for question, keys in KEYS.items()}

    def answer(question: str) -> str:
        keys = next((keys for start, keys in left.items() if question.startswith(start)), [])
        return keys.pop(0) if keys else agree(question)

    done = run_at_terminal(*COMMAND, tmp_path, answer=answer, press=press_once())
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
    told = (
        "by Ctrl+C.",
        "Trial 2 was skipped.",
        "Trial 1 was to be made again",
        "Taken back: the repetition.",
    )
    assert [words for words in (*told, "bubbles at the wall") if words not in page] == []


@pytest.mark.slow
def test_ctrl_c_stops_at_once_where_a_program_reads(tmp_path: Path) -> None:
    """With --json the first Ctrl+C ends the run with 130."""
    done = run_at_terminal(*COMMAND, tmp_path, "--json", press=press_once())
    assert (done.exit_code, "Ctrl+C: pausing" in done.shown) == (130, False)


def test_a_run_is_paused_and_continued_by_commands(
    labrig: Labrig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its terminal says when the pause begins; a run that is not paused, or over, exits with 2."""
    recorder, note = begin(tmp_path), SignalNote()
    with TerminalAttendant().take_requests(note, recorder.path) as requests:
        done = labrig("pause", recorder.path, "--json")
        assert (done.exit_code, "next safe point" in done.json()["answer"]) == (0, True)
        assert requests.find("trial_end") == "labrig pause"
        requests.announce("after this insertion")
        assert "labrig pause: pausing after this insertion" in capsys.readouterr().err
        requests.begin()
        done = labrig("continue", recorder.path)
        assert (done.exit_code, done.out) == (0, "the run continues\n")
        assert requests.find_continuation() == "labrig continue"
        requests.end()
        assert requests.find("question") is None
        refused = labrig("continue", recorder.path)
        assert (refused.exit_code, "the run is not paused" in refused.err) == (2, True)
    recorder.close("success", "", ENDED)
    over = labrig("pause", recorder.path, "--json")
    assert (over.exit_code, over.json()["error"]["type"]) == (2, "InputError")
    assert labrig("pause", tmp_path).exit_code == 4


def test_ctrl_c_is_announced_once_and_met_by_a_pause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The request stands until the pause begins; the next Ctrl+C is a new one."""
    recorder, note = begin(tmp_path), SignalNote()
    with (
        TerminalAttendant().take_requests(note, recorder.path) as requests,
        note.pausing(enabled=True),  # as at a terminal
    ):
        for _ in range(2):
            note.take(2, None)
            assert requests.find("trial_end") == "Ctrl+C"
            requests.announce("after this insertion")
            requests.announce("after this insertion")
            requests.begin()
            requests.end()
            assert requests.find("trial_end") is None
            assert capsys.readouterr().err.count("Ctrl+C: pausing after this insertion; Ctrl+C again") == 1
    recorder.close("success", "", ENDED)
