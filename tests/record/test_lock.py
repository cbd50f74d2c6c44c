"""Locks with an owner."""

import json
import os
import platform
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from labrig.errors import DiskError, LockedError
from labrig.record.lock import FileLock, LockOwner, read_lock_owner
from tests.disks import full_disk

HOLDER = """
import sys
from pathlib import Path
from labrig.record.lock import FileLock
lock = FileLock(Path(sys.argv[1])).acquire("labrig run")
print("held", flush=True)
sys.stdin.read()
"""


def test_a_held_lock_is_refused_with_its_owner(tmp_path: Path) -> None:
    """Another lock of this process gets an error with the owner and its command."""
    path = tmp_path / "lock"
    with FileLock(path).acquire("labrig run"):
        owner = read_lock_owner(path)
        assert (owner.doing, owner.pid) == ("labrig run", os.getpid())
        with pytest.raises(LockedError, match=rf"in use by labrig run \(process {os.getpid()} on "):
            FileLock(path).acquire("labrig resume")
    assert read_lock_owner(path) is None


def test_the_lock_of_a_killed_owner_is_free(tmp_path: Path) -> None:
    """After SIGKILL the dead owner's text stands there; nobody holds the lock, and it can be acquired."""
    path = tmp_path / "lock"
    command = [sys.executable, "-c", HOLDER, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(LockedError, match=f"process {holder.pid} "):
            FileLock(path).acquire("labrig resume")
        holder.send_signal(signal.SIGKILL)
    assert read_lock_owner(path) is None
    FileLock(path).acquire("labrig resume").release()


def test_whoever_asks_for_the_owner_makes_nobody_fail(tmp_path: Path) -> None:
    """A list of runs looks at a stale lock again and again while another process takes it."""
    path = tmp_path / "lock"
    text = {"doing": "labrig run", "pid": 1, "host": platform.node()}
    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(lambda: [read_lock_owner(path) for _ in range(3000)])
        while not asking.done():
            (tmp_path / "lock.owner").write_text(json.dumps(text))
            FileLock(path).acquire("labrig resume").release()


@pytest.mark.parametrize("text", [b"", b'{"pid": 1', b"[]", b'{"pid": "x"}', b"\xff\xfe"])
def test_a_text_that_is_no_owner_does_not_hold_a_lock(tmp_path: Path, text: bytes) -> None:
    """A torn or foreign text is replaced; no owner is invented for it, but that of a lock that is held is unknown."""
    path, told = tmp_path / "lock", tmp_path / "lock.owner"
    told.write_bytes(text)
    assert read_lock_owner(path) is None
    with FileLock(path).acquire("labrig run"):
        assert read_lock_owner(path).pid == os.getpid()
        told.write_bytes(text)
        assert read_lock_owner(path) == LockOwner("another labrig", 0, platform.node())


def test_a_lock_that_cannot_be_written_is_not_kept(tmp_path: Path) -> None:
    """On a full disk nobody holds it afterwards, not even this process; a link in its place is not followed."""
    path, precious = tmp_path / "lock", tmp_path / "precious"
    with full_disk(), pytest.raises(DiskError, match="cannot write"):
        FileLock(path).acquire("labrig run")
    FileLock(path).acquire("labrig run").release()
    precious.write_text("data")
    path.unlink()
    path.symlink_to(precious)
    with pytest.raises(DiskError):
        FileLock(path).acquire("labrig run")
    assert precious.read_text() == "data"
