"""Locks with an owner."""

import json
import os
import platform
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from labrig.errors import DiskError, LockedError
from labrig.record.lock import FileLock, read_lock_owner
from tests.disks import full_disk

HOLDER = """
import sys
from pathlib import Path
from labrig.record.lock import FileLock
lock = FileLock(Path(sys.argv[1])).acquire("labrig run")
print("held", flush=True)
sys.stdin.read()
"""


def hold_elsewhere(path: Path) -> subprocess.Popen[str]:
    """Return a process that holds the lock until its standard input ends."""
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    return holder


def test_a_held_lock_is_refused_with_its_owner(tmp_path: Path) -> None:
    """Another process, and another lock of this process, get an error with the owner and its command."""
    path = tmp_path / "lock"
    with FileLock(path).acquire("labrig run"):
        owner = read_lock_owner(path)
        assert owner is not None
        assert (owner.doing, owner.pid) == ("labrig run", os.getpid())
        with pytest.raises(LockedError, match=rf"in use by labrig run \(process {os.getpid()} on "):
            FileLock(path).acquire("labrig resume")
    assert read_lock_owner(path) is None
    assert list(tmp_path.iterdir()) == []


def test_the_lock_of_a_killed_owner_is_stale(tmp_path: Path) -> None:
    """After SIGKILL the file keeps the dead owner's text; nobody holds the lock, and it can be acquired."""
    path = tmp_path / "lock"
    with hold_elsewhere(path) as holder:
        with pytest.raises(LockedError, match=f"process {holder.pid} "):
            FileLock(path).acquire("labrig resume")
        holder.send_signal(signal.SIGKILL)
    assert path.exists()
    assert read_lock_owner(path) is None
    with FileLock(path).acquire("labrig resume") as lock:
        assert lock.stale is not None
        assert lock.stale.pid == holder.pid


def test_a_process_id_that_is_in_use_again_holds_nothing(tmp_path: Path) -> None:
    """The kernel says whether a lock is held, not the process id in its text, which another process may have by now."""
    path = tmp_path / "lock"
    path.write_text(json.dumps({"doing": "labrig run", "pid": os.getppid(), "host": platform.node()}))
    assert read_lock_owner(path) is None
    with FileLock(path).acquire("labrig resume") as lock:
        assert lock.stale is not None
        assert lock.stale.pid == os.getppid()


def test_a_lock_that_cannot_be_written_is_not_kept(tmp_path: Path) -> None:
    """On a full disk it is refused, and nobody holds it afterwards, not even this process."""
    path = tmp_path / "lock"
    with full_disk(), pytest.raises(DiskError, match="cannot write"):
        FileLock(path).acquire("labrig run")
    with FileLock(path).acquire("labrig run"):
        pass


def test_a_text_that_is_no_owner_does_not_hold_a_lock(tmp_path: Path) -> None:
    """A torn or foreign text is replaced; no owner is invented for it."""
    path = tmp_path / "lock"
    for text in (b"", b'{"pid": 1', b"[]", b'{"pid": "x"}', b"\xff\xfe"):
        path.write_bytes(text)
        assert read_lock_owner(path) is None
        with FileLock(path).acquire("labrig run") as lock:
            assert lock.stale is None
    assert not path.exists()


def test_a_lock_is_not_taken_through_a_link(tmp_path: Path) -> None:
    """A link in place of the lock is not followed: its target stays as it was."""
    precious = tmp_path / "precious"
    precious.write_text("data")
    (tmp_path / "lock").symlink_to(precious)
    with pytest.raises(DiskError):
        FileLock(tmp_path / "lock").acquire("labrig run")
    assert precious.read_text() == "data"
