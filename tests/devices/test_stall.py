"""A stall is the motor's whole current and an axis that lags, in two readings."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from labrig.devices.axis import Axis
from labrig.devices.position_supervision import InMotion
from labrig.devices.stall import StallWatch
from labrig.devices.trapezoid import make_rest_profile
from labrig.errors import ForceGuardError
from tests.devices.rigs import epos2_axis, one_drive


@contextmanager
def watched(speed: float = 1.0) -> Iterator[StallWatch]:
    """Yield the watch on an axis in motion that may lag by 2 mm, with a limit of 500 mA."""
    with one_drive() as bench:
        axis = Axis("linear", epos2_axis(max_following_error=2.0), bench.driver, bench.clock)
        axis.expected = InMotion(make_rest_profile(0.0, 0.0), 0.0, speed=speed)
        yield StallWatch(axis, 500)


def judge(*readings: tuple[float, float, float]) -> str:
    """Return the message after readings (t_s, lag, current_ma); empty without an error."""
    with watched() as watch:
        try:
            for reading in readings:
                watch.judge(*reading)
        except ForceGuardError as error:
            assert reading is readings[-1]
            return error.message
    return ""


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


def test_a_fast_axis_is_looked_at_more_often() -> None:
    """Four times until the drive fails by its following error, but at most a hundred times a second."""
    for speed, period_s in ((2.0, 0.25), (100.0, 0.01)):
        with watched(speed) as watch:
            assert watch.period_s == pytest.approx(period_s)
