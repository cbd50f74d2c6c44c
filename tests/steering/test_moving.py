"""Targets and obstacles that are told to move with the needle."""

import math

import numpy as np
import pytest

from labrig.steering.moving import Motion, expect_places, move_target
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import Obstacle, PlanProblem
from labrig.steering.tip import EstimatorSettings
from tests.steering.driven_needle import DrivenNeedle, drive

RADIUS_MM = 28.0
STILL = (0.0, 0.0, 0.0)


def settings(motion: Motion | None, *obstacles: Obstacle) -> SteeringSettings:
    """Return a target 80 mm ahead."""
    problem = PlanProblem(
        (0.0, 6.0, 80.0), obstacles, radius_mm=RADIUS_MM, tolerance_mm=0.5, max_length_mm=120.0, planar=True
    )
    return SteeringSettings(problem, EstimatorSettings(RADIUS_MM, 0.05, 0.005, planar=True), motion=motion)


def test_a_target_is_met_where_it_is_when_the_tip_gets_there() -> None:
    """A target that runs away evenly is expected where the tip, going straight, catches up with it."""
    motion = Motion((0.0, 0.0, 0.25), ((0.0, 0.1, 0.0),))
    problem = settings(None, Obstacle((0.0, 0.0, 30.0), 3.0)).problem
    target_mm, (obstacle,) = expect_places(problem, motion, 20.0, np.array((0.0, 6.0, 10.0)))
    # The tip is at z after 10 mm + z, and 80 mm + a quarter of that is z.
    assert target_mm == pytest.approx((0.0, 6.0, 110.0), abs=0.01)
    y_mm = obstacle.position_mm[1]
    assert y_mm == pytest.approx(0.1 * (20.0 + math.hypot(20.0, y_mm - 6.0)), abs=0.01)


@pytest.mark.processors
def test_the_needle_ends_at_a_target_that_is_pushed_along() -> None:
    """Told how the target moves, the step reaches it; told that it stands still, it ends where it was."""
    motion = Motion((0.0, -0.04, 0.05), ())
    ends = {}
    for told in (motion, None):
        needle = DrivenNeedle(RADIUS_MM, closing_mm=3.0, backlash_mm=1.5)
        driven = drive(needle, settings(told), sigma_mm=0.03)
        assert driven.command.stop == "target_reached"
        target_mm = move_target((0.0, 6.0, 80.0), motion, needle.inserted_mm)
        ends[told] = math.dist(needle.place, target_mm)
    assert ends[motion] < 0.5
    assert ends[None] > 4.0


def test_an_obstacle_is_passed_where_it_will_be() -> None:
    """An obstacle that comes into the way is kept off where the tip comes to it."""
    motion = Motion(STILL, ((0.0, -0.2, 0.0),))
    obstacle, needle = (
        Obstacle((0.0, 15.0, 40.0), 6.0),
        DrivenNeedle(RADIUS_MM, closing_mm=3.0, backlash_mm=1.5),
    )
    driven = drive(needle, settings(motion, obstacle), sigma_mm=0.03)
    assert driven.command.stop == "target_reached"
    passed = min(driven.states, key=lambda state: abs(state.tip.position_mm[2] - 40.0))
    centre_mm = (0.0, 15.0 - 0.2 * passed.insertion_mm, 40.0)
    assert math.dist(passed.tip.position_mm, centre_mm) > 6.0 + 0.6
