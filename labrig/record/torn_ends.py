"""Sets aside what an interruption left half written, so that a record can be closed or continued; deletes nothing."""

import os
from collections.abc import Iterator
from itertools import count
from pathlib import Path

from labrig.posix import NO_LINKS, sync_directory
from labrig.record.can_log import read_can_log
from labrig.record.check import LINE_FILES, list_leftover_pictures
from labrig.record.durable import disk_errors, write_and_rename
from labrig.record.json_lines import read_lines, scan_lines
from labrig.record.layout import CAN_LOG, FRAME_LINES, FRAMES, RAW_PICTURES, TORN, inside
from labrig.record.pictures import measure_listed_pictures, measure_raw_pictures


def set_aside(run: Path) -> tuple[str, ...]:
    """Move torn ends and unlisted pictures of an undamaged run into torn/NNN; return what was moved.

    A last line that lacks nothing but its newline gets it. Everything else stays byte for byte as it was.

    Raises
    ------
    DiskError
        When that cannot be written; what has not been moved yet stands where it stood.
    """
    _finish_last_lines(run)
    ends = list(_torn_ends(run))
    pictures = list_leftover_pictures(run, len(read_lines(run / FRAME_LINES)))
    if not ends and not pictures:
        return ()
    folder = _make_folder(run)
    for name, keep_bytes in ends:
        _move_end(inside(run, name), keep_bytes, folder / f"{name}.end")
    for name in pictures:
        with disk_errors(folder):
            inside(run, name).rename(folder / Path(name).name)
    with disk_errors(folder):
        sync_directory(run / FRAMES)
        sync_directory(folder)
    return tuple(sorted(path.relative_to(run).as_posix() for path in folder.iterdir()))


def _finish_last_lines(run: Path) -> None:
    """Add the newline of a last line that lacks nothing else."""
    for name in LINE_FILES:
        path = inside(run, name)
        if path.exists() and not scan_lines(path).ends_with_newline:
            with disk_errors(path):
                _append(path, b"\n")


def _torn_ends(run: Path) -> Iterator[tuple[str, int]]:
    """Yield the files with a torn end, and how much of each is whole."""
    for name in LINE_FILES:
        path = inside(run, name)
        if path.exists() and (scan := scan_lines(path)).torn:
            yield name, scan.whole_bytes
    listed = measure_listed_pictures(run, read_lines(run / FRAME_LINES))
    if measure_raw_pictures(run) > listed:
        yield RAW_PICTURES, listed
    log = read_can_log(run)
    if log.torn:
        yield CAN_LOG, len(log.content)


def _move_end(path: Path, keep_bytes: int, to: Path) -> None:
    with disk_errors(to):
        with path.open("rb") as file:
            file.seek(keep_bytes)
            write_and_rename(to, file.read())
        sync_directory(to.parent)
        descriptor = os.open(path, os.O_WRONLY | NO_LINKS)
        try:
            os.ftruncate(descriptor, keep_bytes)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _append(path: Path, content: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | NO_LINKS)
    try:
        os.write(descriptor, content)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _make_folder(run: Path) -> Path:
    """Make the next of torn/001, 002 ..."""
    parent = inside(run, TORN)
    with disk_errors(parent):
        parent.mkdir(exist_ok=True)
        for number in count(1):
            folder = parent / f"{number:03d}"
            if not folder.exists():
                folder.mkdir()
                return folder
    raise AssertionError("count() has no end")
