"""Cavities: how soon they are detected, and steering through one."""

import math
from itertools import product

import numpy as np
import pytest

from labrig.steering.cavities import advance_belief, start_belief, step_belief
from labrig.steering.estimator import step_tip
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import PlanProblem
from labrig.steering.tip import EstimatorSettings, TipObservation
from tests.steering.driven_needle import DrivenNeedle, drive
from tests.steering.insertions import insert, settings

RADIUS_MM = 27.6
WATCHFUL = settings(planar=True, cavity_every_mm=50.0)


def heading_errors_deg(chosen: EstimatorSettings, seed: int) -> tuple[list[float], list[float]]:
    """Follow 20 mm of arc, 8 mm straight and 20 mm of arc again; return errors of heading and probabilities."""
    rng = np.random.default_rng(seed)
    belief, place, heading = start_belief(np.eye(4), chosen), np.zeros(3), 0.0
    errors, cavities = [], []
    for step in range(48):
        turn = 0.0 if 20 <= step < 28 else -1.0 / RADIUS_MM
        place = place + np.array((0.0, math.sin(heading + turn / 2), math.cos(heading + turn / 2)))
        heading += turn
        seen = place + np.array((0.0, *rng.normal(0.0, 0.2, 2)))
        belief = step_belief(belief, TipObservation(seen, 1.0), chosen)
        errors.append(abs(math.degrees(belief.tip.heading_rad - heading)))
        cavities.append(belief.cavity)
    return errors, cavities


def test_a_cavity_is_noticed_within_its_length() -> None:
    """A cavity is detected within its length and forgotten soon after; the heading is twice as accurate as without."""
    runs = [heading_errors_deg(WATCHFUL, seed) for seed in range(10)]
    cavity = np.mean([run[1] for run in runs], axis=0)
    assert cavity[:20].max() < 0.3
    assert cavity[27] > 0.5
    assert cavity[38:].max() < 0.3
    blind = [
        heading_errors_deg(WATCHFUL.model_copy(update={"cavity_every_mm": None}), seed)[0]
        for seed in range(10)
    ]
    assert np.mean([run[0][25:35] for run in runs]) < 0.5 * np.mean([run[25:35] for run in blind])


def test_where_there_are_none_the_filter_is_the_plain_one() -> None:
    """Without cavities a belief is the tip that `step_tip` gives, bit for bit."""
    chosen, insertion = settings(planar=True), insert(3, planar=True)
    belief = start_belief(np.eye(4), chosen)
    tip = belief.tip
    for observation in insertion.observations:
        belief, tip = step_belief(belief, observation, chosen), step_tip(tip, observation, chosen)
    np.testing.assert_array_equal(belief.tip.pose, tip.pose)
    assert belief.cavity == 0.0


def test_a_sighting_of_something_else_is_somewhere_in_a_square() -> None:
    """One in twenty is, within 20 mm: that is the evidence of a sighting that fits no tip."""
    wild = TipObservation(np.array((0.0, 9.0, 1.0)), 1.0)
    belief = step_belief(start_belief(np.eye(4), WATCHFUL), wild, WATCHFUL)
    assert belief.log_evidence == pytest.approx(math.log(0.05 / 20.0**2))


@pytest.mark.parametrize("planar", [True, False], ids=["planar", "spatial"])
def test_expecting_cavities_costs_little_where_there_are_none(planar: bool) -> None:
    """In even gel the model with cavities gives nearly the same heading errors."""
    errors = dict[float | None, list[float]]()
    for every_mm, seed in product((50.0, None), range(6)):
        chosen = settings(planar, cavity_every_mm=every_mm)
        insertion, belief = insert(seed, planar), start_belief(np.eye(4), chosen)
        for truth, observation in zip(insertion.truth[1:], insertion.observations, strict=True):
            belief = step_belief(belief, observation, chosen)
            off = belief.tip.rotation[:, 2] - truth[:3, 2]
            errors.setdefault(every_mm, []).append(float(np.linalg.norm(off)))
    assert np.mean(errors[50.0]) < 1.25 * np.mean(errors[None])


def test_a_step_at_whose_end_nobody_looked_is_no_miss() -> None:
    """A step without an observation is not a miss: the last observation stays and the tip advances."""
    belief = step_belief(
        start_belief(np.eye(4), WATCHFUL), TipObservation(np.array((0.0, 0.0, 1.0)), 1.0), WATCHFUL
    )
    on = advance_belief(belief, TipObservation(None, 0.5), WATCHFUL)
    assert (on.tip.nis, on.tip.misses, on.tip.accepted) == (belief.tip.nis, 0, True)
    assert on.tip.position_mm[2] > belief.tip.position_mm[2] + 0.4


@pytest.mark.processors
def test_a_needle_is_steered_through_a_cavity() -> None:
    """A needle that goes straight for 8 mm half-way still arrives within a millimetre."""
    problem = PlanProblem((0.0, 5.0, 100.0), planar=True)
    needle = DrivenNeedle(RADIUS_MM, closing_mm=3.0, backlash_mm=1.5, cavity_mm=(50.0, 58.0))
    chosen = SteeringSettings(problem, WATCHFUL.model_copy(update={"radius_sd_mm": 0.6}))
    done = drive(needle, chosen, sigma_mm=0.2, seed=2)
    assert done.stop == "target_reached"
    assert np.linalg.norm(needle.place - problem.target_mm) < 1.0
