"""The numbered results of a run: made from the record, stored in it, never overwritten."""

import re
from collections.abc import Iterable
from contextlib import suppress
from itertools import count
from pathlib import Path

from labrig.durable import disk_errors
from labrig.errors import RecordError
from labrig.input_file import MAX_RESULT_BYTES, parse_json, read_file
from labrig.record.json_lines import make_readable
from labrig.record.layout import ANALYSIS, inside
from labrig.record.seal import Seal, read_seal
from labrig.record.sealing import list_files

_RESULT = "result.json"
_NUMBER = re.compile(r"[0-9]{3}|[1-9][0-9]{3,8}")


def new_result_dir(run: Path) -> Path:
    """Make and return the folder of the next result. Raises `DiskError`."""
    return make_numbered_folder(inside(run, ANALYSIS))


def make_numbered_folder(parent: Path) -> Path:
    """Make the next of the folders 001, 002 ...; two callers at once get a folder each. Raises `DiskError`."""
    with disk_errors(parent):
        parent.mkdir(exist_ok=True)
        for number in count(max(list_numbered_folders(parent), default=0) + 1):
            with suppress(FileExistsError):
                folder = parent / f"{number:03d}"
                folder.mkdir()
                return folder
    raise AssertionError("count() has no end")


def latest_result(
    run: Path, without: Iterable[str] = (), seal: Seal | None = None
) -> dict[str, object] | None:
    """Return the newest result.json. Raises `RecordError` when it was changed or is damaged.

    Top-level lists named in `without` come back empty, which saves most of the time when they are long. The seal of the
    run, here and below, is read if it is not given.
    """
    name = require_unchanged_newest(run, seal)
    return None if name is None else _read_result(inside(run, name), without)


def require_unchanged_newest(run: Path, seal: Seal | None = None) -> str | None:
    """Return the newest result.json relative to its run; None without one. Raises `RecordError` when it was changed."""
    seal = seal or read_seal(run)
    numbers = list_results(run, seal)
    if not numbers:
        return None
    name = f"{ANALYSIS}/{numbers[-1]:03d}/{_RESULT}"
    require_unchanged_result(run, numbers[-1], (name,), seal)
    return name


def list_results(run: Path, seal: Seal | None = None) -> tuple[int, ...]:
    """Return the numbers of the results in order; of a run with a chain, those that it covers.

    Raises
    ------
    RecordError
        When the chain is damaged, or the folder of results is a link.
    """
    parent = inside(run, ANALYSIS)
    seal = seal or read_seal(run)
    if seal.links:
        return seal.results
    # The file is written last, so an analysis that was stopped has none.
    return tuple(
        sorted(
            number
            for number in list_numbered_folders(parent)
            if (parent / f"{number:03d}/{_RESULT}").exists()
        )
    )


def require_unchanged_result(
    run: Path, number: int, names: Iterable[str] | None = None, seal: Seal | None = None
) -> None:
    """Refuse a result that is not as the chain of its run has it; `names` of its files, or all of them.

    Raises
    ------
    RecordError
        When one of them is missing, a link, or was changed, or a file was added to all of them; names it.
    """
    seal = seal or read_seal(run)
    sealed = seal.result_files(number)
    for name in sealed if names is None else names:
        inside(run, name)
        if seal.links:
            seal.require_unchanged(name)
    for name in list_files(run, f"{ANALYSIS}/{number:03d}") if seal.links and names is None else ():
        if name not in sealed:
            raise RecordError(f"{run / name} is no part of that result", "move it out of the run")


def _empty_list(content: bytes, name: bytes) -> bytes:
    """Return a document with a top-level list emptied, if it is indented as by `encode_document`; else unchanged."""
    start = content.find(b'\n  "%s": [\n' % name)
    end = content.find(b"\n  ]", start)
    return content if min(start, end) < 0 else b'%s\n  "%s": [%s' % (content[:start], name, content[end:])


def list_numbered_folders(parent: Path) -> list[int]:
    """Return the numbers of the folders 001, 002 ...; whatever else stands there is not labrig's."""
    folders = parent.iterdir() if parent.is_dir() else ()
    return [int(folder.name) for folder in folders if _NUMBER.fullmatch(folder.name)]


def _read_result(path: Path, without: Iterable[str]) -> dict[str, object]:
    try:
        content = read_file(path, MAX_RESULT_BYTES)
        for name in without:
            content = _empty_list(content, name.encode())
        result = parse_json(content)
    except (OSError, ValueError) as error:
        raise RecordError(f"{path} is damaged: {error}", "make a new one with labrig reanalyze") from error
    if not isinstance(result, dict):
        raise RecordError(
            f"{path} is damaged: it holds no JSON object", "make a new one with labrig reanalyze"
        )
    return make_readable(result) if b"\\ud" in content else result
