"""The current of a simulated motor: friction and load, lag, and the limit of the drive."""

import math

import pytest

from labrig.devices.simulated.shaft import Motor, torque_of_force
from tests.devices.rigs import opened_rig


def test_a_motor_carries_its_friction_and_its_load_in_its_direction() -> None:
    """(1.5 + 0.5) mNm over 25 mNm/A are 80 mA; at rest without lag there is no current."""
    motor = Motor(load_mnm=lambda: 0.5)
    assert [motor.current_ma(speed, 0.0, 1000) for speed in (3.0, -3.0, 0.0)] == [80.0, -80.0, 0.0]


def test_a_lag_adds_current_up_to_the_limit() -> None:
    """A tenth of a turn of lag adds 400 mA to 60 mA of friction; half a turn reaches the limit."""
    motor = Motor()
    assert motor.current_ma(0.0, 0.1, 1000) == pytest.approx(460.0)
    assert motor.current_ma(0.0, -0.5, 1000) == -1000


def test_a_force_makes_a_torque_by_lead_and_gear() -> None:
    """10 N on a lead of 2 mm behind a gear of 4: 10 x 2 / (2 pi 4) mNm."""
    assert torque_of_force(10.0, 2.0, 4.0) == pytest.approx(20 / (8 * math.pi))


def test_a_blocked_drive_shows_its_current_and_an_uncoupled_one_none() -> None:
    """What holds the shaft is felt; a motor that has lost its shaft only lags."""
    with opened_rig() as opened:
        opened.rig.connect()
        opened.rig.reference_axes()
        for name in ("insertion", "linear"):
            opened.rig.axis(name).start_move(20.0, 5.0)
        opened.rig.wait(0.5)
        opened.drives["insertion"].block()
        opened.drives["linear"].uncouple()
        opened.hardware.clock.sleep(0.05)
        currents = [opened.drives[name]._read_current_ma() for name in ("insertion", "linear")]
        assert currents[0] > 1000
        assert currents[1] == 0.0
