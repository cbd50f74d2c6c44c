"""Text of numbers and lists on the pages."""

import pytest

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
