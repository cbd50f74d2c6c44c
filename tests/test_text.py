"""Rounding of numbers in messages."""

from hypothesis import given
from hypothesis import strategies as st

from labrig.text import round_down, round_up


@given(below=st.floats(0.0, 34.999999), above=st.floats(1.000001, 1e6))
def test_what_is_beside_a_limit_never_reads_as_the_limit(below: float, above: float) -> None:
    """34.999 of 35 is printed as 34.9, and 1.001 of 1 as 1.01."""
    assert float(round_down(below, 1)) < 35.0
    assert float(round_up(above, 2)) > 1.0
