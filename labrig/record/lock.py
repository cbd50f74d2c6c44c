"""Locks with an owner: one writer for a run, one labrig for a rig.

A lock is a file that its owner keeps locked in the kernel (`flock`), with a JSON text that names the owner. The kernel
frees it when the owner ends, however it ends. So the text in an unlocked file is stale and is replaced.
"""

import errno
import json
import os
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

from labrig.durable import disk_errors, write_fully
from labrig.errors import LockedError
from labrig.input_file import parse_json, read_file
from labrig.posix import NO_LINKS, is_locked, lock

_BUSY = frozenset({errno.EACCES, errno.EAGAIN, errno.EDEADLK})


@dataclass(frozen=True)
class LockOwner:
    """The owner of a lock: its command, process and computer."""

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
        The lock's file, in an existing folder; removed on release.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor: int | None = None
        self.stale: LockOwner | None = None
        """The previous owner, if it died and left its text."""

    def acquire(self, doing: str) -> Self:
        """Take the lock.

        Parameters
        ----------
        doing : str
            The command, as other processes report it: `labrig run` ...

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
        """Open and lock the file; again if its last owner removed it meanwhile."""
        while True:
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | NO_LINKS, 0o666)
            try:
                lock(descriptor, wait=False)
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
        """Release the lock; a second call does nothing."""
        if self._descriptor is None:
            return
        with suppress(OSError):
            self.path.unlink()
        os.close(self._descriptor)
        self._descriptor = None

    def __enter__(self) -> Self:
        """Return the acquired lock."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the lock."""
        self.release()


def read_lock_owner(path: Path) -> LockOwner | None:
    """Return the owner of a lock; None if nobody holds it, whatever a dead owner left in the file."""
    try:
        descriptor = os.open(path, os.O_RDWR | NO_LINKS)
    except OSError:
        return None
    try:
        if not is_locked(descriptor):
            return None
        return _parse_owner(_read_text(path)) or LockOwner("another labrig", 0, platform.node())
    finally:
        os.close(descriptor)


def _write_owner(descriptor: int, owner: LockOwner) -> None:
    os.lseek(descriptor, 0, os.SEEK_SET)
    os.ftruncate(descriptor, 0)
    write_fully(descriptor, (json.dumps(asdict(owner)) + "\n").encode())


def _is_current(path: Path, descriptor: int) -> bool:
    """Return whether the locked file is still the one at the path."""
    with suppress(OSError):
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    return False


def _read_text(path: Path) -> bytes:
    with suppress(OSError):
        return read_file(path)
    return b""


def _parse_owner(text: bytes) -> LockOwner | None:
    try:
        fields = parse_json(text)
    except ValueError:
        return None
    if not isinstance(fields, Mapping) or not isinstance(fields.get("pid"), int):
        return None
    return LockOwner(str(fields.get("doing")), fields["pid"], str(fields.get("host")))
