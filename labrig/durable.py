"""Durable writing: atomic files, synced directories, and disk errors that name the path and give a hint.

Every file that labrig writes whole goes through here. The others are appended to (lines, raw pictures, notes, logs),
hold nothing that lasts (locks, the reserve, the index of runs), or are filled by a library or a copy under a temporary
name that is renamed when they are complete (the view, exports). `tests/test_tidy.py` lists who writes them.
"""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from labrig.errors import DiskError

_HINTS = {
    errno.ENOSPC: "make room on that disk, or keep the runs on another one",
    errno.EDQUOT: "the disk quota is used up: make room, or keep the runs elsewhere",
    errno.EFBIG: "the file would be larger than this account or disk allows",
    errno.EACCES: "give this account the right to write there, or choose another folder",
    errno.EPERM: "give this account the right to write there, or choose another folder",
    errno.EROFS: "the disk is mounted read-only: choose another folder",
    errno.ENOTDIR: "a file stands where a folder is needed: choose another folder",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOLCK: "that disk knows no locks: keep the runs on a local one",
    errno.ENOTSUP: "that disk cannot do this: keep the runs on a local one",
}


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a power cut leaves either its old or its new content, never a part.

    Parameters
    ----------
    path : Path
        A file in an existing folder; replaced when it exists.
    content : bytes
        All of it.

    Raises
    ------
    DiskError
        When it cannot be written; an older file is untouched.
    """
    write_and_rename(path, content)
    with disk_errors(path):
        sync_directory(path.parent)


def write_and_rename(path: Path, content: bytes, *, sync: bool = True) -> None:
    """Write a file under a temporary name of its own, fsync it, and rename it into place.

    Two writers of one file never share a temporary name, so a reader sees all of one or all of the other.
    The content is durable when this returns; without `sync`, after the next `sync_file`. The name is durable after the
    next `sync_directory` of its folder.
    """
    with disk_errors(path), temporary_file(path) as temporary:
        with open_descriptor(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL) as descriptor:
            write_fully(descriptor, content)
            if sync:
                os.fsync(descriptor)
        temporary.replace(path)


@contextmanager
def temporary_file(path: Path) -> Iterator[Path]:
    """Give an unused hidden name beside `path`; what stands there when the block ends is removed. Raises `OSError`."""
    temporary = path.with_name(f".{path.name}.{os.urandom(8).hex()}.tmp")
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)


def find_temporaries(folder: Path) -> list[Path]:
    """Return the temporary files that killed writers left in a folder."""
    return sorted(path for path in folder.glob(".*.tmp") if path.is_file() and not path.is_symlink())


def sync_file(path: Path) -> None:
    """Make a file's content durable. Raises `OSError`."""
    with open_descriptor(path, os.O_RDONLY) as descriptor:
        os.fsync(descriptor)


def sync_directory(path: Path) -> None:
    """Make the names in a folder durable. Raises `OSError`."""
    with open_descriptor(path, os.O_RDONLY | os.O_DIRECTORY) as descriptor:
        os.fsync(descriptor)


@contextmanager
def open_descriptor(path: Path, flags: int) -> Iterator[int]:
    """Open a file for the block, unbuffered; a symbolic link is not followed. Raises `OSError`."""
    descriptor = os.open(path, flags | os.O_NOFOLLOW, 0o666)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def write_fully(descriptor: int, content: bytes) -> None:
    """Write all bytes; the kernel may take only some at a time, as it does when the disk is nearly full."""
    view = memoryview(content)
    while view:
        view = view[os.write(descriptor, view) :]


def append_or_restore(descriptor: int, content: bytes, length_before: int) -> None:
    """Append all bytes; on a full disk, cut off what it took of them. Raises `OSError`.

    A disk that fills up takes the beginning and refuses the rest; what is appended later must not continue that.
    """
    try:
        write_fully(descriptor, content)
    except OSError:
        os.ftruncate(descriptor, length_before)
        raise


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn an `OSError` in the block into a `DiskError` with the path and a remedy; of a full disk also the space."""
    try:
        yield
    except OSError as error:
        is_full = error.errno == errno.ENOSPC
        free = f" ({free_bytes(path) / 1e6:.1f} MB free on that disk)" if is_full else ""
        raise DiskError(
            f"cannot write {path}: {error.strerror}{free}", _HINTS.get(error.errno or 0, "check the disk")
        ) from error


def require_free_bytes(path: Path, need_bytes: int) -> None:
    """Refuse to start writing what does not fit on the disk.

    Parameters
    ----------
    path : Path
        The place to write to, which need not exist yet.
    need_bytes : int
        The space that is needed.

    Raises
    ------
    DiskError
        When the disk of `path` has less free space than that.
    """
    free = free_bytes(path)
    if free < need_bytes:
        raise DiskError(
            f"{path} needs {need_bytes / 1e6:.1f} MB, and that disk has {free / 1e6:.1f} MB free",
            _HINTS[errno.ENOSPC],
        )


def free_bytes(path: Path) -> int:
    """Return the free space on the disk that holds `path`, or will hold it."""
    for folder in (path.absolute(), *path.absolute().parents):
        with suppress(OSError):
            return shutil.disk_usage(folder).free
    raise DiskError(f"cannot find the disk of {path}")
