"""Sightings of something else than the tip move neither heading nor decisions."""

import math
from dataclasses import replace

import numpy as np
import pytest

from labrig.steering.estimator import start_tip, step_tip
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import PlanProblem
from labrig.steering.tip import TipObservation
from tests.steering.driven_needle import DrivenNeedle, Floats, drive
from tests.steering.false_sightings import WATCHFUL, scattered_rmse_deg, streak_rmse_deg
from tests.steering.insertions import RADIUS_MM, settings

RUNS = 5


@pytest.mark.parametrize(("share", "limit_deg"), [(0.05, 1.4), (0.2, 1.5)])
def test_scattered_false_sightings_hardly_turn_the_heading(share: float, limit_deg: float) -> None:
    """With one false sighting in twenty, or in five, the heading is as good as in the figures of the benchmark."""
    assert scattered_rmse_deg(RUNS, share) < limit_deg


def test_six_false_sightings_in_a_row_hardly_turn_the_heading() -> None:
    """A thing beside the tip that is seen six times is left again without a turn of the heading."""
    assert streak_rmse_deg(RUNS) < 4.0


def test_after_false_sightings_the_next_must_be_closer_to_count() -> None:
    """A sighting that would count after a good one is rejected after a false one, and counts by its position then."""
    chosen = settings(planar=True)
    seen = step_tip(start_tip(np.eye(4), chosen), TipObservation(np.array((0.0, 0.0, 1.0)), 1.0), chosen)
    sd_mm = math.sqrt(seen.covariance[1, 1] + 0.2**2)
    aside = TipObservation(np.array((0.0, 3.3 * sd_mm, 2.0)), 1.0)
    assert step_tip(seen, aside, chosen).accepted
    away = step_tip(seen, TipObservation(np.array((0.0, 9.0, 2.0)), 1.0), chosen)
    again = replace(aside, position_mm=np.array((0.0, 3.3 * math.sqrt(away.covariance[1, 1] + 0.2**2), 3.0)))
    assert not step_tip(away, again, chosen).accepted


def test_one_false_sighting_ahead_does_not_make_a_needle_stuck() -> None:
    """A perfect insertion goes on after one sighting 2.5 mm ahead of the tip."""
    needle = DrivenNeedle(RADIUS_MM)
    chosen = SteeringSettings(
        PlanProblem((0.0, 5.0, 60.0), planar=True), WATCHFUL.model_copy(update={"cavity_every_mm": None})
    )

    def see(needle: DrivenNeedle) -> Floats:
        ahead_mm = 2.5 if 30.0 <= needle.inserted_mm < 31.0 else 0.0
        return needle.place + needle.frame.apply((0.0, 0.0, ahead_mm))

    assert drive(needle, chosen, see=see).stop == "target_reached"
