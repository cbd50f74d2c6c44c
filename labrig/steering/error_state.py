"""The default filter: an error state of position, orientation and curvature about a pose on SE(3).

The pose itself is propagated exactly by (16) and (17). What filterpy's ExtendedKalmanFilter holds is the error of
it, seven numbers in the tip's own frame: the truth is p + R rho, R exp(phi^) and kappa + dkappa. So a
flip is a rotation and nothing else, no angle locks, a position is observed as rho exactly, and its noise counts once
(errata of (20), (22) and of the Euler angles). After each observation the error is moved into the pose and is
zero again. In the plane the errors out of it have no covariance, and filterpy leaves them at zero.

filterpy answers wrongly, not with an error, for arrays of unexpected shape: here its state and observations are
1-D always, and what comes from outside was checked when the `TipObservation` was made.
"""

import math
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from labrig.needle.kinematics import cross_matrix, rotation_x, rotation_z
from labrig.steering.motion import step_position_mm, step_position_slope, turned
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
class _Prediction:
    """Where the tip should be after a step: its rotation and position, and how the errors came along."""

    rotation: FloatArray
    position_mm: FloatArray
    transition: FloatArray
    process: FloatArray


def step_error_state(state: TipState, observation: TipObservation, settings: EstimatorSettings) -> TipState:
    """Return the tip after a roll, an advance and, where the tip was seen, an observation."""
    prediction = _predict(state, observation, settings)
    kalman = ExtendedKalmanFilter(dim_x=ERRORS, dim_z=len(settings.observed))
    kalman.x = np.zeros(ERRORS)
    kalman.P, kalman.F, kalman.Q = state.covariance, prediction.transition, prediction.process
    kalman.predict()
    if observation.position_mm is None:
        return _moved(prediction, kalman, state, None)
    innovation = prediction.rotation.T @ (observation.position_mm - prediction.position_mm)
    seen = settings.observed[:, POSITION] @ innovation
    nis = _update(kalman, seen, settings)
    log_likelihood = -0.5 * (nis + math.log(np.linalg.det(2.0 * math.pi * kalman.S)))
    if nis <= settings.gate_nis:
        return _moved(prediction, kalman, state, nis, log_likelihood, accepted=True)
    kalman.x, kalman.P = kalman.x_prior, kalman.P_prior
    if state.misses < settings.patience:
        return _moved(prediction, kalman, state, nis, log_likelihood)
    kalman.P = kalman.P * (nis / len(seen))
    _update(kalman, seen, settings)
    return _moved(prediction, kalman, state, nis, log_likelihood, accepted=True)


def _predict(state: TipState, observation: TipObservation, settings: EstimatorSettings) -> _Prediction:
    """Propagate the pose by (16) and (17), and write down how its errors go along with it."""
    step_mm = observation.step_mm
    roll = rotation_z(observation.roll_rad)
    curvature = state.curvature if observation.bends else 0.0
    bend = rotation_x(step_mm * curvature)
    advance = step_position_mm(step_mm, curvature)
    back = (roll @ bend).T
    transition = np.eye(ERRORS)
    transition[POSITION, POSITION] = transition[ORIENTATION, ORIENTATION] = back
    transition[POSITION, ORIENTATION] = -bend.T @ cross_matrix(advance) @ roll.T
    if observation.bends:
        transition[POSITION, CURVATURE] = bend.T @ step_position_slope(step_mm, curvature)
        transition[ORIENTATION.start, CURVATURE] = step_mm
    process = np.zeros((ERRORS, ERRORS))
    turning = (3,) if settings.planar else (3, 4, 5)
    process[turning, turning] = settings.process_sd_rad_per_root_mm**2 * step_mm
    rolled = state.rotation @ roll
    return _Prediction(rolled @ bend, state.position_mm + rolled @ advance, transition, process)


def _update(kalman: ExtendedKalmanFilter, seen: FloatArray, settings: EstimatorSettings) -> float:
    """Let filterpy take in an innovation, and return its NIS."""
    kalman.R = settings.observation_sd_mm**2 * np.eye(len(seen))
    kalman.update(seen, lambda _: settings.observed, lambda x: settings.observed @ x)
    return float(kalman.y @ kalman.SI @ kalman.y)


def _moved(
    prediction: _Prediction,
    kalman: ExtendedKalmanFilter,
    before: TipState,
    nis: float | None,
    log_likelihood: float = 0.0,
    *,
    accepted: bool = False,
) -> TipState:
    """Return the state with the error moved into it."""
    pose = np.eye(4)
    pose[:3, 3] = prediction.position_mm + prediction.rotation @ kalman.x[POSITION]
    pose[:3, :3] = prediction.rotation @ turned(kalman.x[ORIENTATION])
    curvature = before.curvature + float(kalman.x[CURVATURE])
    covariance = frozen(0.5 * (kalman.P + kalman.P.T))
    misses = 0 if accepted else before.misses + 1
    return TipState(frozen(pose), curvature, covariance, nis, accepted, misses, log_likelihood)
