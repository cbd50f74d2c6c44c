"""Lines that carry their checksum."""

import json
import zlib
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError, RecordError
from labrig.record.json_lines import (
    check_lines,
    decode_line,
    decode_lines,
    encode_document,
    encode_line,
    read_lines,
)

# Any text that Python can hold: lone surrogates stand for file names that are no UTF-8.
TEXTS = st.text(st.characters(exclude_categories=()), max_size=12)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=6,
)
FIELDS = st.dictionaries(TEXTS.filter(lambda key: key != "crc32"), VALUES, min_size=1, max_size=5)


@given(FIELDS)
def test_a_line_gives_back_what_was_said(fields: dict[str, object]) -> None:
    """Every JSON value, in its order, survives one line of bytes without a newline inside."""
    line = encode_line(fields)
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    decoded = decode_line(line[:-1])
    assert decoded == fields
    assert list(decoded) == list(fields)


def crc_line(body: bytes) -> bytes:
    """Return a line whose checksum fits, whatever it holds."""
    return b'%s,"crc32":"%08x"}' % (body[:-1], zlib.crc32(body))


_DAMAGED = (b"", b"{}", b'{"a":1,"crc32":"00000000"}', crc_line(b'{"a":1},{"b":2}'), crc_line(b'{"a":}'))


@given(st.lists(FIELDS.map(lambda fields: encode_line(fields)[:-1]) | st.sampled_from(_DAMAGED), max_size=6))
def test_lines_that_are_decoded_together_are_those_decoded_alone(lines: list[bytes]) -> None:
    """A damaged one, or one that would be taken for two, changes none of the others."""
    for line, fields in zip(lines, decode_lines(lines), strict=True):
        try:
            assert fields == decode_line(line)
        except ValueError:
            assert fields is None


@given(FIELDS, st.data())
def test_no_flipped_bit_passes(fields: dict[str, object], data: st.DataObject) -> None:
    """A line with one flipped bit is refused, wherever the bit is."""
    line = bytearray(encode_line(fields)[:-1])
    bit = data.draw(st.integers(0, 8 * len(line) - 1))
    line[bit // 8] ^= 1 << bit % 8
    with pytest.raises(ValueError, match="CRC-32"):
        decode_line(bytes(line))


def test_the_checksum_is_that_of_the_object_without_it() -> None:
    """Any JSON and CRC-32 library can check a line."""
    line = json.loads(encode_line({"kind": "operator", "note": "Prüfung"}))
    checksum = line.pop("crc32")
    body = json.dumps(line, separators=(",", ":"), ensure_ascii=False).encode()
    assert checksum == f"{zlib.crc32(body):08x}"


def test_numpy_values_become_plain_ones() -> None:
    """Scalars and arrays of numpy are written as numbers and lists of numbers."""
    line = encode_line({"a": np.float32(0.5), "b": np.int64(3), "c": np.eye(2), "d": (np.bool_(1),)})
    assert decode_line(line[:-1]) == {"a": 0.5, "b": 3, "c": [[1.0, 0.0], [0.0, 1.0]], "d": [True]}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -np.inf, np.float32("nan")])
def test_what_is_no_number_is_null(value: float) -> None:
    """NaN and infinity, which JSON does not know, are written as null, in lists too."""
    assert decode_line(encode_line({"x": value, "y": [value, 1.0]})[:-1]) == {"x": None, "y": [None, 1.0]}
    assert json.loads(encode_document({"x": value})) == {"x": None}


@pytest.mark.parametrize(
    "fields", [{"x": {1, 2}}, {"x": {1: 2}}, {"x": Path("a")}, {"x": 1j}, {}, {"crc32": "0"}]
)
def test_what_json_cannot_say_is_refused(fields: dict[str, object]) -> None:
    """Sets, numbered keys, an empty line and a second checksum are refused before anything is written."""
    with pytest.raises(InputError):
        encode_line(fields)


def test_a_date_needs_its_zone() -> None:
    """A date without a time zone is refused: nobody could say later when it was."""
    with pytest.raises(InputError, match="datetime"):
        encode_line({"ended": datetime(2026, 3, 2)})


def test_a_file_cut_at_any_byte_keeps_its_whole_lines(tmp_path: Path) -> None:
    """Every cut is read: the whole lines are there, a rest of a line is reported, and nothing else is."""
    content = b"".join(encode_line({"n": number, "text": "ü"}) for number in range(4))
    path = tmp_path / "events.jsonl"
    for length in range(len(content) + 1):
        path.write_bytes(content[:length])
        rows = read_lines(path)
        # A last line that lacks only its newline is whole.
        ends = [end for end, byte in enumerate(content) if byte == ord("\n")]
        assert [row["n"] for row in rows] == list(range(sum(end <= length for end in ends)))
        torn = length > 0 and length not in ends and content[length - 1 : length] != b"\n"
        assert [problem.where for problem in check_lines(path)] == [f"events.jsonl:{len(rows) + 1}"] * torn


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    """A line that is damaged before the end is refused with its file and number."""
    path = tmp_path / "states.jsonl"
    lines = [encode_line({"n": number}) for number in range(3)]
    path.write_bytes(lines[0] + lines[1].replace(b"1", b"2", 1) + lines[2])
    for reading in (check_lines, read_lines):
        with pytest.raises(RecordError, match=r"states\.jsonl:2: the line is damaged: its CRC-32"):
            reading(path)


def test_a_line_that_is_no_object_is_named(tmp_path: Path) -> None:
    """A foreign line whose checksum holds is still refused when it is no JSON object."""
    body = b'["a"}'
    path = tmp_path / "events.jsonl"
    path.write_bytes(b'%s,"crc32":"%08x"}\n' % (body[:-1], zlib.crc32(body)))
    with pytest.raises(RecordError, match=r"events\.jsonl:1"):
        read_lines(path)
