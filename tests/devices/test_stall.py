"""A stall is the motor's whole current and an axis that lags, in two readings."""

import pytest

from labrig.devices.stall import LoadReading, StallBounds, supervise_stall

BOUNDS = StallBounds("linear", "mm", max_following_error=2.0, limit_ma=500)


def judge(*readings: tuple[float, float, float]) -> str:
    """Return the message after readings (t_s, lag, current_ma); empty without an error."""
    since_s, message = None, ""
    for reading in readings:
        since_s, error = supervise_stall(BOUNDS, since_s, LoadReading(*reading))
        message = "" if error is None else error.message
    return message


def test_a_stall_is_told_with_current_time_and_lag() -> None:
    """480 of 500 mA since the first reading, and 1.2 mm of the 2 mm at which the drive would fail."""
    assert judge((1.0, 0.9, 480.0), (1.3, 1.2, 480.0)) == (
        "the linear axis is stalled: 480 mA for 0.30 s, 1.2 mm behind"
    )


@pytest.mark.parametrize(
    "readings",
    [
        [(1.0, 1.2, 480.0)],
        [(1.0, 0.9, 480.0), (1.1, 1.2, 300.0)],
        [(1.0, 0.4, -480.0), (1.1, 0.9, -480.0)],
        [(1.0, 1.2, 480.0), (1.1, 1.2, 100.0), (1.2, 1.2, 480.0)],
    ],
    ids=["one reading", "current falls", "small lag", "current falls in between"],
)
def test_less_is_no_stall(readings: list[tuple[float, float, float]]) -> None:
    """One reading, a motor with current to spare, and an axis that follows are no stall."""
    assert judge(*readings) == ""


def test_both_directions_are_judged() -> None:
    """A withdrawal is stalled with a negative current."""
    assert "480 mA for 0.10 s, 1.5 mm behind" in judge((1.0, -1.0, -480.0), (1.1, -1.5, -480.0))


def test_a_fast_axis_is_looked_at_more_often() -> None:
    """Four times until the drive fails by its following error, but at most a hundred times a second."""
    assert BOUNDS.period_s(2.0) == pytest.approx(0.25)
    assert BOUNDS.period_s(100.0) == 0.01
