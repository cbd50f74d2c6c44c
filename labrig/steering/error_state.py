"""The default filter: an error state of position, orientation and curvature about a pose on SE(3).

The pose itself is propagated exactly by (16) and (17). The Kalman filter holds the error of the pose in the tip's own
frame: the truth is p + R rho, R exp(phi^), kappa + dkappa and, where the slip is estimated too, s + ds: the tip
advances by 1 - s of what is inserted. So a flip is only a rotation, no angle locks, an observed position is exactly
rho, and its noise counts once (errata of (20), (22) and of the Euler angles). After each observation the error moves
into the pose and is zero again. In the plane the errors out of it have no covariance, and stay zero.
"""

import math

import numpy as np
from scipy.linalg.lapack import dposv

from labrig.needle.kinematics import FloatArray
from labrig.steering.motion import rotation_from_vector, step_frame, step_origin_slope
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

# So many observations in a row may fail the gate; at the next failure the filter widens its covariance until the
# observation is an ordinary one.
_PATIENCE = 3
# Standard deviation of what the heading may have turned by while the tip was not seen. A larger one recovers faster
# from a cavity that is not modelled, and makes false sightings turn the heading more.
_REOPENED_HEADING_SD_RAD = 0.05
# Inserted length over which the slip may change by its standard deviation.
_SLIP_CHANGES_MM = 100.0


def step_error_state(state: TipState, observation: TipObservation, settings: EstimatorSettings) -> TipState:
    """Return the tip after a roll, an advance and, if the tip was seen, an observation."""
    rotation, position, transition, process = _predict(state, observation, settings)
    covariance = transition @ state.covariance @ transition.T + process
    error, nis, log_likelihood, accepted = np.zeros(settings.size), None, 0.0, False
    if observation.position_mm is not None:
        innovation = ((observation.position_mm - position) @ rotation)[settings.seen]
        root, weighed, _ = dposv(covariance[settings.seen, settings.seen] + settings.noise, innovation)
        nis = float(innovation @ weighed)
        log_determinant = 2.0 * math.log(math.prod(root.diagonal()))
        log_likelihood = -0.5 * (nis + len(root) * math.log(2.0 * math.pi) + log_determinant)
        fits = nis <= _limit_nis(state, settings)
        accepted = fits or state.misses >= _PATIENCE
        if not fits and accepted:
            covariance = _reopen(covariance, innovation, settings)
        if accepted:
            seen = covariance[settings.seen]
            _, gain, _ = dposv(seen[:, settings.seen] + settings.noise, seen)
            error, covariance = innovation @ gain, covariance - seen.T @ gain
            # The error moves into the pose.
            position = position + rotation @ error[POSITION]
            rotation = rotation @ rotation_from_vector(error[ORIENTATION])
    return TipState(
        freeze(rotation),
        freeze(position),
        state.curvature + float(error[CURVATURE]),
        freeze(0.5 * (covariance + covariance.T)),
        nis,
        accepted,
        0 if accepted else state.misses + 1,
        log_likelihood,
        state.slip + float(error[SLIP]) if len(error) > SLIP else 0.0,
    )


def _limit_nis(state: TipState, settings: EstimatorSettings) -> float:
    """Return the NIS beyond which an observation is rejected: a lower one after a rejected observation.

    A gate that widens while false sightings are rejected would let in the next one, or the tip itself as if it had
    turned.
    """
    was_rejected = state.nis is not None and not state.accepted
    return settings.doubtful_nis if was_rejected else settings.gate_nis


def _reopen(covariance: FloatArray, innovation: FloatArray, settings: EstimatorSettings) -> FloatArray:
    """Return a covariance so wide that the innovation is an ordinary one.

    What was seen may be something else than the tip: its position is taken, and only the next sightings may turn the
    heading.
    """
    moved = float(innovation @ innovation) / len(innovation) * settings.observed.T @ settings.observed
    return covariance + moved + _REOPENED_HEADING_SD_RAD**2 * settings.turning


def _predict(
    state: TipState, observation: TipObservation, settings: EstimatorSettings
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return rotation and position after a step by (16) and (17), and F and Q by which their errors follow."""
    step_mm = observation.step_mm * (1.0 - state.slip)
    curvature = state.curvature if observation.bends else 0.0
    turn, advance = step_frame(observation.roll_rad, step_mm, curvature)
    back, (x, y, z) = turn.T, advance.tolist()
    transition = np.eye(settings.size)
    transition[POSITION, POSITION] = transition[ORIENTATION, ORIENTATION] = back
    transition[POSITION, ORIENTATION] = back @ np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))
    process = settings.process_sd_rad_per_root_mm**2 * step_mm * settings.turning
    if observation.bends:
        transition[POSITION, CURVATURE] = back @ step_origin_slope(observation.roll_rad, step_mm, curvature)
        transition[ORIENTATION.start, CURVATURE] = step_mm
    if settings.estimates_slip:
        transition[POSITION.stop - 1, SLIP] = -observation.step_mm
        transition[ORIENTATION.start, SLIP] = -observation.step_mm * curvature
        process[SLIP, SLIP] = settings.slip_sd**2 * observation.step_mm / _SLIP_CHANGES_MM
    return state.rotation @ turn, state.position_mm + state.rotation @ advance, transition, process
