"""JSON as labrig records it: files of one object a line, which are appended to, and documents.

A file of lines is plain: `pandas.read_json(..., lines=True)` reads it. A process that is killed may leave a torn last
line; it was never acknowledged, and readers drop it.
"""

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from pydantic_core import to_json

from labrig.durable import append_or_restore
from labrig.errors import InputError, RecordError
from labrig.input_file import MAX_LOG_BYTES, open_file, parse_json, read_file
from labrig.record.layout import COPY_HINT

Value: TypeAlias = str | int | float | bool | None


def encode_line(fields: Mapping[str, object]) -> bytes:
    """Encode one line, its newline included.

    Parameters
    ----------
    fields : Mapping
        The members of the line, in this order; numpy scalars and arrays are converted, infinite and undefined numbers
        become null.

    Raises
    ------
    InputError
        When it holds a value that JSON cannot hold.
    """
    return _encode(fields, None)


def encode_document(fields: Mapping[str, object]) -> bytes:
    """Encode a JSON file for people and programs: as a line, but indented. Raises as `encode_line`."""
    return _encode(fields, 2)


def encode_manifest(manifest: Mapping[str, object]) -> bytes:
    """Encode a manifest: a member a line, each compact, so that a list of runs reads little."""
    members = [_encode({key: value}, None).strip()[1:-1] for key, value in manifest.items()]
    return b"{" + b",\n".join(members) + b"}\n"


def _encode(fields: Mapping[str, object], indent: int | None) -> bytes:
    try:
        return to_json(fields, indent=indent, inf_nan_mode="null", fallback=_to_plain) + b"\n"
    except ValueError as error:
        raise InputError(f"{dict(fields)} cannot be written as JSON: {error}") from error


def _to_plain(value: object) -> object:
    if isinstance(value, Mapping):
        return dict(value)
    if callable(to_plain := getattr(value, "tolist", None)):  # numpy's scalars and arrays
        return to_plain()
    raise TypeError(f"{value!r} is a {type(value).__name__}")


def decode_line(line: bytes) -> dict[str, Any]:
    """Decode one line. Raises `ValueError` when it is no JSON object."""
    fields = parse_json(line)
    if not isinstance(fields, dict):
        raise ValueError("it is no JSON object")
    return fields


def as_recorded(fields: Mapping[str, object]) -> dict[str, object]:
    """Return the fields as they are after a line of them is written and read. Raises as `encode_line`."""
    return decode_line(encode_line(fields))


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Read the lines of a file without a torn last one.

    Raises
    ------
    RecordError
        When the file cannot be read or a line is no JSON object; names file and line.
    """
    try:
        content = read_file(path, MAX_LOG_BYTES)
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", "the record is not whole") from error
    lines = []
    for number, line in enumerate(content.split(b"\n")[:-1], start=1):
        try:
            lines.append(decode_line(line))
        except ValueError as error:
            raise RecordError(f"{path}:{number}: the line is damaged: {error}", COPY_HINT) from error
    return lines


class LineFile:
    """A file of lines that is open for appending, and whole after every call, whatever stops the process.

    It is made if it is not there; a torn last line is cut off. Lines go to the kernel with `os.write`, unbuffered, so
    that SIGKILL loses no line that `append` has written. Raises `OSError` if the file is a link or cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o666)
        with open_file(path) as written:
            content = written.read()
        whole = content[: content.rfind(b"\n") + 1]
        os.ftruncate(self._descriptor, len(whole))
        self._length = len(whole)
        self._sha256 = hashlib.sha256(whole)

    @property
    def sha256(self) -> str:
        """The SHA-256 of all lines so far, in hexadecimal digits."""
        return self._sha256.hexdigest()

    def append(self, lines: bytes) -> None:
        """Append encoded lines, or nothing of them on a full disk."""
        append_or_restore(self._descriptor, lines, self._length)
        self._length += len(lines)
        self._sha256.update(lines)

    def sync(self) -> None:
        """Make the lines so far durable against a power cut; another thread may append meanwhile."""
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)


def plain_text(text: str) -> str:
    """Return a text that UTF-8 can hold: bytes of a file name that are no UTF-8 become question marks."""
    return text.encode("utf-8", "replace").decode()


def flatten(
    document: object, *, skip: frozenset[str] = frozenset(), number_items: bool = False
) -> list[tuple[str, Value]]:
    """Return each scalar of a document with its dotted path, without the members of some names.

    The items of a list share its path; with `number_items` each has its number.
    """
    found: list[tuple[str, Value]] = []

    def walk(value: object, path: str) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                if key not in skip:
                    walk(item, f"{path}.{key}" if path else str(key))
        elif isinstance(value, list | tuple):
            for number, item in enumerate(value):
                walk(item, f"{path}.{number}" if number_items else path)
        else:
            found.append((path, value if isinstance(value, str | int | float) else None))

    walk(document, "")
    return found
