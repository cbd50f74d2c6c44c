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


def test_a_link_to_a_file_is_followed_and_a_name_with_a_nul_is_no_file(tmp_path: Path) -> None:
    """Protocols and calibrations may be links; a protocol can hold a NUL in a name."""
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "link").symlink_to("file")
    assert read_file(tmp_path / "link") == b"content"
    with pytest.raises(OSError, match="the name holds a NUL"):
        read_file(Path("a\0b"))


def test_a_file_beyond_the_limit_is_refused_unread(tmp_path: Path) -> None:
    """A sparse file of a terabyte takes neither time nor memory."""
    with (tmp_path / "large").open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(OSError, match="it has 1000000000000 bytes, at most 5 are read"):
        read_file(tmp_path / "large", 5)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        *(
            (left * levels + b"1" + right * levels, f"nested deeper than {MAX_DEPTH} levels")
            for left, right in ((b"[", b"]"), (b'{"a":', b"}"))
            for levels in (MAX_DEPTH + 1, 200_000)
        ),
        *(
            (b'{"a": %s}' % number, "is not finite")
            for number in (b"NaN", b"-Infinity", b"1e999", b"9" * 400)
        ),
    ],
)
def test_json_that_is_too_deep_or_holds_a_number_that_no_double_holds_is_refused(
    text: bytes, reason: str
) -> None:
    """However deep it is, no recursion ends the program."""
    with pytest.raises(ValueError, match=reason):
        parse_json(text)


def test_json_as_deep_as_the_limit_is_read() -> None:
    """Brackets in texts do not count."""
    value = parse_json(b"[" * MAX_DEPTH + b'"' + b"[" * 1000 + b'"' + b"]" * MAX_DEPTH)
    for _ in range(MAX_DEPTH):
        assert isinstance(value, list)
        value = value[0]
    assert value == "[" * 1000
