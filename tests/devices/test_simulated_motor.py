"""The current of a simulated motor: friction and load, lag, and the limit of the drive."""

import math

import pytest

from labrig.devices.simulated.shaft import torque_of_force
from tests.devices.rigs import ready_rig


def test_a_force_makes_a_torque_by_lead_and_gear() -> None:
    """10 N on a lead of 2 mm behind a gear of 4: 10 x 2 / (2 pi 4) mNm."""
    assert torque_of_force(10.0, 2.0, 4.0) == pytest.approx(20 / (8 * math.pi))


def test_a_blocked_drive_shows_its_current_and_an_uncoupled_one_none() -> None:
    """What holds the shaft is felt; a motor that has lost its shaft only lags."""
    with ready_rig() as opened:
        for name in ("insertion", "linear"):
            opened.rig.axis(name).start_move(20.0, 5.0)
        opened.rig.wait(0.5)
        opened.drives["insertion"].shaft.jam()
        opened.drives["linear"].shaft.uncouple()
        opened.hardware.clock.sleep(0.05)
        currents = [opened.drives[name]._read_current_ma() for name in ("insertion", "linear")]
        assert currents[0] > 1000
        assert currents[1] == 0.0
