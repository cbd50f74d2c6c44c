"""Conditions of a protocol: what they mean, and what is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import FileFormatError
from labrig.protocol.conditions import Condition
from tests.runner.sessions import sweep

NUMBERS = st.floats(-1e6, 1e6)


@given(NUMBERS, NUMBERS, NUMBERS)
def test_a_condition_means_what_it_says(low: float, high: float, value: float) -> None:
    """It is met below the one limit, and above the other; at a limit it is not."""
    assert Condition(value="x", above=high).holds(value) == (value > high)
    assert Condition(value="x", below=low).holds(value) == (value < low)
    if low <= high:
        assert Condition(value="x", below=low, above=high).holds(value) == (not low <= value <= high)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{value: radius_mm}", "judged by no limit"),
        ("{value: radius_mm, above: .nan}", "finite number"),
        ("{value: radius_mm, below: 30, above: 26}", "below is 30, must be at most above, 26"),
        ("{value: radius_mm, above: 3, do: wait}", "must be 'ask' or 'stop'"),
        ("{value: raduis_mm, above: 3}", "no value is named raduis_mm did you mean radius_mm?"),
        ("{value: max_current_ma, above: 300}", "known here: radius_mm, radius_sd_mm"),
    ],
)
def test_a_condition_that_cannot_be_judged_is_refused(text: str, told: str) -> None:
    """Limits and names are checked when the protocol is loaded; the key is named."""
    with pytest.raises(FileFormatError) as refused:
        sweep(f"conditions=[{{value: radius_mm, above: 90}}, {text}]")
    (problem,) = refused.value.problems
    assert "conditions.1" in problem.where
    assert told in f"{problem.message} {problem.hint}"
