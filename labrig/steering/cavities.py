"""Cavities: two filters side by side, one of a tip that bends and one of a tip that goes straight.

In a cavity the needle does not steer. One filter alone takes a centimetre to notice it, and by then its heading is
wrong by nearly twenty degrees. So there are two, and a probability that the tip is in a cavity: an interacting multiple
model (Blom and Bar-Shalom 1988). Before each step the
two are mixed by how likely the tip entered or left a cavity, and after it they are weighed by how well each foresaw
what was seen.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from labrig.steering.estimator import start_tip, step_tip
from labrig.steering.motion import turned
from labrig.steering.tip import (
    CURVATURE,
    ERRORS,
    ORIENTATION,
    POSITION,
    EstimatorSettings,
    FloatArray,
    TipObservation,
    TipState,
    frozen,
)


@dataclass(frozen=True, eq=False)
class TipBelief:
    """What is known of the tip where there may be cavities.

    Attributes
    ----------
    tip : TipState
        Both together.
    outside, inside : TipState
        The tip outside of a cavity, and inside of one.
    cavity : float
        Probability that it is inside.
    """

    tip: TipState
    outside: TipState
    inside: TipState
    cavity: float


def start_belief(pose: FloatArray, settings: EstimatorSettings) -> TipBelief:
    """Return the tip at its start, outside of any cavity. Raises as `start_tip`."""
    tip = start_tip(pose, settings)
    return TipBelief(tip, tip, tip, 0.0)


def step_belief(belief: TipBelief, observation: TipObservation, settings: EstimatorSettings) -> TipBelief:
    """Return the tip after one observation. Raises as `step_tip`."""
    if math.isinf(settings.cavity_every_mm):
        tip = step_tip(belief.tip, observation, settings)
        return TipBelief(tip, tip, tip, 0.0)
    enters = -math.expm1(-observation.step_mm / settings.cavity_every_mm)
    leaves = -math.expm1(-observation.step_mm / settings.cavity_mm)
    entered, stayed_in = (1.0 - belief.cavity) * enters, belief.cavity * (1.0 - leaves)
    cavity = entered + stayed_in
    left = belief.cavity * leaves
    from_inside = left / (1.0 - cavity), stayed_in / cavity if cavity else 0.0
    outside = step_tip(_mixed(belief.outside, belief.inside, from_inside[0]), observation, settings)
    straight = replace(observation, bends=False)
    inside = step_tip(_mixed(belief.outside, belief.inside, from_inside[1]), straight, settings)
    better = max(outside.log_likelihood, inside.log_likelihood)
    weights = (
        (1.0 - cavity) * math.exp(outside.log_likelihood - better),
        cavity * math.exp(inside.log_likelihood - better),
    )
    share = weights[1] / sum(weights)
    return TipBelief(_mixed(outside, inside, share), outside, inside, share)


def advance_belief(belief: TipBelief, step: TipObservation, settings: EstimatorSettings) -> TipBelief:
    """Return the tip after a step at whose end nobody looked: what was seen last stays. Raises as `step_tip`."""
    moved = step_belief(belief, replace(step, position_mm=None), settings)
    pairs = ((moved.tip, belief.tip), (moved.outside, belief.outside), (moved.inside, belief.inside))
    tip, outside, inside = (
        replace(after, nis=before.nis, accepted=before.accepted, misses=before.misses)
        for after, before in pairs
    )
    return TipBelief(tip, outside, inside, moved.cavity)


def _mixed(one: TipState, other: TipState, share: float) -> TipState:
    """Return the state whose mean and covariance are those of both together, `share` of it the other's.

    What was seen last is told as the likelier of the two tells it.
    """
    likelier = other if share > 0.5 else one
    if share in {0.0, 1.0} or one is other:
        return likelier
    apart = _error_between(one, other)
    mean = share * apart
    pose = np.eye(4)
    pose[:3, 3] = one.position_mm + one.rotation @ mean[POSITION]
    pose[:3, :3] = one.rotation @ turned(mean[ORIENTATION])
    spread = share * (1.0 - share) * np.outer(apart, apart)
    covariance = (1.0 - share) * one.covariance + share * other.covariance + spread
    return replace(
        likelier,
        pose=frozen(pose),
        curvature=one.curvature + float(mean[CURVATURE]),
        covariance=frozen(covariance),
    )


def _error_between(one: TipState, other: TipState) -> FloatArray:
    """Return by which error the other state differs from the one, (7,)."""
    error = np.zeros(ERRORS)
    error[POSITION] = one.rotation.T @ (other.position_mm - one.position_mm)
    error[ORIENTATION] = Rotation.from_matrix(one.rotation.T @ other.rotation).as_rotvec()
    error[CURVATURE] = other.curvature - one.curvature
    return error
