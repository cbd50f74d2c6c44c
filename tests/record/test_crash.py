"""Real faults: a killed writer, a file that may not grow, a disk that is full."""

import random
import re
import shutil
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from labrig.record.reader import Run, open_run
from tests.record.runs import picture

ROOT = Path(__file__).parents[2]
WRITER = [sys.executable, "-m", "tests.record.endless_writer"]
UNSHARE = ["unshare", "--map-root-user", "--mount", "sh", "-c"]


def count_acknowledged(text: str) -> Counter[str]:
    """Count the calls that returned, by stream."""
    return Counter(line.split()[0] for line in text.splitlines())


def assert_all_there(run: Run, counts: Counter[str]) -> None:
    """Every acknowledged call is in the record, and at most one that was under way in each stream."""
    tables = {
        "states": run.states,
        "events": run.events[run.events["kind"] == "step"],
        "frames": run.frame_table,
    }
    for name, table in tables.items():
        assert counts[name] <= len(table) <= counts[name] + 1
        assert list(table["number"]) == list(range(len(table)))
    for number, frame in enumerate(run.frames):
        np.testing.assert_array_equal(frame, picture(number, (48, 64)))


@pytest.mark.parametrize("seed", range(4))
def test_a_killed_writer_loses_nothing_acknowledged(tmp_path: Path, seed: int) -> None:
    """SIGKILL after any number of calls leaves an incomplete run that holds every one of them."""
    wanted = random.Random(seed).randrange(3, 300)
    with subprocess.Popen([*WRITER, tmp_path], cwd=ROOT, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        text = "".join(writer.stdout.readline() for _ in range(wanted))
        writer.send_signal(signal.SIGKILL)
        text += writer.stdout.read()
    run = open_run(tmp_path / "run")
    assert run.manifest["exit_status"] == "incomplete"
    assert_all_there(run, count_acknowledged(text))


def test_a_file_that_may_not_grow_ends_the_run_whole(tmp_path: Path) -> None:
    """A write that the kernel takes half of is undone: the run closes as failed, and its lines are whole."""
    # Lines fill the limit before pictures of 3 kB reach it.
    command = [*WRITER, str(tmp_path), "--file-size", "5000"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    run = open_run(tmp_path / "run")
    assert run.problems == ()
    assert run.manifest["exit_status"] == "failed"
    assert "File too large" in str(run.manifest["reason"])
    assert_all_there(run, count_acknowledged(done.stdout))


def _can_mount(folder: Path) -> bool:
    if shutil.which("unshare") is None:
        return False
    mount = f"mount -t tmpfs -o size=64k none '{folder}'"
    probe = subprocess.run([*UNSHARE, mount], capture_output=True, check=False)
    return probe.returncode == 0


def test_a_full_disk_ends_the_run_whole(tmp_path: Path) -> None:
    """On a full disk of 3 MB the run closes as failed and says so; every line and picture is whole."""
    disk, copy = tmp_path / "disk", tmp_path / "copy"
    disk.mkdir()
    if not _can_mount(disk):
        pytest.skip("this account may not mount a small disk of its own")
    mount = f"mount -t tmpfs -o size=3m none '{disk}' && exec \"$@\""
    command = [*UNSHARE, mount, "sh", *WRITER, str(disk), "--copy-to", str(copy)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    run = open_run(copy)
    assert run.problems == ()
    assert run.manifest["exit_status"] == "failed"
    assert re.search(r"cannot write .*No space left on device \(\d+\.\d MB free", str(run.manifest["reason"]))
    assert list(run.events["kind"])[-1] == "run_stop"
    assert not list(copy.rglob(".*.tmp"))
    assert_all_there(run, count_acknowledged(done.stdout))
