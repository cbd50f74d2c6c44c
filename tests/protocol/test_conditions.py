"""Conditions of a protocol: what they mean, and what is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import FileFormatError
from labrig.protocol.conditions import parse_condition
from labrig.protocol.sections import JudgedProtocol
from tests.runner.sessions import sweep

NUMBERS = st.floats(-1e6, 1e6)


@given(NUMBERS, NUMBERS, NUMBERS)
def test_a_condition_means_what_it_says(low: float, high: float, value: float) -> None:
    """Each form holds where its comparison does."""
    meant = {f"x > {low!r}": value > low, f" x<{low!r} ": value < low}
    if low < high:
        meant |= {
            f"x outside [{low!r}, {high!r}]": not low <= value <= high,
            f"x inside [{low!r},{high!r}]": low <= value <= high,
        }
    for text, holds in meant.items():
        condition = parse_condition(text, "ask_when")
        assert (condition.name, condition.holds(value)) == ("x", holds)


@given(st.text(alphabet="xyz_<>[], .0123456789+-einf outside inside", max_size=40))
def test_any_other_text_is_refused(text: str) -> None:
    """A text is a condition on finite numbers, or is refused; nothing else happens."""
    try:
        condition = parse_condition(text, "stop_when")
    except ValueError:
        return
    assert condition.low < condition.high


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("radius_mm = 3", "is not a condition, expected NAME > 3"),
        ("radius_mm > nan", "is not a condition"),
        ("radius_mm > 1e999", "not finite"),
        ("radius_mm outside [30, 26]", "30 must be below 26"),
        ("radius_mm outside [26, 30], hysteresis 3", "is not a condition"),
        ("raduis_mm > 3", "did you mean radius_mm?"),
        ("max_current_ma > 300", "guarded by the rig file's limits: axes.*.max_current_ma"),
        ("insertion_mm > 30", "guarded by the rig file's limits: axes.*.limits"),
        ("__import__('os') > 3", "is not a condition"),
    ],
)
def test_a_condition_that_cannot_be_judged_is_refused(text: str, told: str) -> None:
    """Form, numbers and names are checked when the protocol is loaded; the key and the known values are named."""
    with pytest.raises(FileFormatError) as refused:
        sweep(f'stop_when=["radius_mm > 90", "{text}"]')
    (problem,) = refused.value.problems
    assert "stop_when.1" in problem.where
    assert told in f"{problem.message} {problem.hint}"
    assert "radius_sd_mm, its standard deviation" in problem.hint


def test_a_single_condition_needs_no_list() -> None:
    """It is the list of that one."""
    alone, listed = (sweep(f"stop_when={text}") for text in ("radius_mm > 35", '["radius_mm > 35"]'))
    for protocol in (alone, listed):
        assert isinstance(protocol, JudgedProtocol)
        assert protocol.stop_when == ("radius_mm > 35",)
