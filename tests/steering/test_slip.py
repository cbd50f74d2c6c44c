"""A tip that stays behind what is inserted: the estimator follows it, and the path is planned with it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from labrig.steering.error_state import step_error_state
from labrig.steering.estimator import start_tip
from labrig.steering.parameters import SteeringPolicy
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import PlanProblem
from labrig.steering.tip import SLIP, TipObservation, TipState
from tests.steering.driven_needle import DrivenNeedle, drive
from tests.steering.insertions import RADIUS_MM, STEPS, Floats, follow, insert, settings

SLIPPING = settings(planar=True, slip_sd=0.02)


def follow_with_slip(seed: int, slips: Floats) -> TipState:
    """Return the last state of an insertion whose steps are stated longer than they are, by slips (T,)."""
    insertion = insert(seed, planar=True)
    return follow(replace(insertion, step_mm=1.0 / (1.0 - slips)), SLIPPING)[-1]


@pytest.mark.processors
@pytest.mark.parametrize("slip", [-0.03, 0.0, 0.03])
def test_the_slip_is_learnt(slip: float) -> None:
    """After 100 mm the slip is known within three of its standard deviations, and better than before."""
    for seed in range(5):
        state = follow_with_slip(seed, np.full(STEPS, slip))
        sd = math.sqrt(float(state.covariance[SLIP, SLIP]))
        assert abs(state.slip - slip) < 3.0 * sd
        assert sd < 0.75 * SLIPPING.slip_sd


def test_the_error_of_the_slip_tells_its_size() -> None:
    """Where the slip wanders as assumed, its squared error over its variance is 1 in the mean of thirty insertions."""
    rng, ratios = np.random.default_rng(5), []
    for seed in range(30):
        steps = SLIPPING.slip_sd / math.sqrt(STEPS) * rng.normal(size=STEPS)
        slips = SLIPPING.slip_sd * rng.normal() + np.cumsum(steps)
        state = follow_with_slip(seed, slips)
        ratios.append((state.slip - slips[-1]) ** 2 / state.covariance[SLIP, SLIP])
    assert 0.5 < np.mean(ratios) < 1.6


def test_how_a_slip_moves_the_tip_is_the_derivative() -> None:
    """The covariance of slip with position and heading is that of central differences."""
    pose, step_mm, small = np.eye(4), 4.0, 1e-5
    at = replace(start_tip(pose, SLIPPING), slip=0.01)
    moved = step_error_state(at, TipObservation(None, step_mm), SLIPPING)
    ahead, behind = (
        step_error_state(replace(at, slip=0.01 + sign * small), TipObservation(None, step_mm), SLIPPING)
        for sign in (1.0, -1.0)
    )
    slope = moved.rotation.T @ (ahead.position_mm - behind.position_mm) / (2.0 * small)
    turn = -(ahead.heading_rad - behind.heading_rad) / (2.0 * small)
    variance = SLIPPING.slip_sd**2
    np.testing.assert_allclose(moved.covariance[:3, SLIP], slope * variance, atol=1e-9)
    np.testing.assert_allclose(moved.covariance[3, SLIP], turn * variance, atol=1e-9)


@pytest.mark.parametrize("slip", [-0.02, 0.02])
def test_a_needle_that_slips_arrives(slip: float) -> None:
    """With 2 % of slip the tip ends within 0.3 mm of the target, and nearer than if the slip is not estimated."""
    problem = PlanProblem(target_mm=(0.0, 4.0, 90.0), radius_mm=RADIUS_MM, planar=True, max_length_mm=120.0)
    known = settings(planar=True, radius_sd_mm=0.6)
    missed_mm = []
    for estimator in (known.model_copy(update={"observation_sd_mm": 0.03, "slip_sd": 0.02}), known):
        chosen = SteeringSettings(problem, estimator, SteeringPolicy(backlash_mm=0.0, closing_mm=0.0))
        needle = DrivenNeedle(RADIUS_MM)
        drive(needle, chosen, slip=slip)
        missed_mm.append(float(np.linalg.norm(needle.place - problem.target_mm)))
    assert missed_mm[0] < 0.3
    assert missed_mm[0] < missed_mm[1]
