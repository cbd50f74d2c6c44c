"""Lines that are typed while a program is busy."""

import os
from collections.abc import Iterator

import pytest

from labrig.cli.typed_lines import TypedLines


@pytest.fixture(name="typing")
def _typing() -> Iterator[tuple[TypedLines, int]]:
    """Return what takes the lines, and the descriptor of the keyboard."""
    screen, keyboard = os.pipe()
    with os.fdopen(screen, "r", encoding="utf-8") as stream:
        yield TypedLines(stream), keyboard


def test_nothing_typed_is_no_line(typing: tuple[TypedLines, int]) -> None:
    """The call returns at once."""
    lines, keyboard = typing
    assert lines.take() == []
    os.close(keyboard)


def test_every_finished_line_is_taken_once(typing: tuple[TypedLines, int]) -> None:
    """A line that has no end yet waits for it; blank lines are left out."""
    lines, keyboard = typing
    os.write(keyboard, b"needle N1\n\n  \r\nhole 1 0\nspeci")
    assert lines.take() == ["needle N1", "hole 1 0"]
    assert lines.take() == []
    os.write(keyboard, b"men gel 13\n")
    assert lines.take() == ["specimen gel 13"]
    os.close(keyboard)


def test_the_end_of_input_is_no_line_and_no_error(typing: tuple[TypedLines, int]) -> None:
    """A program without a keyboard goes on."""
    lines, keyboard = typing
    os.close(keyboard)
    assert [lines.take(), lines.take()] == [[], []]


def test_bytes_that_are_no_text_are_a_line(typing: tuple[TypedLines, int]) -> None:
    """They are replaced, and whoever reads the line refuses it."""
    lines, keyboard = typing
    os.write(keyboard, b"\xff\xfe\n")
    assert lines.take() == ["\ufffd\ufffd"]
    os.close(keyboard)


def test_a_terminal_that_goes_is_no_error() -> None:
    """Its program goes on."""
    keyboard, screen = os.openpty()
    with os.fdopen(screen, "r", encoding="utf-8") as stream:
        lines = TypedLines(stream)
        os.write(keyboard, b"clear\n")
        assert lines.take() == ["clear"]
        os.close(keyboard)
        assert [lines.take(), lines.take()] == [[], []]
