"""A rehearsal of the bench: one labrig serves the rig, another one runs on it, and a person answers at a terminal."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from labrig.record.reader import open_run
from tests.cli.conftest import ROOT, SWEEP, Labrig
from tests.rehearsing import PATIENCE_S, ServingRig, copy_rig, serve_rehearsal

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX's")

ONE_SHORT_INSERTION = (
    "--set", "specimens=[{name: gel 13 %, gelatin_percent: 13}]", "--set", "insertions_per_specimen=1",
    "--set", "insertion={length_mm: 25, speed_mm_s: 5, withdraw_speed_mm_s: 20, frame_every_mm: 10}",
    "--set", "sheath.speed_mm_s=10",
)  # fmt: skip


def _obey(bench: ServingRig, question: str) -> str:
    """Do by hand what a question asks for, and return what is typed then."""
    for pattern, line in (
        (r"Mount needle (\S+) in", r"needle \1"),
        (r"Place specimen (.+) \(([\d.]+) % gelatin\)", r"specimen '\1' \2"),
        (r"Shift specimen .+ to hole (\d+), ([\d.]+) mm", r"hole \1 \2"),
    ):
        if found := re.match(pattern, question):
            done = bench.does(found.expand(line))
            assert done == f"done: {found.expand(line)}"
    return "yes"


def test_an_insertion_is_rehearsed_to_its_report(labrig: Labrig, tmp_path: Path) -> None:
    """Real processes, in real time: every question is asked, the camera sees the needle go in, and the record is sound.

    Ctrl+C then ends the simulation with 130, and the journal of the drives holds the insertion.
    """
    asked: list[str] = []

    def answer(question: str) -> str:
        asked.append(question)
        return _obey(bench, question)

    journal = tmp_path / "drives.jsonl"
    with serve_rehearsal(tmp_path / "rig", "--seed", "3", "--journal", str(journal)) as bench:
        done = bench.run(
            "run", SWEEP, "--rig", bench.rig, "--runs-dir", tmp_path / "runs", *ONE_SHORT_INSERTION,
            answer=answer,
        )  # fmt: skip
        assert done.exit_code == 0, done.shown
        bench.process.send_signal(signal.SIGINT)
        assert bench.process.wait(PATIENCE_S) == 130
        assert bench.process.stderr is not None
        assert bench.process.stderr.read() == ""
    assert [question.split()[0] for question in asked] == ["Confirm", "Mount", "Confirm", "Place", "Shift"]
    (run,) = (path for path in (tmp_path / "runs").iterdir() if (path / "manifest.json").is_file())
    assert labrig("runs", "check", run).exit_code == 0
    assert open_run(run).manifest["exit_status"] == "success"
    result = json.loads((run / "analysis" / "001" / "result.json").read_text())
    assert result["mean_radius_mm"] == pytest.approx(27.71, abs=1.5)
    shafts = [json.loads(line)["shaft_quadcounts"] for line in journal.read_text().splitlines()]
    assert max(shafts) == pytest.approx(25 * 4000, abs=40)


def test_a_needle_that_a_fault_leaves_in_tissue_is_withdrawn(tmp_path: Path) -> None:
    """The drive of the insertion reports a following error on the way: the run fails, and a withdrawal undoes it."""
    faults = tmp_path / "faults.yaml"
    faults.write_text(
        "faults:\n  - {fault: emergency, axis: insertion, once: moving, code: 0x8611}\n", encoding="utf-8"
    )
    with serve_rehearsal(tmp_path / "rig", "--faults", str(faults)) as bench:
        failed = bench.run(
            "run", SWEEP, "--rig", bench.rig, "--runs-dir", tmp_path / "runs", *ONE_SHORT_INSERTION,
            answer=lambda question: _obey(bench, question),
        )  # fmt: skip
        assert failed.exit_code == 3
        assert "error 0x8611" in failed.shown
        assert "labrig devices withdraw" in failed.shown
        out = bench.run(
            "devices", "withdraw", "--rig", bench.rig, "--runs-dir", tmp_path / "runs", answer=lambda _: "yes"
        )
        assert out.exit_code == 0, out.shown
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
    files = {"RIG": rig, "FAULTS": faults}
    done = labrig("devices", "simulate", *(files.get(argument, argument) for argument in arguments))
    assert done.exit_code == 2
    assert words in done.err
