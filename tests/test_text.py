"""Rounding of numbers in messages."""

from hypothesis import given
from hypothesis import strategies as st

from labrig.text import round_down, round_up


@given(st.floats(0.0, 34.999999))
def test_what_is_below_a_limit_never_reads_as_the_limit(percent: float) -> None:
    """34.999 of 35 is printed as 34.9."""
    assert float(round_down(percent, 1)) < 35.0


@given(st.floats(1.000001, 1e6))
def test_what_is_above_a_limit_never_reads_as_the_limit(value_px: float) -> None:
    """1.001 of 1 is printed as 1.01."""
    assert float(round_up(value_px, 2)) > 1.0
