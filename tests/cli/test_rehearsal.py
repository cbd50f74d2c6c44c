"""A rehearsal of the bench: a simulated rig with a real clock, a person at a terminal, pauses and choices."""

import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest

from labrig.cli.attendant import TerminalAttendant
from labrig.cli.signals import SignalNote
from labrig.record.events import TrialStart, TrialStop
from labrig.record.reader import open_run
from tests.cli.conftest import RIG, ROOT, SWEEP, Labrig
from tests.record.runs import ENDED, begin
from tests.small_camera import CALIBRATED_SMALL_CAMERA

PATIENCE_S = 240.0
REHEARSED = {
    "rig.clock": "real",
    "rig.can.heartbeat.timeout_ms": 10000,
    "rig.axes.insertion.max_speed": 40,
    "rig.axes.insertion.acceleration": 200,
    "rig.axes.linear.max_speed": 40,
    "rig.axes.linear.acceleration": 200,
    "sheath.speed_mm_s": 30,
    **{f"rig.{key}": value for key, value in (line.split("=", 1) for line in CALIBRATED_SMALL_CAMERA)},
}
"""A small camera with the calibration of the kept records, and quick axes. The drives wait longer than by
default for a labrig on a machine that is busy with something else."""

_QUESTION = re.compile(r">> (.*?)\n +[^\n]*or no to stop:", re.DOTALL)
_ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


@dataclass(frozen=True)
class Ended:
    """A command that has ended: its exit code, and what its terminal showed."""

    exit_code: int
    shown: str


def agree(question: str) -> str:
    """Return what somebody types who agrees to everything, and reads what a simulated scale shows."""
    shown = re.search(r"It is simulated and shows (-?[\d.]+)\.( |$)", question)
    return "yes" if shown is None else shown[1]


def run_at_terminal(
    *arguments: object, answer: Callable[[str], str] = agree, press: Callable[[str], str] = lambda _shown: ""
) -> Ended:
    """Run a labrig in a terminal of its own.

    `answer` returns what is typed at a question; `press` what keys are pressed when the terminal has shown this much.
    """
    keyboard, screen = os.openpty()
    with subprocess.Popen(
        [sys.executable, "-m", "labrig", *map(str, arguments)],
        cwd=ROOT, stdin=screen, stdout=screen, stderr=screen, env={**os.environ, "COLUMNS": "300"},
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 - its Ctrl+C is a signal
    ) as running:  # fmt: skip
        os.close(screen)
        watchdog = threading.Timer(PATIENCE_S, running.kill)
        watchdog.start()
        try:
            shown = _converse(keyboard, answer, press)
        finally:
            watchdog.cancel()
            os.close(keyboard)
        return Ended(running.wait(PATIENCE_S), shown)


def _converse(keyboard: int, answer: Callable[[str], str], press: Callable[[str], str]) -> str:
    """Answer each question of a terminal until it closes; return everything that it showed."""
    shown, answered = "", 0
    while True:
        try:
            shown += os.read(keyboard, 65536).decode("utf-8", "replace")
        except OSError:  # the last program at the terminal has ended
            return _ESCAPES.sub("", shown)
        plain = _ESCAPES.sub("", shown)
        os.write(keyboard, press(plain).encode())
        questions = _QUESTION.findall(plain)
        for question in questions[answered:]:
            os.write(keyboard, f"{answer(' '.join(question.split()))}\n".encode())
        answered = len(questions)


FAST = {
    "target.position_mm": "[0, 2, 20]", "obstacles": "[]", "roll_zero.rolls": 5, "out_of_plane.lag_sd_deg": 1,
    "insertion.max_length_mm": 30, "policy.near_mm": 0, "policy.final_mm": 0,
    "insertion.speed_mm_s": 10, "insertion.withdraw_speed_mm_s": 30, "insertion.frame_every_mm": 4,
    "roll_zero.length_mm": 10, "rig.axes.rotation.max_speed": 12.5, "rig.axes.rotation.acceleration": 80,
}  # fmt: skip
"""What the chapter on commissioning sets for a first insertion, and less time for what the tests do not look at."""


@pytest.fixture(name="rig")
def _rig(tmp_path: Path) -> Path:
    """Return the rig file that the chapter makes."""
    rig = Path(shutil.copytree(RIG.parent, tmp_path / "rigs")) / "rig-rehearsal.yaml"
    before, line, after = RIG.read_text(encoding="utf-8").partition("kind: simulated\n")
    rig.write_text(f"{before}{line}clock: real\n{after}", encoding="utf-8")
    return rig


