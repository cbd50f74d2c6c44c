"""Set torn ends aside, so that an interrupted record can be closed or continued; nothing is deleted."""

import os
from collections.abc import Iterator
from pathlib import Path

from labrig.durable import disk_errors, find_temporaries, open_descriptor, write_and_rename
from labrig.input_file import open_file
from labrig.posix import sync_directory
from labrig.record.can_log import read_can_log
from labrig.record.check import LINE_FILES, list_leftover_pictures
from labrig.record.json_lines import read_lines, scan_lines
from labrig.record.layout import CALIBRATION, CAN_LOG, FRAME_LINES, FRAMES, RAW_PICTURES, TORN, inside
from labrig.record.pictures import measure_listed_pictures, measure_raw_pictures
from labrig.record.results import make_numbered_folder


def set_aside(run: Path) -> tuple[str, ...]:
    """Move torn ends, unlisted pictures and temporary files of an undamaged run into torn/NNN and return those files.

    A last line that lacks only its newline gets it. Everything else stays byte for byte as it is.

    Raises
    ------
    DiskError
        When they cannot be written; what has not been moved stays in place.
    """
    _finish_last_lines(run)
    ends = list(_torn_ends(run))
    leftovers = [
        *list_leftover_pictures(run, len(read_lines(run / FRAME_LINES))),
        *(
            path.relative_to(run).as_posix()
            for folder in (run, run / CALIBRATION)
            for path in find_temporaries(folder)
        ),
    ]
    if not ends and not leftovers:
        return ()
    folder = make_numbered_folder(inside(run, TORN))
    for name, keep_bytes in ends:
        _move_end(inside(run, name), keep_bytes, folder / f"{name}.end")
    for name in leftovers:
        with disk_errors(folder):
            inside(run, name).rename(folder / Path(name).name)
    with disk_errors(folder):
        for changed in (run, run / CALIBRATION, run / FRAMES, folder):
            sync_directory(changed)
    return tuple(sorted(path.relative_to(run).as_posix() for path in folder.iterdir()))


def _finish_last_lines(run: Path) -> None:
    """Add the newline to a last line that lacks only that."""
    for name in LINE_FILES:
        path = inside(run, name)
        if path.exists() and not scan_lines(path).ends_with_newline:
            with disk_errors(path), open_descriptor(path, os.O_WRONLY | os.O_APPEND) as descriptor:
                os.write(descriptor, b"\n")
                os.fsync(descriptor)


def _torn_ends(run: Path) -> Iterator[tuple[str, int]]:
    """Yield each file with a torn end, and the length of its whole part."""
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
        with open_file(path) as file:
            file.seek(keep_bytes)
            write_and_rename(to, file.read())
        sync_directory(to.parent)
        with open_descriptor(path, os.O_WRONLY) as descriptor:
            os.ftruncate(descriptor, keep_bytes)
            os.fsync(descriptor)
