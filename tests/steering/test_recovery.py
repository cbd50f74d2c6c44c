"""A needle that is blocked, or would miss, goes on from a place that it has passed."""

from dataclasses import replace

import numpy as np
import pytest

from labrig.errors import InputError
from labrig.steering.cavities import start_belief
from labrig.steering.planner import plan_path
from labrig.steering.problem import PlanProblem
from labrig.steering.recovery import (
    PassedPlace,
    RecoverySettings,
    find_cavities,
    list_places_back,
    widen_belief,
)
from labrig.steering.tip import EstimatorSettings
from tests.benchmarks import recovery

SETTINGS = RecoverySettings(3, 5.0, 4.0, 1.0)
BELIEF = start_belief(np.eye(4), EstimatorSettings(27.6, 0.2, 0.005, planar=True))


def passed(*cavity: tuple[float, float]) -> tuple[PassedPlace, ...]:
    """Return a place every millimetre of sixty; from and to where the tip seemed to be in a cavity."""
    return tuple(
        PassedPlace(at_mm, replace(BELIEF, cavity=float(any(a <= at_mm <= b for a, b in cavity))), ())
        for at_mm in np.arange(61.0).tolist()
    )


def test_a_blocked_needle_recovers() -> None:
    """With two cavities on its way a needle has no path past an obstacle; allowed to recover, it arrives."""
    missed, arrived = (recovery.insert(11, recovers=recovers) for recovers in (False, True))
    assert (missed.stop, missed.retreats) == ("blocked", 0)
    assert missed.error_mm > 10.0
    assert arrived.stop == "target_reached"
    assert 1 <= arrived.retreats <= SETTINGS.most_attempts
    assert arrived.error_mm < 2.0
    assert arrived.clearance_mm > 0.0


def test_places_lie_back_far_enough_and_where_the_needle_steers() -> None:
    """None is nearer than `back_mm`, in an unfit stretch, or so near the entry that no cut is left to follow."""
    places = [place.insertion_mm for place in list_places_back(passed(), ((20.0, 30.0),), 60.0, SETTINGS)]
    assert places[0] == 55.0
    assert places == sorted(places, reverse=True)
    assert not any(20.0 <= at_mm <= 30.0 for at_mm in places)
    assert min(places) >= SETTINGS.leaves_track_mm + 1.0


def test_a_cavity_is_taken_to_begin_before_it_was_noticed() -> None:
    """Stretches of one cavity are joined, and each begins and ends before the estimate says so."""
    assert find_cavities(passed((20.0, 26.0), (29.0, 31.0), (50.0, 52.0))) == ((13.0, 29.0), (43.0, 50.0))
    assert find_cavities(passed()) == ()


def test_the_heading_is_less_certain_where_the_needle_leaves_its_cut() -> None:
    """Its variance grows by that of the length along which the tip still bends to the other side."""
    grown = widen_belief(BELIEF, SETTINGS).tip.covariance - BELIEF.tip.covariance
    assert grown[3, 3] == pytest.approx((2.0 / 27.6) ** 2)
    assert np.count_nonzero(grown) == 1


@pytest.mark.parametrize("planar", [True, False], ids=["planar", "spatial"])
def test_a_path_that_leaves_a_cut_begins_with_a_turn(planar: bool) -> None:
    """Its first roll is beyond 90 degrees, and its first arc as long as asked for."""
    problem = PlanProblem((0.0, -5.0, 80.0), planar=planar, leaves_mm=12.0)
    first = plan_path(problem).arcs[0]
    assert np.cos(first.roll_rad) < 0.0
    assert first.length_mm >= 12.0


def test_a_length_of_nothing_is_refused() -> None:
    """A withdrawal by nothing is named."""
    with pytest.raises(InputError, match="back_mm is 0"):
        RecoverySettings(1, 0.0, 4.0, 1.0)