@pytest.mark.slow
def test_a_steered_insertion_is_rehearsed_to_its_report(labrig: Labrig, rig: Path, tmp_path: Path) -> None:
    """Every question is asked, and the needle reaches the target by the pictures, in real time."""
    settings = [word for key, value in (REHEARSED | FAST).items() for word in ("--set", f"{key}={value}")]
    protocol, asked = (ROOT / "protocols" / "insertion.yaml", "--rig", rig), list[str]()

    def answer(question: str) -> str:
        asked.append(question.split(maxsplit=1)[0])
        return agree(question)

    started_s = time.monotonic()
    done = run_at_terminal(
        "run", *protocol, *settings, "--runs-dir", tmp_path, "--run-name", "r", answer=answer
    )
    took_s = time.monotonic() - started_s
    assert done.exit_code == 0, done.shown
    assert asked == ["Mount", "Confirm", "Place", *5 * ["Shift"], "Place", "Look"]
    run = tmp_path / "r"
    assert labrig("runs", "check", run).exit_code == 0
    frames = [json.loads(line) for line in (run / "frames.jsonl").read_text().splitlines()]
    assert all(early["t_s"] < late["t_s"] for early, late in pairwise(frames))
    assert {frame["role"] for frame in frames if "t_bound_s" not in frame} == {"plan"}  # which is drawn
    assert 5.0 < frames[-1]["t_s"] - frames[0]["t_s"] < took_s
    assert json.loads((run / "analysis" / "001" / "result.json").read_text())["reached"] is True


def test_nobody_answers_for_a_person_who_is_not_there(labrig: Labrig, rig: Path, tmp_path: Path) -> None:
    """Without a terminal a rehearsal ends at its first question, as on a bench, and --yes changes nothing."""
    protocol = ROOT / "protocols" / "steerability.yaml"
    patient = ("--set", "rig.can.heartbeat.timeout_ms=10000", "--set", "insertions_per_specimen=1")
    done = labrig("run", protocol, "--rig", rig, "--runs-dir", tmp_path / "runs", "--yes", *patient)
    assert done.exit_code == 3
    assert "--yes answers only for a simulated rig without clock: real" in done.err
    assert "nobody is there to answer: Mount needle" in done.err


HOLES = {
    "specimens": "[{name: gel 13 %, gelatin_percent: 13}]", "insertions_per_specimen": 3, "insertion.length_mm": 5,
    "insertion.speed_mm_s": 5, "insertion.withdraw_speed_mm_s": 5, "analysis.window_start_mm": 0.5,
    "analysis.window_end_mm": 0.5, "analysis.min_window_mm": 2,
}  # fmt: skip
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
    left = ["\x03"]
    return lambda shown: left.pop() if left and "withdrawing" in shown else ""


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
        "Trial 2 was skipped.", "Trial 1 was to be made again", "Taken back: the repetition.", "by Ctrl+C.",
    )  # fmt: skip
    assert [words for words in (*told, "bubbles at the wall") if words not in page] == []


@pytest.mark.slow
def test_ctrl_c_stops_at_once_where_a_program_reads(tmp_path: Path) -> None:
    """With --json the first Ctrl+C ends the run with 130."""
    done = run_at_terminal(*COMMAND, tmp_path, "--json", press=press_once())
    assert (done.exit_code, "Ctrl+C: pausing" in done.shown) == (130, False)


def test_a_run_is_paused_and_continued_by_commands_and_ctrl_c(
    labrig: Labrig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its terminal says once when the pause begins; a run that is not paused, or over, exits with 2."""
    recorder, note = begin(tmp_path), SignalNote()
    with TerminalAttendant().take_requests(note, recorder.path) as requests, note.pausing(enabled=True):
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
        for _ in range(2):  # the next Ctrl+C is a new request
            note.take(2, None)
            assert requests.find("trial_end") == "Ctrl+C"
            requests.announce("after this insertion")
            requests.announce("after this insertion")
            requests.begin()
            requests.end()
            assert requests.find("trial_end") is None
            assert capsys.readouterr().err.count("Ctrl+C: pausing after this insertion; Ctrl+C again") == 1
    recorder.close("success", "", ENDED)
    over = labrig("pause", recorder.path, "--json")
    assert (over.exit_code, over.json()["error"]["type"]) == (2, "InputError")
    assert labrig("pause", tmp_path).exit_code == 4
