"""JSON with checksums: lines that carry the CRC-32 of their content, and documents without NaN.

A line is one compact JSON object in UTF-8, its last member `"crc32":"xxxxxxxx"` being the CRC-32 (the one of
zlib and PNG, ISO 3309) of the bytes of the object without that member. CRC-32 finds every single flipped bit
and every burst of up to 32 bits.
"""

import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import NoneType
from typing import TypeVar

from labrig.errors import InputError, Problem, RecordError
from labrig.input_file import MAX_LOG_BYTES, parse_json, read_file

_Read = TypeVar("_Read")

_COPY = "take this file from a copy of the run; labrig never rewrites it"
_CRC_KEY = "crc32"
_COMPACT = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)
_PLAIN = frozenset({str, int, bool, NoneType})
_LONE = b"\\ud"
_TAIL_LENGTH = len(',"crc32":"00000000"}')


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
        When it is empty, has a field `crc32`, or holds a value that JSON cannot hold.
    """
    body = _encode_compact(_to_plain(_require_fields(fields), "line"))
    return b'%s,"crc32":"%08x"}\n' % (body[:-1], zlib.crc32(body))


def decode_line(line: bytes) -> dict[str, object]:
    """Decode one line, given without its newline.

    Raises
    ------
    ValueError
        When the checksum does not fit or the content is no JSON object.
    """
    body = _read_body(line)
    fields = parse_json(body)
    if not isinstance(fields, dict):
        raise ValueError("it is no JSON object")
    return fields


def decode_lines(lines: Sequence[bytes]) -> list[dict[str, object] | None]:
    """Decode lines as `decode_line`, together, which is faster; None for each that is damaged."""
    bodies = [_read_body_or_none(line) for line in lines]
    whole = [body for body in bodies if body is not None]
    try:
        values = parse_json(b"[%s]" % b",".join(whole))
    except ValueError:
        values = None
    if not isinstance(values, list) or len(values) != len(whole):  # one is no JSON, or several
        return [_decode_or_none(line) for line in lines]
    decoded = iter(values)
    fields = [None if body is None else next(decoded) for body in bodies]
    return [value if isinstance(value, dict) else None for value in fields]


def _read_body_or_none(line: bytes) -> bytes | None:
    try:
        return _read_body(line)
    except ValueError:
        return None


def _decode_or_none(line: bytes) -> dict[str, object] | None:
    try:
        return decode_line(line)
    except ValueError:
        return None


def as_recorded(fields: Mapping[str, object]) -> dict[str, object]:
    """Return the fields as they are after a line of them is written and read. Raises as `encode_line`."""
    return decode_line(encode_line(fields).rstrip(b"\n"))


def check_lines(path: Path) -> tuple[Problem, ...]:
    """Check the CRC-32 of every line of a file.

    Returns
    -------
    tuple of Problem
        The torn last line, if there is one.

    Raises
    ------
    RecordError
        When a line is damaged; names file and line.
    """
    lines, problems = _split_lines(path)
    for number, line in enumerate(lines, start=1):
        _read_located(path, number, line, _read_body)
    return problems


def read_lines(path: Path) -> list[dict[str, object]]:
    """Read the lines of a file without a torn last line, which `check_lines` reports.

    Raises
    ------
    RecordError
        When a line is damaged; names file and line.
    """
    lines, _ = _split_lines(path)
    return [_read_located(path, number, line, _read_fields) for number, line in enumerate(lines, start=1)]


@dataclass(frozen=True)
class Scan:
    """Everything that can be read of a file of lines, damaged or not.

    Attributes
    ----------
    lines : tuple of (int, dict)
        The whole lines with their numbers, from 1.
    damaged, torn : tuple of Problem
        The lines whose checksum does not fit, and the torn last line, if there is one.
    whole_bytes : int
        Length of the file without its torn end.
    ends_with_newline : bool
        Whether the last whole line has its newline; that byte alone may be lost.
    """

    lines: tuple[tuple[int, dict[str, object]], ...]
    damaged: tuple[Problem, ...]
    torn: tuple[Problem, ...]
    whole_bytes: int
    ends_with_newline: bool


def scan_lines(path: Path) -> Scan:
    """Read the lines of a file, skipping damaged ones.

    Raises
    ------
    RecordError
        When the file cannot be read.
    """
    whole, torn = _split_lines(path)
    lines: list[tuple[int, dict[str, object]]] = []
    damaged: list[Problem] = []
    for number, line in enumerate(whole, start=1):
        try:
            lines.append((number, _read_fields(line)))
        except ValueError as error:
            message = f"the line is damaged, its content lost: {error}"
            damaged.append(Problem(f"{path.name}:{number}", message, _COPY))
    content = read_file(path, MAX_LOG_BYTES)
    return Scan(
        tuple(lines),
        tuple(damaged),
        torn,
        whole_bytes=content.rfind(b"\n") + 1 if torn else len(content),
        ends_with_newline=bool(torn) or not content or content.endswith(b"\n"),
    )


def encode_document(fields: Mapping[str, object]) -> bytes:
    """Encode a JSON file for people and programs: indented, in UTF-8, infinite and undefined numbers as null.

    Raises
    ------
    InputError
        When it holds a value that JSON cannot hold.
    """
    text = json.dumps(_to_plain(fields, "document"), indent=2, ensure_ascii=False, allow_nan=False)
    return _encode_utf8(text) + b"\n"


def checksum(fields: Mapping[str, object]) -> str:
    """Return the CRC-32 of a document's content as 8 hexadecimal digits; its layout does not matter."""
    return f"{zlib.crc32(_encode_compact(_to_plain(fields, 'document'))):08x}"


