"""A rehearsal of the bench: one labrig serves the rig, another one runs on it, and a person answers at a terminal."""

import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import ROOT, Labrig
from tests.rehearsing import PATIENCE_S, Ended, ServingRig, copy_rig, serve_rehearsal

CHAPTER = ROOT / "labrig" / "manual" / "tutorials" / "commissioning.md"
RIG = "calibration/rig-rehearsal.yaml"
FAST = {
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
"""For insertions: less time for what the tests do not look at."""


def _read_blocks(section: str, language: str) -> list[str]:
    """Return the code blocks of a section of the chapter."""
    text = CHAPTER.read_text(encoding="utf-8").split(f"\n## {section}\n")[1].split("\n## ")[0]
    return re.findall(rf"```{language}(?: bench)?\n(.*?)```", text, re.DOTALL)


def _read_commands(section: str) -> list[list[str]]:
    """Return the arguments of each labrig of a section; those of the simulation without its rig file."""
    lines = "".join(_read_blocks(section, "sh")).splitlines()
    return [shlex.split(line.removeprefix("labrig ")) for line in lines]


def _run(bench: ServingRig, runs: Path, command: list[str], asked: list[str]) -> Ended:
    """Run a command of the chapter on the rig that is served."""

    def answer(question: str) -> str:
        asked.append(question)
        return bench.obeys(question)

    at_rig = [str(bench.rig) if argument == RIG else argument for argument in command]
    if {"run", "withdraw"} & set(command):
        at_rig += ["--runs-dir", str(runs)]
    if "protocols/insertion.yaml" in command:
        at_rig += [word for key, value in FAST.items() for word in ("--set", f"{key}={value}")]
    return bench.run(*at_rig, answer=answer)


def test_every_command_of_the_chapter_is_run_here() -> None:
    """No section has commands beside those that the tests below run."""
    sections = re.findall(r"^## (.*)$", CHAPTER.read_text(encoding="utf-8"), re.MULTILINE)
    with_commands = [section for section in sections if _read_blocks(section, "sh")]
    assert with_commands == [
        *COMMISSIONING,
        "Calibrate the camera",
        "The first insertion",
        "When something fails",
    ]
    (simulation,) = _read_commands("The rehearsal")
    assert simulation == ["devices", "simulate", "--rig", RIG]


COMMISSIONING = ("The rehearsal", "Check", "Move each axis", "Home", "Set up the camera")


def test_a_bare_bench_is_commissioned_as_the_chapter_says(tmp_path: Path) -> None:
    """Each axis moves, is measured against a scale, finds its end stop, and reaches its limits; every check passes."""
    asked: list[str] = []
    with serve_rehearsal(tmp_path / "rig") as bench:
        for command in (command for section in COMMISSIONING[1:] for command in _read_commands(section)):
            done = _run(bench, tmp_path, command, asked)
            assert (done.exit_code, "FAIL" in done.shown) == (0, False), f"{command}: {done.shown}"
        assert bench.does("scale linear") == "done: scale linear: 0.000"
    assert sum("Type the reading of the axis linear" in question for question in asked) == 4
    assert any("search backwards for its stop" in question for question in asked)
    state = json.loads((tmp_path / "rig" / "rehearsal.state.json").read_text())
    assert sorted(state["referenced"]) == ["insertion", "linear", "rotation"]


def test_a_camera_is_calibrated_as_the_chapter_says(tmp_path: Path) -> None:
    """The boards and the paper that are held before the simulated camera give a calibration that is accepted."""
    asked: list[str] = []
    (command,) = _read_commands("Calibrate the camera")
    with serve_rehearsal(tmp_path / "rig") as bench:
        done = _run(bench, tmp_path / "runs", command, asked)
    assert (done.exit_code, "calibration accepted" in done.shown) == (0, True), done.shown
    assert sum(question.startswith("Hold the chessboard") for question in asked) == 16


def test_a_steered_insertion_is_rehearsed_to_its_report(labrig: Labrig, tmp_path: Path) -> None:
    """Every question is asked, the needle reaches the target by the pictures, and a replay is identical; in real time.

    Ctrl+C then ends the simulation with 130, and the journal of the drives holds the insertion.
    """
    asked: list[str] = []
    journal, (command,) = tmp_path / "drives.jsonl", _read_commands("The first insertion")
    with serve_rehearsal(tmp_path / "rig", "--seed", "3", "--journal", str(journal)) as bench:
        done = _run(bench, tmp_path / "runs", command, asked)
        assert done.exit_code == 0, done.shown
        bench.process.send_signal(signal.SIGINT)
        assert bench.process.wait(PATIENCE_S) == 130
        assert bench.process.stderr is not None
        assert bench.process.stderr.read() == ""
    first_words = [question.split()[0] for question in asked]
    assert first_words == ["Confirm", "Mount", "Confirm", "Place", *4 * ["Shift"], "Place", "Look"]
    (run,) = (path for path in (tmp_path / "runs").iterdir() if (path / "manifest.json").is_file())
    assert labrig("runs", "check", run).exit_code == 0
    manifest = json.loads((run / "manifest.json").read_text())
    assert manifest["exit_status"] == "success"
    camera = manifest["devices"]["camera"]
    assert (camera["driver"], camera["device"].partition(":")[0]) == ("mjpeg", "http")
    assert "recorded_pictures" not in camera
    result = json.loads((run / "analysis" / "001" / "result.json").read_text())
    assert result["reached"] is True
    assert result["target_error_mm"] < 2
    assert labrig("replay", run).exit_code == 0
    shafts = [json.loads(line)["shaft_quadcounts"] for line in journal.read_text().splitlines()]
    assert 20 * 4000 < max(shafts) < 40 * 4000


def test_a_needle_that_a_fault_leaves_in_tissue_is_withdrawn_as_the_chapter_says(tmp_path: Path) -> None:
    """The drive of the insertion reports a following error on the way: the run fails, and a withdrawal undoes it."""
    (file,) = _read_blocks("When something fails", "yaml")
    (tmp_path / "faults.yaml").write_text(file, encoding="utf-8")
    simulation, withdrawal = _read_commands("When something fails")
    assert simulation == ["devices", "simulate", "--rig", RIG, "--faults", "faults.yaml"]
    (insertion,) = _read_commands("The first insertion")
    with serve_rehearsal(tmp_path / "rig", "--faults", str(tmp_path / "faults.yaml")) as bench:
        failed = _run(bench, tmp_path / "runs", insertion, [])
        assert failed.exit_code == 3
        assert "error 0x8611" in failed.shown
        assert "labrig devices withdraw" in failed.shown
        done = _run(bench, tmp_path / "runs", withdrawal, [])
        assert done.exit_code == 0, done.shown
        assert bench.does("scale linear") == "done: scale linear: 0.000"
        assert bench.does("scale insertion") == "done: scale insertion: 0.000"
    state = json.loads((tmp_path / "rig" / "rehearsal.state.json").read_text())
    assert state["needle_in_tissue"] is False


def test_a_second_simulation_on_the_same_ports_is_told(tmp_path: Path) -> None:
    """It exits with 3, names the port and has no traceback; the first one goes on."""
    with serve_rehearsal(tmp_path) as bench:
        second = subprocess.run(
            [sys.executable, "-m", "labrig", "devices", "simulate", "--rig", str(bench.rig)],
            cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
        assert second.returncode == 3
        assert re.match(r"error: port \d+ of 127\.0\.0\.1 cannot be used for the CAN bus", second.stderr)
        assert bench.does("needle N1") == "done: needle N1"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "either --rig or --interface says what is served"),
        (("--rig", "RIG", "--interface", "slcan"), "either --rig or --interface says what is served"),
        (("--rig", "RIG", "--nodes", "1"), "--nodes belongs to --interface"),
        (("--interface", "slcan", "--seed", "1"), "--seed belongs to --rig"),
        (("--rig", "RIG", "--world", "RIG"), "has no section world"),
        (("--rig", "ALONE"), "no world: there is no "),
        (("--rig", "RIG", "--world", "none.yaml"), "none.yaml"),
        (("--rig", "RIG", "--faults", "FAULTS"), "faults.0.fault"),
        (
            ("--rig", "calibration/rig-bench.yaml"),
            "rig bench is not served: can is socketcan can0, camera is uvc",
        ),
    ],
)
def test_what_cannot_be_served_is_refused(
    labrig: Labrig, tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    """Wrong input exits with 2 before anything is served."""
    rig, faults = copy_rig(tmp_path), tmp_path / "faults.yaml"
    faults.write_text("faults:\n  - {fault: gremlin}\n", encoding="utf-8")
    (tmp_path / "alone").mkdir()
    files = {"RIG": rig, "FAULTS": faults, "ALONE": shutil.copy(rig, tmp_path / "alone")}
    done = labrig("devices", "simulate", *(files.get(argument, argument) for argument in arguments))
    assert done.exit_code == 2
    assert words in done.err
