"""Text of numbers and lists on the pages."""

from labrig.report.formatting import (
    flatten,
    format_time,
    format_value,
    interval,
    join_words,
    number,
    signed,
)
from labrig.text import format_count


def test_numbers_keep_their_digits_and_have_a_true_minus() -> None:
    """Decimals stay aligned, and what is unknown is a dash."""
    assert (number(27.6), number(-0.5, 1), number(None)) == ("27.60", "−0.5", "–")


def test_a_difference_shows_its_sign_unless_it_rounds_to_zero() -> None:
    """There is no negative zero."""
    assert (signed(0.0123), signed(-0.0123), signed(-0.0001), signed(None)) == (
        "+0.012",
        "−0.012",
        "+0.000",
        "–",
    )


def test_intervals_and_counts_read_as_text() -> None:
    """Both ends with the same digits; one insertion, two insertions."""
    assert (interval((1.0, 2.5)), interval(None)) == ("1.00 to 2.50", "–")
    assert (format_count(1, "gel"), format_count(0, "gel")) == ("1 gel", "0 gels")
    assert (join_words(["a", "b", "c"]), join_words(["a"]), join_words([])) == ("a, b and c", "a", "")


def test_nested_documents_become_rows() -> None:
    """Keys are joined by dots, lists of numbers stay in one row, lists of sections are numbered."""
    document = {"a": {"b": 1.5, "c": [1, 2]}, "d": [{"e": True}, {"e": None}], "f": ""}
    assert flatten(document) == [
        ("a.b", "1.5"),
        ("a.c", "1, 2"),
        ("d[0].e", "yes"),
        ("d[1].e", "–"),
        ("f", "–"),
    ]


def test_times_and_values_are_readable() -> None:
    """A recorded time loses its T and says UTC; a float has six digits."""
    assert format_time("2026-11-21T09:30:00+00:00") == "2026-11-21 09:30:00 UTC"
    assert (format_value(-0.123456789), format_value(None), format_value(3)) == ("−0.123457", "–", "3")
