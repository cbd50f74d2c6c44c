"""Locks with an owner: one writer a run directory, one labrig a rig.

A lock is a file that its owner keeps locked in the kernel (`flock`; on Windows a locked byte), with a JSON
text that says who that is. The kernel frees it when the owner ends, however it ends: so the text of a dead
owner is stale, is recognised as such because the file is not locked any more, and is replaced.
"""

import errno
import json
import os
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from labrig.errors import LockedError
from labrig.posix import NO_LINKS, lock_at_once
from labrig.record.durable import disk_errors, write_fully

_BUSY = frozenset({errno.EACCES, errno.EAGAIN, errno.EDEADLK})


@dataclass(frozen=True)
class LockOwner:
    """Who holds a lock: what it does, its process and its computer."""

    doing: str
    pid: int
    host: str

    def __str__(self) -> str:
        """Return the owner as the end of a sentence."""
        return f"{self.doing} (process {self.pid} on {self.host})"


class FileLock:
    """A lock that is held from `acquire` until `release`, or until the process ends.

    Parameters
    ----------
    path : Path
        The lock's file, in an existing folder; it is removed on release.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor: int | None = None
        self.stale: LockOwner | None = None
        """Who held it before and died, where its text was found."""

    def acquire(self, doing: str) -> Self:
        """Take the lock.

        Parameters
        ----------
        doing : str
            What for, as others are told: `labrig run` ...

        Raises
        ------
        LockedError
            When another process holds it, or this one by another `FileLock`; names the owner.
        DiskError
            When the file cannot be made.
        """
        with disk_errors(self.path):
            self._descriptor = self._open_locked()
            try:
                self.stale = _parse_owner(os.read(self._descriptor, 4096))
                _write_owner(self._descriptor, LockOwner(doing, os.getpid(), platform.node()))
            except OSError:
                self.release()
                raise
        return self

    def _open_locked(self) -> int:
        """Open and lock the file; one that its last owner removed meanwhile is left for the new one."""
        while True:
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | NO_LINKS, 0o666)
            try:
                lock_at_once(descriptor)
                if _is_current(self.path, descriptor):
                    return descriptor
            except OSError as error:
                os.close(descriptor)
                if error.errno in _BUSY:
                    raise self._make_refusal() from error
                raise
            os.close(descriptor)

    def _make_refusal(self) -> LockedError:
        owner = _parse_owner(_read_text(self.path))
        who = "another labrig" if owner is None else str(owner)
        return LockedError(f"{self.path.parent} is in use by {who}", "wait until it has ended, or stop it")

    def release(self) -> None:
        """Give the lock back; giving it back again does nothing."""
        if self._descriptor is None:
            return
        with suppress(OSError):
            self.path.unlink()
        os.close(self._descriptor)
        self._descriptor = None

    def __enter__(self) -> Self:
        """Return the lock, which `acquire` has taken."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Give the lock back."""
        self.release()


def read_lock_owner(path: Path) -> LockOwner | None:
    """Return who holds a lock now; None where nobody does, whatever a dead owner left in the file."""
    try:
        descriptor = os.open(path, os.O_RDWR | NO_LINKS)
    except OSError:
        return None
    try:
        lock_at_once(descriptor)
    except OSError:
        return _parse_owner(_read_text(path)) or LockOwner("another labrig", 0, platform.node())
    finally:
        os.close(descriptor)
    return None


def _write_owner(descriptor: int, owner: LockOwner) -> None:
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.ftruncate(descriptor, 0)
    write_fully(descriptor, (json.dumps(asdict(owner)) + "\n").encode())


def _is_current(path: Path, descriptor: int) -> bool:
    """Return whether the file that was locked is the one that stands under the name."""
    with suppress(OSError):
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    return False


def _read_text(path: Path) -> bytes:
    with suppress(OSError):
        return path.read_bytes()
    return b""


def _parse_owner(text: bytes) -> LockOwner | None:
    try:
        fields = json.loads(text)
    except ValueError:
        return None
    if not isinstance(fields, Mapping) or not isinstance(fields.get("pid"), int):
        return None
    return LockOwner(str(fields.get("doing")), fields["pid"], str(fields.get("host")))
