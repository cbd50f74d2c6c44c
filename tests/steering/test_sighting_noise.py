"""Noise of sightings and backlash, measured from the sightings; the NIS as an alarm both ways."""

from dataclasses import replace
from functools import cache
from itertools import chain

import numpy as np
import pytest

from labrig.steering import sighting_noise
from labrig.steering.parameters import SteeringPolicy
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import PlanProblem
from labrig.steering.sighting_noise import SeenInsertion, measure_backlash, measure_noise, measure_sighting_sd
from labrig.steering.state import begin_steering
from tests.steering.driven_needle import DrivenNeedle, drive
from tests.steering.insertions import RADIUS_MM, settings

STATED = SteeringSettings(
    PlanProblem(target_mm=(0.0, 8.0, 50.0), radius_mm=RADIUS_MM, planar=True, max_length_mm=120.0),
    settings(planar=True, radius_sd_mm=0.6),
    SteeringPolicy(deviation_mm=0.4),
)
TRUE_BACKLASH_MM = 2.0


@cache
def see(sigma_mm: float, seed: int) -> SeenInsertion:
    """Drive a needle with a backlash that the policy does not know, and see its tip with this noise."""
    needle = DrivenNeedle(RADIUS_MM, closing_mm=3.0, backlash_mm=TRUE_BACKLASH_MM)
    done = drive(needle, STATED, sigma_mm, seed)
    way = (
        (command.roll_rad, seen) if command.roll_rad else (seen,)
        for command, seen in zip(done.commands[:-1], done.sightings, strict=True)
    )
    return SeenInsertion(begin_steering(STATED), tuple(chain.from_iterable(way)))


@pytest.mark.parametrize("sigma_mm", [0.03, 0.2])
def test_the_noise_of_the_sightings_is_measured(sigma_mm: float) -> None:
    """Within four of its standard deviations and 25 %, whatever the protocol states."""
    measured_mm, sd_mm = measure_sighting_sd([see(sigma_mm, 1)], STATED) or (0.0, 0.0)
    assert measured_mm == pytest.approx(sigma_mm, rel=0.25)
    assert abs(measured_mm - sigma_mm) < 4.0 * sd_mm


def test_the_backlash_is_measured() -> None:
    """Within three of its standard deviations, where policy and planner state another one and another radius."""
    wrong = {"observation_sd_mm": 0.03, "radius_mm": 2.0 * RADIUS_MM}
    fitting = replace(STATED, estimator=STATED.estimator.model_copy(update=wrong))
    measured_mm, sd_mm = measure_backlash([see(0.03, 2)], fitting) or (0.0, 0.0)
    assert abs(measured_mm - TRUE_BACKLASH_MM) < 3.0 * sd_mm
    assert sd_mm < 0.5


def test_the_radius_is_measured_whatever_is_stated() -> None:
    """Within two of its standard deviations, and to 5 %, where the protocol states 1.4 times as much."""
    stated = replace(STATED, estimator=STATED.estimator.model_copy(update={"radius_mm": 1.4 * RADIUS_MM}))
    measured_mm, sd_mm = sighting_noise.measure_radius([see(0.03, 2)], stated) or (0.0, 0.0)
    assert abs(measured_mm - RADIUS_MM) < 2.0 * sd_mm < 0.1 * RADIUS_MM


def test_too_few_sightings_tell_nothing() -> None:
    """Fewer than twenty sightings give no noise, one turn no backlash, and a needle still straight no radius."""
    short = SeenInsertion(begin_steering(STATED), see(0.03, 2).way[:10])
    assert measure_sighting_sd([short], STATED) is None
    assert measure_backlash([short], STATED) is None
    assert sighting_noise.measure_radius([replace(short, way=short.way[:2])], STATED) is None
    assert measure_noise([], [2.0] * 19, STATED) is None


@pytest.mark.parametrize(("scale", "verdict"), [(0.1, "too small"), (1.0, "as expected"), (3.0, "too large")])
def test_a_mean_nis_is_judged_both_ways(scale: float, verdict: str) -> None:
    """The NIS of fitting settings passes; a tenth of it and thrice it are alarms."""
    judged = measure_noise([], (scale * np.random.default_rng(4).chisquare(2, 100)).tolist(), STATED)
    assert judged.verdict == verdict
    assert judged.usual_nis[0] < 2.0 < judged.usual_nis[1]


def test_a_fitting_nis_is_rarely_an_alarm() -> None:
    """Of a thousand runs whose settings fit, at most five are alarms, where one is expected."""
    drawn = np.random.default_rng(6).chisquare(2, (1000, 60))
    judged = [measure_noise([], row.tolist(), STATED) for row in drawn]
    assert sum(found is not None and found.verdict != "as expected" for found in judged) <= 5
