"""A rehearsal of the bench: a simulated rig with a real clock, and a person who answers at a terminal."""

import json
import re
import shlex
import shutil
import time
from itertools import pairwise
from pathlib import Path

import pytest

from tests.cli.conftest import RIG, ROOT, Labrig
from tests.rehearsing import REHEARSED, agree, run_at_terminal

CHAPTER = ROOT / "labrig" / "manual" / "tutorials" / "commissioning.md"
FAST = {
    "target.position_mm": "[0, 2, 20]",
    "insertion.max_length_mm": 30,
    "policy.near_mm": 0,
    "policy.final_mm": 0,
    "sheath.speed_mm_s": 30,
    "insertion.speed_mm_s": 10,
    "insertion.withdraw_speed_mm_s": 30,
    "insertion.frame_every_mm": 4,
    "roll_zero.length_mm": 10,
    "rig.axes.insertion.max_speed": 40,
    "rig.axes.insertion.acceleration": 200,
    "rig.axes.rotation.max_speed": 12.5,
    "rig.axes.rotation.acceleration": 80,
    "rig.axes.linear.max_speed": 40,
    "rig.axes.linear.acceleration": 200,
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


@pytest.mark.slow
def test_an_axis_is_commissioned_as_the_chapter_says(rig: Path) -> None:
    """It moves at its speed, and is given its zero."""
    (jog,) = _read_commands("Move each axis")
    home = _read_commands("Home")[0]
    asked: list[str] = []

    def answer(question: str) -> str:
        asked.append(question)
        return agree(question)

    for command in (jog, home):
        done = run_at_terminal(*command[:-1], rig, answer=answer)
        assert (done.exit_code, "FAIL" in done.shown) == (0, False), done.shown
    assert [question.split()[0] for question in asked] == ["The", "Confirm"]


def test_a_steered_insertion_is_rehearsed_to_its_report(labrig: Labrig, rig: Path, tmp_path: Path) -> None:
    """Every question is asked, and the needle reaches the target by the pictures, in real time."""
    (command,) = _read_commands("The first insertion")
    settings = [word for key, value in (REHEARSED | FAST).items() for word in ("--set", f"{key}={value}")]
    asked: list[str] = []

    def answer(question: str) -> str:
        asked.append(question)
        return agree(question)

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
