"""The numbered results of a run: made from the record, stored in it, never overwritten.

A result is finished when its SHA256SUMS is there, which is written last; an analysis that was stopped leaves none.
"""

import re
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Any

from labrig.durable import disk_errors, write_atomically
from labrig.errors import Problem, RecordError
from labrig.input_file import MAX_RESULT_BYTES
from labrig.record.layout import (
    ANALYSIS,
    SHA256SUMS,
    encode_sums,
    find_added,
    find_changed,
    hash_file,
    inside,
    list_files,
    read_document,
    read_sums,
)

_RESULT = "result.json"
_NUMBER = re.compile(r"[0-9]{3}|[1-9][0-9]{3,8}")
_AGAIN = "make a new one with labrig reanalyze"


def new_result_dir(run: Path) -> Path:
    """Make and return the next of analysis/001, 002 ...; two callers at once get a folder each. Raises `DiskError`."""
    parent = inside(run, ANALYSIS)
    with disk_errors(parent):
        parent.mkdir(exist_ok=True)
        for number in count(max(_list_folders(parent), default=0) + 1):
            with suppress(FileExistsError):
                folder = parent / f"{number:03d}"
                folder.mkdir()
                return folder
    raise AssertionError("count() has no end")


def finish_result(folder: Path) -> None:
    """Write SHA256SUMS of a result that is complete. Raises `DiskError`."""
    sums = {name: hash_file(folder / name) for name in list_files(folder)}
    write_atomically(folder / SHA256SUMS, encode_sums(sums))


def list_results(run: Path) -> tuple[int, ...]:
    """Return the numbers of the finished results in order. Raises `RecordError` if the folder of results is a link."""
    parent = inside(run, ANALYSIS)
    numbers = sorted(_list_folders(parent))
    return tuple(number for number in numbers if (parent / f"{number:03d}" / SHA256SUMS).exists())


def find_result_problems(run: Path, number: int) -> Iterator[Problem]:
    """Yield what is missing from a result, was changed in it, or was added to it."""
    name = f"{ANALYSIS}/{number:03d}"
    try:
        folder = inside(run, name)
        sums = read_sums(folder)
    except RecordError as error:
        yield Problem(f"{name}/{SHA256SUMS}", error.message, _AGAIN)
        return
    found = chain(find_changed(folder, sums, f"{SHA256SUMS} of the result"), find_added(folder, sums))
    yield from (Problem(f"{name}/{problem.where}", problem.message, _AGAIN) for problem in found)


def open_result(run: Path, number: int) -> Path:
    """Return the folder of a result. Raises `RecordError` when a file in it was changed, added or is missing."""
    for first in find_result_problems(run, number):
        raise RecordError(f"{run / first.where}: {first.message}", first.hint)
    return inside(run, f"{ANALYSIS}/{number:03d}")


def read_result(folder: Path) -> dict[str, Any]:
    """Return result.json of a result as it stands. Raises `RecordError` when it cannot be read."""
    return read_document(folder / _RESULT, MAX_RESULT_BYTES, _AGAIN)


def _list_folders(parent: Path) -> list[int]:
    """Return the numbers of the folders 001, 002 ...; whatever else stands there is not labrig's."""
    folders = parent.iterdir() if parent.is_dir() else ()
    return [int(folder.name) for folder in folders if _NUMBER.fullmatch(folder.name)]
