"""JSON as labrig records it: files of one object a line, which are appended to, and documents.

A file of lines is plain: `pandas.read_json(..., lines=True)` reads it. A process that is killed may leave a torn last
line; it was never acknowledged, and readers drop it.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from labrig.durable import append_or_restore
from labrig.errors import InputError, RecordError
from labrig.input_file import MAX_LOG_BYTES, open_file, parse_json, read_file
from labrig.record.layout import COPY_HINT


def encode_line(fields: Mapping[str, object]) -> bytes:
    """Encode one line, its newline included.

    Parameters
    ----------
    fields : Mapping
        The members of the line, in this order: numbers, text, booleans, None, dates, and lists and mappings of these;
        numpy scalars and arrays are converted. Infinite and undefined numbers become null.

    Raises
    ------
    InputError
        When it holds a value that JSON cannot hold.
    """
    plain = _to_plain(fields, "line")
    return _encode_utf8(json.dumps(plain, separators=(",", ":"), ensure_ascii=False)) + b"\n"


def decode_line(line: bytes) -> dict[str, object]:
    """Decode one line. Raises `ValueError` when it is no JSON object."""
    fields = parse_json(line)
    if not isinstance(fields, dict):
        raise ValueError("it is no JSON object")
    return make_readable(fields) if b"\\ud" in line else fields


def as_recorded(fields: Mapping[str, object]) -> dict[str, object]:
    """Return the fields as they are after a line of them is written and read. Raises as `encode_line`."""
    return decode_line(encode_line(fields))


def read_lines(path: Path) -> list[dict[str, object]]:
    """Read the lines of a file without a torn last one.

    Raises
    ------
    RecordError
        When the file cannot be read or a line is no JSON object; names file and line.
    """
    lines: list[dict[str, object]] = []
    for number, line in enumerate(split_whole_lines(path), start=1):
        try:
            lines.append(decode_line(line))
        except ValueError as error:
            raise RecordError(f"{path}:{number}: the line is damaged: {error}", COPY_HINT) from error
    return lines


def split_whole_lines(path: Path) -> list[bytes]:
    """Return the lines of a file without what stands behind the last newline. Raises `RecordError`."""
    try:
        return read_file(path, MAX_LOG_BYTES).split(b"\n")[:-1]
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", "the record is not whole") from error


class LineFile:
    """A file of lines that is open for appending, and whole after every call, whatever stops the process.

    Lines go to the kernel with `os.write`, unbuffered, so that SIGKILL loses no line that `append` has written.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self._descriptor = descriptor
        self._length = 0
        self._sha256 = hashlib.sha256()
        self._unsynced = True

    @classmethod
    def create(cls, path: Path) -> Self:
        """Create the file. Raises `OSError` if it exists."""
        return cls(path, os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666))

    @classmethod
    def reopen(cls, path: Path) -> Self:
        """Open a file for appending, and cut off a torn last line. Raises `OSError` if it is a link or missing."""
        file = cls(path, os.open(path, os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW))
        with open_file(path) as written:
            content = written.read()
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            os.ftruncate(file._descriptor, len(whole))
        file._length = len(whole)
        file._sha256.update(whole)
        return file

    @property
    def sha256(self) -> str:
        """The SHA-256 of all lines so far, in hexadecimal digits."""
        return self._sha256.hexdigest()

    def append(self, lines: bytes) -> None:
        """Append encoded lines, or nothing of them on a full disk."""
        try:
            append_or_restore(self._descriptor, lines, self._length)
        finally:
            # Afterwards: a sync that began before has not seen the lines.
            self._unsynced = True
        self._length += len(lines)
        self._sha256.update(lines)

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


def encode_document(fields: Mapping[str, object]) -> bytes:
    """Encode a JSON file for people and programs: indented, in UTF-8, infinite and undefined numbers as null.

    Raises
    ------
    InputError
        When it holds a value that JSON cannot hold.
    """
    text = json.dumps(_to_plain(fields, "document"), indent=2, ensure_ascii=False, allow_nan=False)
    return _encode_utf8(text) + b"\n"


def make_readable(fields: Mapping[str, object]) -> dict[str, object]:
    """Return a document of JSON with texts that UTF-8 can hold."""
    return {plain_text(key): _make_readable(value) for key, value in fields.items()}


def _make_readable(value: object) -> object:
    match value:
        case str():
            return plain_text(value)
        case dict():
            return make_readable(value)
        case list():
            return [_make_readable(item) for item in value]
    return value


def plain_text(text: str) -> str:
    """Return a text that UTF-8 can hold: lone surrogates become their escapes."""
    return _encode_utf8(text).decode()


def _encode_utf8(text: str) -> bytes:
    # A lone surrogate stands for a byte of a file name that is not UTF-8. Its backslash escape is valid JSON.
    return text.encode("utf-8", "backslashreplace")


def _to_plain(value: object, where: str) -> object:
    """Return the value in types of JSON."""
    match value:
        case float():
            return value if math.isfinite(value) else None
        case None | bool() | str() | int():
            return value
        case dict() | Mapping():
            return {
                _require_key(key, where): _to_plain(item, f"{where}.{key}") for key, item in value.items()
            }
        case list() | tuple():
            return [_to_plain(item, where) for item in value]
        case datetime(tzinfo=zone) if zone is not None:
            return value.astimezone(UTC).isoformat(timespec="seconds")
        case _ if callable(to_plain := getattr(value, "tolist", None)):  # numpy's scalars and arrays
            return _to_plain(to_plain(), where)
    raise InputError(f"{where} cannot be written as JSON: {value!r} is a {type(value).__name__}")


def _require_key(key: object, where: str) -> str:
    if isinstance(key, str):
        return key
    raise InputError(f"{where} cannot be written as JSON: its key {key!r} is a {type(key).__name__}")
