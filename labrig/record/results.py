"""The numbered results of a run: made from the record, kept beside it, never overwritten."""

import json
from collections.abc import Iterable
from itertools import count
from pathlib import Path

from labrig.errors import RecordError
from labrig.record.durable import disk_errors
from labrig.record.layout import ANALYSIS, inside

_RESULT = "result.json"


def new_result_dir(run: Path) -> Path:
    """Make and return the folder of the next result; of two callers at once each gets its own."""
    parent = inside(run, ANALYSIS)
    with disk_errors(parent):
        parent.mkdir(exist_ok=True)
        for number in count(max(_list_numbers(parent), default=0) + 1):
            folder = parent / f"{number:03d}"
            try:
                folder.mkdir()
            except FileExistsError:
                continue
            return folder
    raise AssertionError("count() has no end")


def latest_result(run: Path, without: Iterable[str] = ()) -> dict[str, object] | None:
    """Return the newest result.json; an analysis that was stopped has none, as it is written last.

    The lists at its top that are named in `without` are empty, which spares most of the time where they are long.
    """
    parent = inside(run, ANALYSIS)
    for number in sorted(_list_numbers(parent), reverse=True):
        path = inside(run, f"{ANALYSIS}/{number:03d}/{_RESULT}")
        if path.exists():
            return _read_result(path, without)
    return None


def _empty_list(content: bytes, name: bytes) -> bytes:
    """Return a document with a list at its top emptied, as `encode_document` indents it; any other as it is."""
    start = content.find(b'\n  "%s": [\n' % name)
    end = content.find(b"\n  ]", start)
    return content if min(start, end) < 0 else b'%s\n  "%s": [%s' % (content[:start], name, content[end:])


def _list_numbers(parent: Path) -> list[int]:
    folders = parent.iterdir() if parent.is_dir() else ()
    return [int(folder.name) for folder in folders if folder.name.isdecimal()]


def _read_result(path: Path, without: Iterable[str]) -> dict[str, object]:
    try:
        content = path.read_bytes()
        for name in without:
            content = _empty_list(content, name.encode())
        result = json.loads(content)
    except (OSError, ValueError) as error:
        raise RecordError(f"{path} is damaged: {error}", "make a new one with labrig reanalyze") from error
    if not isinstance(result, dict):
        raise RecordError(
            f"{path} is damaged: it holds no JSON object", "make a new one with labrig reanalyze"
        )
    return result
