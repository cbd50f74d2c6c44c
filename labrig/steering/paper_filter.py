"""The paper's filter: Euler angles as the state, equations (16) to (25) with their corrections.

- (20) drops the increment of (18). It is kept as printed, and the pose is propagated by (17) after the update,
  which equals (18) because R_x is the innermost factor.
- (22) observes the position of t + 1, not of t.
- The p_t inside h is itself measured, so its noise counts twice: Q_obs = 2 sigma^2.
- (25) has e_3^T R_y R_x as its third row, not e_3^T R_y.
- A flip is R <- R R_z(delta); the angles are read off the new R.

It serves for comparison. Its angles lock at phi_y = +-90 degrees, it has no gate, and its position is the measured
position.
"""

import math

import numpy as np
from filterpy.kalman import update

from labrig.needle.kinematics import FloatArray, cross_matrix, rotation_z
from labrig.steering.motion import step_frame
from labrig.steering.tip import ORIENTATION, POSITION, EstimatorSettings, TipObservation, TipState, freeze

# Singular values of the map of angles below this count as zero: phi_y is locked.
_LOCK = 1e-6


def step_paper_filter(state: TipState, observation: TipObservation, settings: EstimatorSettings) -> TipState:
    """Return the tip after a roll, an advance and, if the tip was seen, an observation."""
    roll = rotation_z(observation.roll_rad)
    angles = euler_angles(state.rotation @ roll)
    to_angles = np.linalg.pinv(body_rates(angles), rcond=_LOCK) @ roll.T
    p_euler = to_angles @ state.covariance[ORIENTATION, ORIENTATION] @ to_angles.T
    turning = np.diag((1.0, 0.0, 0.0) if settings.planar else (1.0, 1.0, 1.0))
    p_euler = p_euler + settings.process_sd_rad_per_root_mm**2 * observation.step_mm * turning  # (21)
    bend, advance = step_frame(0.0, observation.step_mm, state.curvature if observation.bends else 0.0)
    position, nis = state.position_mm + rotation_from_euler(angles) @ advance, None  # (16)
    if observation.position_mm is not None:
        angles, p_euler, nis = _update(angles, p_euler, advance, observation.position_mm - position, settings)
        position = observation.position_mm
    rotation = rotation_from_euler(angles) @ bend  # (17)
    rates = body_rates(euler_angles(rotation))
    covariance = _covariance(rates @ p_euler @ rates.T, settings)
    misses = state.misses + 1 if nis is None else 0
    return TipState(
        freeze(rotation), freeze(position.copy()), state.curvature, covariance, nis, nis is not None, misses
    )


def rotation_from_euler(angles: FloatArray) -> FloatArray:
    """Return R_z R_y R_x of the angles (phi_x, phi_y, phi_z), equation (16)."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    return np.array(
        (
            (cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
            (sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
            (-sy, cy * sx, cy * cx),
        )
    )


def euler_angles(rotation: FloatArray) -> FloatArray:
    """Return (phi_x, phi_y, phi_z) of a rotation, (3,)."""
    return np.array(
        (
            math.atan2(rotation[2, 1], rotation[2, 2]),
            math.atan2(-rotation[2, 0], math.hypot(rotation[2, 1], rotation[2, 2])),
            math.atan2(rotation[1, 0], rotation[0, 0]),
        )
    )


def body_rates(angles: FloatArray) -> FloatArray:
    """Return (3, 3), which maps rates of the angles to angular velocity in the tip's frame.

    Its columns are the rows e_1^T, e_2^T R_x and e_3^T R_y R_x of (25), the third as corrected.
    """
    (cx, cy, _), (sx, sy, _) = np.cos(angles), np.sin(angles)
    return np.array(((1.0, 0.0, -sy), (0.0, cx, sx * cy), (0.0, -sx, cx * cy)))


def position_jacobian(angles: FloatArray, advance: FloatArray) -> FloatArray:
    """Return H of (25), (3, 3), the derivative of the position after a step by the angles."""
    return -rotation_from_euler(angles) @ cross_matrix(advance) @ body_rates(angles)


def _update(
    angles: FloatArray,
    p_euler: FloatArray,
    advance: FloatArray,
    innovation: FloatArray,
    settings: EstimatorSettings,
) -> tuple[FloatArray, FloatArray, float]:
    """Return angles, their covariance and the NIS by (22), (23) and (24), in the tip's frame."""
    view = settings.observed[:, POSITION] @ rotation_from_euler(angles).T
    h = view @ position_jacobian(angles, advance)
    seen, noise = view @ innovation, 2.0 * settings.observation_sd_mm**2 * np.eye(len(h))
    nis = float(seen @ np.linalg.solve(h @ p_euler @ h.T + noise, seen))
    error, p_euler = update(np.zeros(3), p_euler, seen, noise, h)
    return angles + error, p_euler, nis


def _covariance(orientation: FloatArray, settings: EstimatorSettings) -> FloatArray:
    """Return (7, 7): the position with the noise of its measurement, the orientation with the filter's covariance."""
    covariance = np.zeros((settings.size, settings.size))
    seen = settings.observed[:, POSITION]
    covariance[POSITION, POSITION] = settings.observation_sd_mm**2 * seen.T @ seen
    covariance[ORIENTATION, ORIENTATION] = 0.5 * (orientation + orientation.T)
    return freeze(covariance)
