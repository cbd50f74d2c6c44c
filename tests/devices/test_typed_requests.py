"""What a person types to a simulated bench: lines that are understood, and those that are not."""

import pytest

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
from labrig.devices.simulated.typed_requests import HELP, parse_request
from labrig.errors import InputError


@pytest.mark.parametrize(
    ("line", "request_"),
    [
        ("needle N1", MountNeedle("N1")),
        ("  needle   N1 \r", MountNeedle("N1")),
        ("specimen 'gel 13 %' 13", PlaceSpecimen("gel 13 %", 13.0)),
        ("hole 2 10.5", ShiftToHole("", 1, 10.5)),
        ("board 3 9 6 4", HoldBoard(2, 3, 9, 6, 4.0)),
        ("paper 1", LayGraphPaper(1.0)),
        ("clear", ClearBench("everything")),
        ("scale linear", ReadScale("linear", "mm", "")),
        ("scale rotation", ReadScale("rotation", "deg", "")),
    ],
)
def test_a_line_is_the_request_of_labrig(line: str, request_: OperatorRequest) -> None:
    """Holes and views count from one, as labrig's questions do."""
    assert parse_request(line) == request_


@pytest.mark.parametrize(
    "line",
    ["nedle N1", "", "'", "yes", "NEEDLE N1", "\x1b[31m", "needle\x00"],
)
def test_an_unknown_line_is_told_every_known_one(line: str) -> None:
    """The hint lists them."""
    with pytest.raises(InputError, match="is not understood") as refusal:
        parse_request(line)
    assert refusal.value.hint == f"type one of: {HELP}"


@pytest.mark.parametrize(
    ("line", "usage"),
    [
        ("needle", "needle NEEDLE_ID"),
        ("needle N1 N2", "needle NEEDLE_ID"),
        ("specimen gel ten", "specimen NAME PERCENT"),
        ("specimen gel nan", "specimen NAME PERCENT"),
        ("hole 0 1", "hole NUMBER POSITION_MM"),
        ("hole 1 -1", "hole NUMBER POSITION_MM"),
        ("hole 1 1e99", "hole NUMBER POSITION_MM"),
        ("board 1 9 six 4", "board VIEW COLUMNS ROWS SQUARE_MM"),
        ("paper inf", "paper PITCH_MM"),
        ("clear all", "clear"),
        ("scale screw", "scale AXIS"),
    ],
)
def test_a_line_with_wrong_words_is_told_the_right_ones(line: str, usage: str) -> None:
    """The hint has the words of this line."""
    with pytest.raises(InputError, match="is not understood") as refusal:
        parse_request(line)
    assert refusal.value.hint == f"type {usage}"
