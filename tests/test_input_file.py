"""What labrig takes from a file: regular files of bounded size, JSON of bounded depth."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from labrig.input_file import MAX_DEPTH, open_file, parse_json, read_file


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as end:
        end.bind(os.path.relpath(path))


_NONE = "it is no regular file, but a pipe, a device or a socket"


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (os.mkfifo, _NONE),
        (lambda path: path.symlink_to("/dev/zero"), _NONE),
        (_socket, _NONE),
        (lambda path: path.symlink_to("nowhere"), "No such file or directory"),
        (Path.mkdir, "Is a directory"),
    ],
)
def test_anything_but_a_regular_file_is_refused_at_once(
    make: Callable[[Path], None], reason: str, tmp_path: Path
) -> None:
    """A named pipe is not waited for, and a device is not read; the error says what it is."""
    path = tmp_path / "input"
    make(path)
    for read in (open_file, read_file):
        with pytest.raises(OSError, match=reason) as caught:
            read(path)
        assert caught.value.strerror == reason


def test_a_link_to_a_file_is_followed(tmp_path: Path) -> None:
    """Protocols and calibrations may be links; only a record has none."""
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "link").symlink_to("file")
    assert read_file(tmp_path / "link") == b"content"


def test_a_file_beyond_the_limit_is_refused_unread(tmp_path: Path) -> None:
    """A sparse file of a terabyte takes neither time nor memory."""
    with (tmp_path / "large").open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(OSError, match="it has 1000000000000 bytes, at most 5 are read"):
        read_file(tmp_path / "large", 5)


def test_a_name_with_a_nul_is_no_file() -> None:
    """A protocol can hold such a name; no system can."""
    with pytest.raises(OSError, match="the name holds a NUL"):
        read_file(Path("a\0b"))


@pytest.mark.parametrize("levels", [MAX_DEPTH + 1, 500, 200_000])
@pytest.mark.parametrize(("left", "right"), [(b"[", b"]"), (b'{"a":', b"}")])
def test_json_deeper_than_the_limit_is_refused(left: bytes, right: bytes, levels: int) -> None:
    """However deep it is, no recursion ends the program."""
    with pytest.raises(ValueError, match=f"nested deeper than {MAX_DEPTH} levels"):
        parse_json(left * levels + b"1" + right * levels)


def test_json_as_deep_as_the_limit_is_read() -> None:
    """Brackets in texts do not count."""
    value = parse_json(b"[" * MAX_DEPTH + b'"' + b"[" * 1000 + b'"' + b"]" * MAX_DEPTH)
    for _ in range(MAX_DEPTH):
        assert isinstance(value, list)
        value = value[0]
    assert value == "[" * 1000


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e999", "9" * 400])
def test_a_number_that_is_not_finite_is_no_json(number: str) -> None:
    """No double holds it, so nothing could be computed from it."""
    with pytest.raises(ValueError, match="is not finite"):
        parse_json(f'{{"a": {number}}}'.encode())
