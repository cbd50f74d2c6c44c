"""How the tip moves, in terms of curvature instead of radius, because an estimated curvature may pass zero.

The bend follows the bevel with a lag, because the hinges have to swing over.

After a turn of the bevel the curvature swings over linearly along a few millimetres, the backlash. The heading is
then that of a bend that changes at once, but half the backlash later; the position differs by less than curvature
times backlash squared over 24, which is 0.004 mm here. Likewise a tip whose hinges close along the first
millimetres goes straight along half of them. So a path still consists of arcs, and every turn acts a lag after the
place where it was made.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labrig.needle.kinematics import FloatArray
from labrig.steering.tip import TipObservation, TipState, make_pose

# Below this angle the derivatives come from their series; its first omitted term is below 1e-16.
_SMALL_ANGLE_RAD = 0.01
# The same for the length of a rotation vector.
_SMALL_TURN_RAD = 1e-3


def step_frame(roll_rad: float, step_mm: float, curvature: float) -> tuple[FloatArray, FloatArray]:
    """Return the tip's frame after a roll and an arc in that before, (16) and (17): rotation (3, 3), origin (3,) [mm].

    The rotation is `exp(roll e_3^) exp(angle e_1^)`, written out: a tip is moved thousands of times an insertion.
    """
    s, c = math.sin(roll_rad), math.cos(roll_rad)
    angle = step_mm * curvature
    sine, cosine = math.sin(angle), math.cos(angle)
    rotation = np.array(((c, -s * cosine, s * sine), (s, c * cosine, -c * sine), (0.0, sine, cosine)))
    across, along = -step_mm * math.sin(0.5 * angle) * _sinc(0.5 * angle), step_mm * _sinc(angle)
    return rotation, np.array((-s * across, c * across, along))


def step_origin_slope(roll_rad: float, step_mm: float, curvature: float) -> FloatArray:
    """Return the derivative of the origin of `step_frame` by the curvature, (3,) [mm^2]."""
    angle = step_mm * curvature
    if abs(angle) < _SMALL_ANGLE_RAD:
        square = angle * angle
        across = -0.5 + square / 8.0 - square * square / 144.0
        along = angle * (-1.0 / 3.0 + square / 30.0 - square * square / 840.0)
    else:
        across = (1.0 - math.cos(angle) - angle * math.sin(angle)) / angle**2
        along = (angle * math.cos(angle) - math.sin(angle)) / angle**2
    return step_mm**2 * np.array((-math.sin(roll_rad) * across, math.cos(roll_rad) * across, along))


def rotation_from_vector(rotation_vector: FloatArray) -> FloatArray:
    """Return exp(v^), (3, 3), by Rodrigues' formula."""
    x, y, z = rotation_vector.tolist()
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
    """Return the rotation vector v (3,) of exp(v^) (3, 3), of at most half a turn.

    By the unit quaternion, from its largest component (Shepperd 1978), to the same bits as scipy's `Rotation`, which
    takes ten times as long for one matrix, as it is made for many.
    """
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = rotation.tolist()
    trace = m00 + m11 + m22
    largest = max(m00, m11, m22, trace)
    if m00 == largest:
        quaternion = 1.0 - trace + 2.0 * m00, m10 + m01, m20 + m02, m21 - m12
    elif m11 == largest:
        quaternion = m10 + m01, 1.0 - trace + 2.0 * m11, m21 + m12, m02 - m20
    elif m22 == largest:
        quaternion = m20 + m02, m21 + m12, 1.0 - trace + 2.0 * m22, m10 - m01
    else:
        quaternion = m21 - m12, m02 - m20, m10 - m01, 1.0 + trace
    x, y, z, w = quaternion
    norm = math.copysign(math.sqrt(x * x + y * y + z * z + w * w), w)
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    angle = 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), w)
    if angle <= _SMALL_TURN_RAD:
        square = angle * angle
        scale = 2.0 + square / 12.0 + 7.0 * square * square / 2880.0
    else:
        scale = angle / math.sin(angle / 2.0)
    return np.array((scale * x, scale * y, scale * z))


def _sinc(angle: float) -> float:
    return math.sin(angle) / angle if angle else 1.0


@dataclass(frozen=True)
class Turn:
    """A turn of the bend about the needle's axis, at an insertion length."""

    at_mm: float
    roll_rad: float


def split_into_steps(
    from_mm: float, to_mm: float, turns: tuple[Turn, ...], straight_to_mm: float
) -> list[TipObservation]:
    """Return the steps of the tip between two insertion lengths, without a turn at the second length."""
    acting = [turn for turn in turns if from_mm <= turn.at_mm < to_mm]
    between = {turn.at_mm for turn in acting} | {straight_to_mm}
    cuts = sorted({from_mm, to_mm} | {cut for cut in between if from_mm < cut < to_mm})
    return [
        TipObservation(
            None,
            end - start,
            sum(turn.roll_rad for turn in acting if turn.at_mm == start),
            bends=start >= straight_to_mm,
        )
        for start, end in pairwise(cuts)
    ]


def advance_pose(tip: TipState, steps: Sequence[TipObservation]) -> FloatArray:
    """Return the pose (4, 4) after these steps, equations (16) and (17); the tip stays behind by its slip."""
    rotation, position = tip.rotation, tip.position_mm
    for step in steps:
        bend = tip.curvature if step.bends else 0.0
        turn, advance = step_frame(step.roll_rad, step.step_mm * (1.0 - tip.slip), bend)
        position, rotation = position + rotation @ advance, rotation @ turn
    return make_pose(rotation, position)
