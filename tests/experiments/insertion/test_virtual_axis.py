"""Where the insertion axis stands when a virtual insertion looks at it."""

from pathlib import Path

import pytest

from labrig.devices.rig_file import load_rig
from labrig.experiments.insertion.virtual_axis import VirtualAxis

RIG = Path(__file__).parents[3] / "calibration" / "rig-simulated.yaml"


def make_axis() -> VirtualAxis:
    """Return the insertion axis of the simulated rig, which is read ten times a second."""
    return VirtualAxis(load_rig(RIG).axes.insertion, 0.1)


def test_a_picture_is_taken_at_the_first_reading_beyond_its_depth() -> None:
    """At 1 mm/s from rest the readings lie a ramp of 0.01 mm behind every 0.1 mm, as in records of the whole rig."""
    axis = make_axis()
    assert axis.pass_depth(0.991, 17.84, 1.0) == pytest.approx(1.09, abs=1e-9)
    assert axis.pass_depth(2.08, 17.84, 1.0) == pytest.approx(2.09, abs=1e-9)


def test_an_axis_that_moves_goes_on_to_a_new_end_without_a_stop() -> None:
    """A later end costs no ramp; at its end the axis stands, in whole counts of 0.25 micrometres."""
    axis = make_axis()
    axis.pass_depth(0.991, 17.84, 1.0)
    assert axis.pass_depth(2.08, 5.30001, 1.0) == pytest.approx(2.09, abs=1e-9)
    assert axis.pass_depth(5.30001, 5.30001, 1.0) == 5.3
    assert axis.pass_depth(6.2, 9.0, 1.0) == pytest.approx(6.29, abs=1e-9)


def test_a_withdrawn_axis_starts_again_from_rest() -> None:
    """Where the needle was withdrawn to, it stands, and then moves on."""
    axis = make_axis()
    axis.pass_depth(0.991, 17.84, 1.0)
    axis.stand_at(0.5)
    assert axis.position_mm == 0.5
    assert axis.pass_depth(0.55, 17.84, 1.0) == pytest.approx(0.59, abs=1e-9)
