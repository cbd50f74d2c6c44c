"""Lines of text by which a person tells a simulated bench what they do there by hand.

Each becomes the request with which labrig asks for it, so that the simulated operator does the same in a rehearsal as
in a simulated run.
"""

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from labrig.devices.axis_description import AXES
from labrig.devices.operator import (
    ClearBench,
    HoldBoard,
    LayGraphPaper,
    MountNeedle,
    OperatorRequest,
    PlaceSpecimen,
    ReadScale,
    ShiftToHole,
)
from labrig.errors import InputError

_LARGEST = 10_000
"""Largest number in a line; a larger one is a typing error."""


@dataclass(frozen=True)
class _Line:
    """A line that is understood: the names of the words after its first one, and what makes the request of them."""

    words: str
    make: Callable[[list[str]], OperatorRequest]


def parse_request(line: str) -> OperatorRequest:
    """Return what a line asks for; a name with spaces stands in quotes, as in a shell.

    A `ShiftToHole` has no specimen: it shifts the one on the bench.

    Raises
    ------
    InputError
        When the line is not understood; the hint says what is.
    """
    try:
        first, *words = shlex.split(line)
    except ValueError:
        first, words = "", []
    known = _LINES.get(first)
    if known is None:
        raise InputError(f"{line!r} is not understood", f"type one of: {HELP}")
    try:
        if len(words) != len(known.words.split()):
            raise ValueError
        return known.make(words)
    except ValueError as error:
        raise InputError(f"{line!r} is not understood", f"type {first} {known.words}".rstrip()) from error


def _read_whole(word: str) -> int:
    """Return a whole number from 1. Raises `ValueError`."""
    number = int(word)
    if not 1 <= number <= _LARGEST:
        raise ValueError
    return number


def _read_measure(word: str) -> float:
    """Return a finite number from 0. Raises `ValueError`."""
    number = float(word)
    if not 0 <= number <= _LARGEST:
        raise ValueError
    return number


def _make_board(words: list[str]) -> HoldBoard:
    view, columns, rows = map(_read_whole, words[:3])
    return HoldBoard(view - 1, view, columns, rows, _read_measure(words[3]))


def _make_reading(words: list[str]) -> ReadScale:
    (axis,) = words
    if axis not in AXES:
        raise ValueError
    return ReadScale(axis, "deg" if axis == "rotation" else "mm", "")


_LINES: Mapping[str, _Line] = {
    "needle": _Line("NEEDLE_ID", lambda words: MountNeedle(words[0])),
    "specimen": _Line("NAME PERCENT", lambda words: PlaceSpecimen(words[0], _read_measure(words[1]))),
    "hole": _Line(
        "NUMBER POSITION_MM",
        lambda words: ShiftToHole("", _read_whole(words[0]) - 1, _read_measure(words[1])),
    ),
    "board": _Line("VIEW COLUMNS ROWS SQUARE_MM", _make_board),
    "paper": _Line("PITCH_MM", lambda words: LayGraphPaper(_read_measure(words[0]))),
    "clear": _Line("", lambda _words: ClearBench("everything")),
    "scale": _Line("AXIS", _make_reading),
}

HELP = ", ".join(f"{first} {line.words}".rstrip() for first, line in _LINES.items())
"""Every line that is understood."""
