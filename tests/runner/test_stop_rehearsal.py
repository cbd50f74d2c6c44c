"""What a stop during each move of a trial does."""

import pytest

from labrig.devices.rig_file import load_rig
from labrig.runner.experiment import PlannedMove
from labrig.runner.stop_rehearsal import rehearse_stops
from labrig.runner.withdrawal import ReverseMove
from tests.cli.conftest import RIG

_TRIAL = (
    PlannedMove("sheath", "linear", 0.0, 15.0, 5.0),
    PlannedMove("in", "insertion", 0.0, 40.0, 2.0),
    PlannedMove("out", "insertion", 40.0, 0.0, 5.0),
    PlannedMove("sheath out", "linear", 15.0, 0.0, 5.0),
)


def test_the_way_back_is_that_of_a_withdrawal() -> None:
    """A stop on the way out has the way of its beginning, the deepest place of the move."""
    stops = rehearse_stops(_TRIAL, load_rig(RIG))
    sheath, both = (ReverseMove("linear", 0.0),), (ReverseMove("insertion", 0.0), ReverseMove("linear", 0.0))
    assert [stop.withdrawal for stop in stops] == [sheath, both, both, sheath]
    # At 1 mm/s, the speed of a withdrawal.
    assert [stop.withdrawal_s for stop in stops] == pytest.approx([15, 55, 55, 15])
    assert all(stop.in_tissue for stop in stops)


def test_an_axis_brakes_with_the_deceleration_of_its_moves() -> None:
    """It goes on by v^2 / 2a."""
    rig = load_rig(RIG)
    stop = rehearse_stops(_TRIAL, rig)[1]
    assert stop.brakes_s == pytest.approx(2.0 / rig.axes.insertion.acceleration)
    assert stop.runs_on == pytest.approx(stop.brakes_s * 2.0 / 2)
