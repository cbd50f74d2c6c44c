"""An append-only file of CRC lines that is intact after every call, whatever stops the process."""

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from labrig.durable import append_or_restore
from labrig.input_file import open_file
from labrig.posix import NO_LINKS
from labrig.record.json_lines import encode_line


class LineFile:
    """One of the `*.jsonl` files of a run, or frames.raw, open for appending.

    Lines go to the kernel with `os.write`, unbuffered, so that SIGKILL loses no line that `append` has written.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self._descriptor = descriptor
        self._length = 0
        self._sha256 = hashlib.sha256()
        self._before = (0, self._sha256)
        self._unsynced = True

    @classmethod
    def create(cls, path: Path) -> Self:
        """Create the file. Raises `OSError` if it exists."""
        return cls(path, os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666))

    @classmethod
    def reopen(cls, path: Path) -> Self:
        """Open a file of whole lines for appending. Raises `OSError` if it is a link or missing."""
        file = cls(path, os.open(path, os.O_WRONLY | os.O_APPEND | NO_LINKS))
        with open_file(path) as written:
            file._sha256 = hashlib.file_digest(written, "sha256")
            file._length = written.tell()
        return file

    @property
    def sha256(self) -> str:
        """The SHA-256 of all lines so far, in hexadecimal digits."""
        return self._sha256.hexdigest()

    def append(self, fields: Mapping[str, object]) -> None:
        """Append one line, or nothing of it on a full disk."""
        self.append_raw(encode_line(fields))

    def append_raw(self, line: bytes) -> int:
        """Append encoded lines, or nothing of them on a full disk, and return the new length."""
        try:
            append_or_restore(self._descriptor, line, self._length)
        finally:
            # Afterwards: a sync that began before has not seen the lines.
            self._unsynced = True
        self._before = (self._length, self._sha256.copy())
        self._length += len(line)
        self._sha256.update(line)
        return self._length

    def cut_last(self) -> None:
        """Cut off what the last call appended. Raises `OSError`."""
        length, sha256 = self._before
        os.ftruncate(self._descriptor, length)
        self._length, self._sha256 = length, sha256

    def sync(self) -> None:
        """Make the lines so far durable against a power cut; another thread may append meanwhile."""
        if not self._unsynced:
            return
        # Before the fsync: lines appended during it are left for the next one.
        self._unsynced = False
        try:
            os.fsync(self._descriptor)
        except OSError:
            self._unsynced = True
            raise

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)
