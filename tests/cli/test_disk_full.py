"""A disk that fills up during `labrig run`."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from labrig.record.check import check_run
from labrig.record.reader import open_run
from tests.cli.conftest import RIG, ROOT, SHORT_SWEEP, SWEEP
from tests.record.runs import killed_run

pytestmark = pytest.mark.slow

UNSHARE = ["unshare", "--map-root-user", "--mount", "sh", "-c"]


def _mounting(disk: Path, size: str) -> str:
    """Return the command that makes a small disk, for a namespace of its own; skip where that is not allowed."""
    disk.mkdir()
    mount = f"mount -t tmpfs -o size={size} none '{disk}'"
    if shutil.which("unshare") is None or subprocess.run([*UNSHARE, mount], check=False).returncode:
        pytest.skip("this account may not mount a small disk of its own")
    return mount


def _run_on_small_disk(tmp_path: Path, size: str, *settings: str) -> tuple[dict[str, object], Path]:
    """Run the short sweep on a disk of its own; return what was printed and a copy of the record."""
    disk, copy = tmp_path / "disk", tmp_path / "copy"
    mount = _mounting(disk, size)
    sets = [word for setting in settings for word in ("--set", setting)]
    labrig: list[object] = [sys.executable, "-m", "labrig", "run", SWEEP, "--rig", RIG, "--runs-dir", disk]
    labrig += ["--run-name", "run", "--json", *SHORT_SWEEP, *sets]
    script = f"{mount} && \"$@\"; status=$?; cp -r '{disk}/run' '{copy}' && exit $status"
    command = [*UNSHARE, script, "sh", *map(str, labrig)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
    return json.loads(done.stdout), copy


@pytest.mark.parametrize(
    ("size", "settings", "reason"),
    [
        ("15m", ("rig.recording.least_free_mb=0",), r"cannot write .*No space left on device"),
        ("20m", ("rig.recording.least_free_mb=5",), r"has \d+\.\d MB free; a run ends below 5\.0 MB"),
    ],
)
def test_the_axes_stop_and_the_record_says_why(
    tmp_path: Path, size: str, settings: tuple[str, ...], reason: str
) -> None:
    """On a full disk: exit code 3, and a readable run closed as failed with the reason."""
    # Pictures so noisy take more than the estimate that is made beforehand, so that the run begins.
    document, run = _run_on_small_disk(
        tmp_path,
        size,
        *settings,
        "rig.world.noise_sd=25",
        "insertions_per_specimen=1",
        "insertion.frame_every_mm=5",
    )
    assert document["exit_status"] == "failed"
    opened, verdict = open_run(run), check_run(run)
    assert re.search(reason, str(opened.manifest["reason"]))
    assert (opened.manifest["exit_status"], opened.damage, verdict.damage) == ("failed", (), ())
    assert list(opened.events["kind"])[-1] == "run_stop"
    assert len(list(opened.pictures)) == len(opened.frame_table) > 5
    halted = [line for line in (run / "can.log").read_text().splitlines()[-60:] if "4060" in line[-19:]]
    assert halted, "every axis was told to stop"


def test_a_quota_on_files_ends_the_run_intact(tmp_path: Path) -> None:
    """It fails with the reason when can.log meets the limit, and every acknowledged picture is readable."""
    command: list[object] = [
        sys.executable,
        "-m",
        "labrig",
        "run",
        SWEEP,
        "--rig",
        RIG,
        "--runs-dir",
        tmp_path,
    ]
    command += ["--run-name", "run", "--json", *SHORT_SWEEP, "--set", "insertions_per_specimen=18"]
    script = ["bash", "-c", 'ulimit -f 1100; exec "$@"', "bash"]
    done = subprocess.run(
        [*script, *map(str, command)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, "Traceback" in done.stderr) == (3, False)
    assert json.loads(done.stdout)["exit_status"] == "failed"
    run = open_run(tmp_path / "run")
    assert "File too large" in str(run.manifest["reason"])
    assert (run.damage, check_run(tmp_path / "run").damage) == ((), ())
    assert len(list(run.pictures)) == len(run.frame_table)


def test_commands_on_a_full_disk_say_so_and_change_nothing(tmp_path: Path) -> None:
    """Each gives exit code 3 with the file, or an answer; no run is touched."""
    shutil.copytree(ROOT / "tests" / "records" / "steerability", tmp_path / "runs" / "closed")
    killed_run(tmp_path / "runs", "open")
    disk = tmp_path / "disk"
    mount = _mounting(disk, "4m")
    script = f"{mount} && cp -r '{tmp_path}/runs/.' '{disk}' && exec \"$@\""
    command = [*UNSHARE, script, "sh", sys.executable, "-m", "tests.cli.on_full_disk", str(disk)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    document = json.loads(done.stdout)
    listing, *others = document["answers"]
    assert listing["exit_code"] == 0
    for other in others:
        assert (other["exit_code"], other["words"]) == (3, other["words"])
        assert re.search(r"cannot write .*No space left on device", other["err"])
    assert "Traceback" not in done.stderr
    assert document["unchanged"]
