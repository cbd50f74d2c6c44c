"""A disk that fills up in the middle of `labrig run`."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from labrig.record import check_run, open_run
from tests.cli.conftest import RIG, ROOT, SHORT_SWEEP, SWEEP

UNSHARE = ["unshare", "--map-root-user", "--mount", "sh", "-c"]


def _run_on_small_disk(tmp_path: Path, size: str, *settings: str) -> tuple[dict[str, object], Path]:
    """Run the short sweep on a disk of its own; return what was printed and a copy of the record."""
    disk, copy = tmp_path / "disk", tmp_path / "copy"
    disk.mkdir()
    mount = f"mount -t tmpfs -o size={size} none '{disk}'"
    if shutil.which("unshare") is None or subprocess.run([*UNSHARE, mount], check=False).returncode:
        pytest.skip("this account may not mount a small disk of its own")
    sets = [word for setting in settings for word in ("--set", setting)]
    command = [sys.executable, "-m", "labrig", "run", SWEEP, "--rig", RIG, "--runs-dir", disk]
    command += ["--run-name", "run", "--json", *SHORT_SWEEP, *sets]
    script = f"{mount} && \"$@\"; status=$?; cp -r '{disk}/run' '{copy}' && exit $status"
    command = [*UNSHARE, script, "sh", *map(str, command)]
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
    """Full, or nearly full: exit code 3, the run closed as failed with the reason, and all of it readable."""
    # Pictures so noisy take more than the estimate that is made beforehand, so that the run begins.
    document, run = _run_on_small_disk(
        tmp_path, size, *settings, "rig.world.noise_sd=25", "insertions_per_specimen=1"
    )
    assert document["exit_status"] == "failed"
    opened, verdict = open_run(run), check_run(run)
    assert re.search(reason, str(opened.manifest["reason"]))
    assert (opened.manifest["exit_status"], opened.problems, verdict.damage) == ("failed", (), ())
    assert list(opened.events["kind"])[-1] == "run_stop"
    assert len(list(opened.frames)) == len(opened.frame_table) > 5
    halted = [frame for frame in list(opened.can_frames)[-60:] if frame.data[1:3] == b"\x40\x60"]
    assert halted, "every axis was told to stop"
