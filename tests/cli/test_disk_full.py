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
from tests.cli.conftest import RIG, ROOT, SHORT_SWEEP, SMALL_SWEEP, SWEEP
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
    noisy = ("rig.world.noise_sd=25", "insertions_per_specimen=1", "insertion.frame_every_mm=5")
    document, run = _run_on_small_disk(tmp_path, size, *settings, *noisy)
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
    words = ["run", SWEEP, "--runs-dir", tmp_path, "--run-name", "run", "--json", *SMALL_SWEEP]
    command = [sys.executable, "-m", "labrig", *map(str, words), "--set", "insertions_per_specimen=18"]
    script = ["bash", "-c", 'ulimit -f 1100; exec "$@"', "bash"]
    done = subprocess.run([*script, *command], cwd=ROOT, capture_output=True, text=True, check=False)
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
    labrig = f'"{sys.executable}" -m labrig'
    lines = (
        f"runs annotate {disk}/open --tag pilot", f"runs annotate {disk}/closed --note cloudy",
        f"reanalyze {disk}/closed", f"report {disk}/closed",
        f"export {disk}/closed --format csv --out {disk}/tables",
    )  # fmt: skip
    script = "; ".join(
        [
            f"{mount} && cp -r '{tmp_path}/runs/.' '{disk}'", f"cat /dev/zero > {disk}/filling 2>/dev/null",
            f"{labrig} runs --runs-dir {disk} --where exit_status=success >&2; echo $?",
            *(f"{labrig} {line}; echo $?" for line in lines),
            f"cd {disk}; for run in open closed; do diff -r -x '.*' $run {tmp_path}/runs/$run; done",
        ]
    )  # fmt: skip
    done = subprocess.run([*UNSHARE, script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["0", *["3"] * len(lines)], done
    assert len(re.findall(r"cannot write .*No space left on device", done.stderr)) == len(lines)
    assert "Traceback" not in done.stderr
