"""One step of the tip, in terms of curvature instead of radius, because an estimated curvature may pass zero."""

import math

import numpy as np

from labrig.needle.kinematics import FloatArray

# Below this angle the derivatives come from their series; its first omitted term is below 1e-16.
_SMALL_ANGLE_RAD = 0.01


def step_position_mm(step_mm: float, curvature: float) -> FloatArray:
    """Return p_dl, (3,), the end of an arc of this length, equation (16)."""
    half = 0.5 * step_mm * curvature
    return np.array((0.0, -step_mm * math.sin(half) * _sinc(half), step_mm * _sinc(2.0 * half)))


def step_position_slope(step_mm: float, curvature: float) -> FloatArray:
    """Return the derivative of p_dl by the curvature, (3,) [mm^2]."""
    angle = step_mm * curvature
    if abs(angle) < _SMALL_ANGLE_RAD:
        square = angle * angle
        across = -0.5 + square / 8.0 - square * square / 144.0
        along = angle * (-1.0 / 3.0 + square / 30.0 - square * square / 840.0)
    else:
        across = (1.0 - math.cos(angle) - angle * math.sin(angle)) / angle**2
        along = (angle * math.cos(angle) - math.sin(angle)) / angle**2
    return step_mm**2 * np.array((0.0, across, along))


def rotation_from_vector(rotation_vector: FloatArray) -> FloatArray:
    """Return exp(v^), (3, 3), by Rodrigues' formula."""
    x, y, z = (float(v) for v in rotation_vector)
    angle = math.sqrt(x * x + y * y + z * z)
    s, c = _sinc(angle), 0.5 * _sinc(0.5 * angle) ** 2
    return np.array(
        (
            (1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y),
            (c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x),
            (c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)),
        )
    )


def vector_from_rotation(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector v (3,) of exp(v^) (3, 3), of less than half a turn."""
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = rotation.tolist()
    x, y, z = 0.5 * (m21 - m12), 0.5 * (m02 - m20), 0.5 * (m10 - m01)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = math.atan2(sine, 0.5 * (m00 + m11 + m22 - 1.0)) / sine if sine else 1.0
    return np.array((scale * x, scale * y, scale * z))


def _sinc(angle: float) -> float:
    return math.sin(angle) / angle if angle else 1.0
