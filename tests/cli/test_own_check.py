"""Every command that closes a run checks it, on a disk that changes what is written."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from labrig.record.check import check_run
from tests.cli.conftest import ROOT, Labrig
from tests.cli.example_runs import FIRST, of_protocol
from tests.record.faults import killed_run


def run_on_bad_disk(name: str, *command: object) -> tuple[str, str]:
    """Run a command that has to end with 5 on a disk that changes this file; return what it printed."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.cli.bad_disk", name, *map(str, command)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, "Traceback" in done.stderr) == (5, False), done.stderr
    return done.stdout, done.stderr


@pytest.mark.parametrize(
    ("protocol", "name"),
    [
        ("design", "manifest.json"),
        ("design", "chain.jsonl"),
        ("design", "SHA256SUMS"),
        ("design", "events.jsonl"),
        ("steerability", "frames/000001.png"),
        ("roll-zero", "can.log"),
        ("calibration", "frames.jsonl"),
        ("insertion", "truth.jsonl"),
    ],
)
def test_a_run_that_is_damaged_as_written_ends_as_a_bug(
    tmp_path: Path, protocol: str, name: str, labrig: Labrig
) -> None:
    """It ends with 5 and the file's name, is listed as failed, with another chain as damaged, and is kept as it is."""
    out, err = run_on_bad_disk(name, "run", *of_protocol(protocol), "--runs-dir", tmp_path, "--json")
    document = json.loads(out)
    assert (document["exit_status"], document["error"]["type"]) == ("failed", "BugError")
    assert name in document["error"]["message"]
    assert "labrig resume" not in err
    (row,) = labrig("runs", "--runs-dir", tmp_path, "--json").json()
    listed = "damaged" if name == "chain.jsonl" else "failed"
    assert (row["run"], row["exit_status"]) == (document["run"], listed)
    assert name in check_run(Path(document["run"])).damage[0].message


def test_imported_pictures_that_are_damaged_as_written_end_as_a_bug(tmp_path: Path) -> None:
    """The copies of an import are read back too."""
    calibration = FIRST / "calibration"
    _, err = run_on_bad_disk(
        "frames/000000.png", "import", FIRST / "frames", "--intrinsics", calibration / "intrinsics.json",
        "--plane", calibration / "plane.json", "--needle-diameter-mm", 1.2, "--runs-dir", tmp_path,
    )  # fmt: skip
    assert "frames/000000.png" in err


def test_a_repair_that_is_damaged_as_written_ends_as_a_bug(tmp_path: Path) -> None:
    """What an interrupted run holds is read again when it is closed."""
    run = killed_run(tmp_path)
    out, _ = run_on_bad_disk("states.jsonl", "runs", "check", run, "--repair", "--json")
    (row,) = json.loads(out)
    assert (row["ok"], "states.jsonl" in row["reason"]) == (False, True)
