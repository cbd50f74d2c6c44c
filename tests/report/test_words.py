"""Numbers, lists and events as text."""

import pytest

from labrig.report.event_words import describe_event
from labrig.report.formatting import (
    flatten,
    format_time,
    format_value,
    interval,
    join_words,
    label_quantity,
    number,
    signed,
)


@pytest.mark.parametrize(
    ("made", "text"),
    [
        (number(27.6), "27.60"),
        (number(-0.5, 1), "−0.5"),
        (number(None), "–"),
        (signed(0.0123), "+0.012"),
        (signed(-0.0001), "+0.000"),
        (signed(None), "–"),
        (interval((1.0, 2.5)), "1.00 to 2.50"),
        (interval(None), "–"),
        (join_words(["a", "b", "c"]), "a, b and c"),
        (join_words([]), ""),
        (label_quantity("speed_mm_s"), "speed (mm/s)"),
        (label_quantity("s.true_target_error_mm"), "true error at the target (mm)"),
        (format_time("2026-11-21T09:30:00+00:00"), "2026-11-21 09:30:00 UTC"),
        (format_value(-0.123456789), "−0.123457"),
        (format_value(None), "–"),
        (format_value(3), "3"),
    ],
)
def test_values_read_as_text(made: str, text: str) -> None:
    """Decimals stay aligned, a minus is a minus, what is unknown is a dash, and there is no negative zero."""
    assert made == text


def test_nested_documents_become_rows() -> None:
    """Keys are joined by dots, lists of numbers stay in one row, lists of sections are numbered."""
    document = {"a": {"b": 1.5, "c": [1, 2]}, "d": [{"e": True}, {"e": None}], "f": ""}
    rows = [("a.b", "1.5"), ("a.c", "1, 2"), ("d[0].e", "yes"), ("d[1].e", "–"), ("f", "–")]
    assert flatten(document) == rows


@pytest.mark.parametrize(
    ("event", "text", "level"),
    [
        ({"kind": "run_stop", "exit_status": "success", "reason": ""}, "run succeeded", "INFO"),
        ({"kind": "run_stop", "exit_status": "failed", "reason": "drive 2"}, "run failed: drive 2", "ERROR"),
        (
            {"kind": "move", "axis": "rotation", "position": 3.141592653589793, "speed": 1.0},
            "rotation moves to 180.0° at 57.3°/s",
            "DEBUG",
        ),
        (
            {"kind": "operator", "request": "ShiftToHole", "confirmed": False, "answer": "",
             "details": {"specimen": "A1", "hole": 2, "position_mm": 16.0}},
            "operator: refused “shift to hole (specimen A1, hole 3, position 16 mm)”", "WARN",
        ),
        ({"kind": "skip", "t_s": 1.0, "trial": 3}, "Trial 4 was skipped.", "WARN"),
        ({"kind": "odd_one", "t_s": 1.0, "depth_mm": 1.25, "done": True}, "odd one: depth 1.25 mm, done yes", "INFO"),
        ({"kind": "move", "axis": "linear", "note": "old line"}, "move: axis linear, note old line", "DEBUG"),
    ],
)  # fmt: skip
def test_an_event_is_a_sentence(event: dict[str, object], text: str, level: str) -> None:
    """Known kinds have words, others their fields with units, and what went wrong stands out."""
    entry = describe_event(event, {})
    assert (entry.text, entry.level) == (text, level)


def test_an_experiment_has_words_of_its_own() -> None:
    """A sentence of an experiment takes precedence."""
    assert describe_event({"kind": "flip", "by": 2}, {"flip": "bevel turns {{ by }}"}).text == "bevel turns 2"
