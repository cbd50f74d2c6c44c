"""Locks with an owner: one writer for a run, one labrig for a rig.

The lock is that of `filelock`, which the kernel frees when its owner ends, however it ends. A file beside it names the
owner; without the lock that text is stale.
"""

import json
import os
import platform
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import filelock

from labrig.durable import disk_errors, write_and_rename
from labrig.errors import LockedError
from labrig.input_file import parse_json, read_file

_PATIENCE_S = 0.5
"""Whoever asks for the owner holds the lock for an instant; it is waited for."""


@dataclass(frozen=True)
class LockOwner:
    """The owner of a lock: its command, process and computer; process 0 is not known."""

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
        self._lock = filelock.FileLock(path, thread_local=False)

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
        owner = LockOwner(doing, os.getpid(), platform.node())
        with disk_errors(self.path):
            try:
                self._lock.acquire(timeout=_PATIENCE_S)
            except filelock.Timeout as error:
                message = f"{self.path.parent} is in use by {_read_owner(self.path)}"
                raise LockedError(message, "wait until it has ended, or stop it") from error
            try:
                write_and_rename(
                    _owner_path(self.path), json.dumps(asdict(owner)).encode() + b"\n", sync=False
                )
            except BaseException:
                self._lock.release()  # a lock without an owner is nobody's
                raise
        return self

    def release(self) -> None:
        """Release the lock; a second call does nothing."""
        if self._lock.is_locked:
            with suppress(OSError):
                _owner_path(self.path).unlink()
            self._lock.release()

    def __enter__(self) -> Self:
        """Return the acquired lock."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the lock."""
        self.release()


def read_lock_owner(path: Path) -> LockOwner | None:
    """Return the owner of a lock; None if nobody holds it, whatever a dead owner left."""
    if not _owner_path(path).exists():
        return None
    try:
        with filelock.FileLock(path, timeout=0):
            return None
    except filelock.Timeout:
        return _read_owner(path)
    except OSError:
        return None


def _owner_path(path: Path) -> Path:
    return path.with_name(f"{path.name}.owner")


def _read_owner(path: Path) -> LockOwner:
    try:
        fields: Any = parse_json(read_file(_owner_path(path)))
        return LockOwner(**fields)
    except (OSError, ValueError, TypeError):
        return LockOwner("another labrig", 0, platform.node())
