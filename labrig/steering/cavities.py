"""Cavities: two filters side by side, one of a tip that bends and one of a tip that goes straight.

In a cavity the needle does not steer. A single filter takes a centimetre to notice that, and by then its heading is
off by nearly twenty degrees. So there are two filters and a probability that the tip is in a cavity: an interacting
multiple model (Blom and Bar-Shalom 1988). Before each step the two are mixed by the probability that the tip entered
or left a cavity. After it they are weighted by how well each predicted the observation.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from labrig.needle.kinematics import FloatArray
from labrig.steering.estimator import start_tip, step_tip
from labrig.steering.motion import rotation_from_vector, vector_from_rotation
from labrig.steering.tip import (
    CURVATURE,
    ORIENTATION,
    POSITION,
    SLIP,
    EstimatorSettings,
    TipObservation,
    TipState,
    freeze,
)

CAVITY_MM = 8.0
"""Mean length of a cavity, in which the needle goes straight."""

# Share of sightings that are something else than the tip, and the side of the square or cube in which that lies.
_FALSE_SHARE = 0.05
_FALSE_WITHIN_MM = 20.0


@dataclass(frozen=True, eq=False)
class TipBelief:
    """The estimate of the tip in a gel that may have cavities.

    Attributes
    ----------
    tip : TipState
        The mixture of both.
    outside, inside : TipState
        The tip outside a cavity, and inside a cavity.
    cavity : float
        Probability that it is inside.
    log_evidence : float
        Log of the last sighting's probability density given all before it; 0 without a sighting.
    """

    tip: TipState
    outside: TipState
    inside: TipState
    cavity: float
    log_evidence: float = 0.0


def start_belief(pose: FloatArray, settings: EstimatorSettings) -> TipBelief:
    """Return the tip at its start, outside any cavity."""
    tip = start_tip(pose, settings)
    return TipBelief(tip, tip, tip, 0.0)


def step_belief(belief: TipBelief, observation: TipObservation, settings: EstimatorSettings) -> TipBelief:
    """Return the tip after one observation."""
    if settings.cavity_every_mm is None:
        tip = step_tip(belief.tip, observation, settings)
        return TipBelief(tip, tip, tip, 0.0, _weigh(tip, settings))
    enters = -math.expm1(-observation.step_mm / settings.cavity_every_mm)
    leaves = -math.expm1(-observation.step_mm / CAVITY_MM)
    entered, stayed_in = (1.0 - belief.cavity) * enters, belief.cavity * (1.0 - leaves)
    cavity = entered + stayed_in
    from_inside = belief.cavity * leaves / (1.0 - cavity), stayed_in / cavity if cavity else 0.0
    apart = _find_error(belief.outside, belief.inside)
    outside, inside = (_mix(belief.outside, belief.inside, apart, share) for share in from_inside)
    outside = step_tip(outside, observation, settings)
    inside = step_tip(inside, replace(observation, bends=False), settings)
    log_likelihoods = [_weigh(tip, settings) for tip in (outside, inside)]
    better = max(log_likelihoods)
    weights = (
        (1.0 - cavity) * math.exp(log_likelihoods[0] - better),
        cavity * math.exp(log_likelihoods[1] - better),
    )
    share = weights[1] / sum(weights)
    log_evidence = better + math.log(sum(weights))
    tip = _mix(outside, inside, _find_error(outside, inside), share)
    return TipBelief(tip, outside, inside, share, log_evidence)


def _weigh(tip: TipState, settings: EstimatorSettings) -> float:
    """Return the log-likelihood by which a tip is weighed: its sighting may be something else than the tip.

    So a sighting that fits neither tip says nothing about which one is right.
    """
    if tip.nis is None:
        return tip.log_likelihood
    false = math.log(_FALSE_SHARE) - len(settings.observed) * math.log(_FALSE_WITHIN_MM)
    return float(np.logaddexp(math.log1p(-_FALSE_SHARE) + tip.log_likelihood, false))


def advance_belief(belief: TipBelief, step: TipObservation, settings: EstimatorSettings) -> TipBelief:
    """Return the tip after a step without a sighting; the last sighting's figures stay."""
    moved = step_belief(belief, replace(step, position_mm=None), settings)
    pairs = ((moved.tip, belief.tip), (moved.outside, belief.outside), (moved.inside, belief.inside))
    tip, outside, inside = (
        replace(after, nis=before.nis, accepted=before.accepted, misses=before.misses)
        for after, before in pairs
    )
    return TipBelief(tip, outside, inside, moved.cavity)


def _mix(outside: TipState, inside: TipState, apart: FloatArray, share: float) -> TipState:
    """Return the state with mean and covariance of the mixture, `share` of it inside a cavity, so far `apart`.

    The figures of the last observation are those of the likelier state.
    """
    likelier = inside if share > 0.5 else outside
    if share in {0.0, 1.0} or outside is inside:
        return likelier
    mean = share * apart
    spread = share * (1.0 - share) * apart[:, None] * apart
    covariance = (1.0 - share) * outside.covariance + share * inside.covariance + spread
    return TipState(
        freeze(outside.rotation @ rotation_from_vector(mean[ORIENTATION])),
        freeze(outside.position_mm + outside.rotation @ mean[POSITION]),
        outside.curvature + float(mean[CURVATURE]),
        freeze(covariance),
        likelier.nis,
        likelier.accepted,
        likelier.misses,
        likelier.log_likelihood,
        outside.slip + float(mean[SLIP]) if len(mean) > SLIP else 0.0,
    )


def _find_error(estimate: TipState, truth: TipState) -> FloatArray:
    """Return the error (size,) that turns an estimate into the truth."""
    error = np.zeros(len(estimate.covariance))
    error[POSITION] = estimate.rotation.T @ (truth.position_mm - estimate.position_mm)
    error[ORIENTATION] = vector_from_rotation(estimate.rotation.T @ truth.rotation)
    error[CURVATURE] = truth.curvature - estimate.curvature
    error[SLIP:] = truth.slip - estimate.slip
    return error
