"""The numbered results of a run: made from the record, stored in it, never overwritten.

A result is finished when its SHA256SUMS is there, which is written last; an analysis that was stopped leaves none.
"""

import re
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path

from labrig.durable import disk_errors, write_atomically
from labrig.errors import Problem, RecordError
from labrig.input_file import MAX_RESULT_BYTES, parse_json, read_file
from labrig.record.json_lines import make_readable
from labrig.record.layout import ANALYSIS, SHA256SUMS, hash_file, inside
from labrig.record.manifest import check_file, encode_sums, read_sums

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
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    sums = {path.relative_to(folder).as_posix(): hash_file(path) for path in files}
    write_atomically(folder / SHA256SUMS, encode_sums(sums))


def list_results(run: Path) -> tuple[int, ...]:
    """Return the numbers of the finished results in order. Raises `RecordError` if the folder of results is a link."""
    parent = inside(run, ANALYSIS)
    return tuple(
        sorted(number for number in _list_folders(parent) if (parent / f"{number:03d}" / SHA256SUMS).exists())
    )


def find_result_problems(run: Path, number: int) -> Iterator[Problem]:
    """Yield what is missing from a result, was changed in it, or was added to it."""
    name = f"{ANALYSIS}/{number:03d}"
    try:
        folder = inside(run, name)
        sums, wrong = read_sums(folder)
    except RecordError as error:
        yield Problem(f"{name}/{SHA256SUMS}", error.message, _AGAIN)
        return
    for line in wrong:
        yield Problem(f"{name}/{SHA256SUMS}:{line}", "the line is no checksum and file name", _AGAIN)
    for file, sha256 in sums.items():
        for problem in check_file(folder, file, sha256, f"{SHA256SUMS} of the result"):
            yield Problem(f"{name}/{file}", problem.message, _AGAIN)
    for path in sorted(folder.rglob("*")):
        file = path.relative_to(folder).as_posix()
        if path.is_file() and file not in sums and file != SHA256SUMS and not path.name.startswith("."):
            yield Problem(f"{name}/{file}", "it is no part of that result", "move it out of the run")


def open_result(run: Path, number: int) -> Path:
    """Return the folder of a result. Raises `RecordError` when a file in it was changed, added or is missing."""
    first = next(find_result_problems(run, number), None)
    if first is not None:
        raise RecordError(f"{run / first.where}: {first.message}", first.hint)
    return inside(run, f"{ANALYSIS}/{number:03d}")


def latest_result(run: Path) -> dict[str, object] | None:
    """Return the newest result.json; None without one. Raises `RecordError` when the result was changed."""
    numbers = list_results(run)
    return read_result(open_result(run, numbers[-1])) if numbers else None


def read_result(folder: Path) -> dict[str, object]:
    """Return result.json of a result as it stands. Raises `RecordError` when it cannot be read."""
    path = folder / _RESULT
    try:
        result = parse_json(read_file(path, MAX_RESULT_BYTES))
    except (OSError, ValueError) as error:
        raise RecordError(f"{path} is damaged: {error}", _AGAIN) from error
    if not isinstance(result, dict):
        raise RecordError(f"{path} is damaged: it holds no JSON object", _AGAIN)
    return make_readable(result)


def _list_folders(parent: Path) -> list[int]:
    """Return the numbers of the folders 001, 002 ...; whatever else stands there is not labrig's."""
    folders = parent.iterdir() if parent.is_dir() else ()
    return [int(folder.name) for folder in folders if _NUMBER.fullmatch(folder.name)]