def _read_fields(line: bytes) -> dict[str, object]:
    """Decode a line; names of files that are not UTF-8, which earlier versions recorded, become readable."""
    fields = decode_line(line)
    return make_readable(fields) if _LONE in line else fields


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


def _require_fields(fields: Mapping[str, object]) -> Mapping[str, object]:
    if not fields or _CRC_KEY in fields:
        raise InputError(f"a line needs at least one field, and none named {_CRC_KEY!r}; got {list(fields)}")
    return fields


def _read_body(line: bytes) -> bytes:
    """Return the object without its checksum, which is verified."""
    body = line[:-_TAIL_LENGTH] + b"}"
    if line[-_TAIL_LENGTH:] != b',"crc32":"%08x"}' % zlib.crc32(body):
        raise ValueError("its CRC-32 does not fit its content")
    return body


def _split_lines(path: Path) -> tuple[list[bytes], tuple[Problem, ...]]:
    """Split a file into lines. The text behind the last newline is kept if its checksum fits; else it is torn."""
    try:
        *lines, rest = read_file(path, MAX_LOG_BYTES).split(b"\n")
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", "the record is not whole") from error
    if not rest:
        return lines, ()
    try:
        _read_body(rest)
    except ValueError:
        where = f"{path.name}:{len(lines) + 1}"
        hint = "the writer was stopped while it wrote this line; everything before it is whole"
        return lines, (Problem(where, f"the last line is torn; its {len(rest)} bytes are left out", hint),)
    return [*lines, rest], ()


def _read_located(path: Path, number: int, line: bytes, reading: Callable[[bytes], _Read]) -> _Read:
    """Read a line; an error names its file and number."""
    try:
        return reading(line)
    except ValueError as error:
        raise RecordError(f"{path}:{number}: the line is damaged: {error}", _COPY) from error


def _encode_compact(value: object) -> bytes:
    return _encode_utf8(_COMPACT.encode(value))


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
            # Most items need no second look: the fields of a line are numbers and words.
            return {
                _require_key(key, where): item
                if (kind := type(item)) in _PLAIN or (kind is float and math.isfinite(item))
                else _to_plain(item, f"{where}.{key}")
                for key, item in value.items()
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
