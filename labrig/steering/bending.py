"""How the bend of the tip follows the bevel: with a lag, because the hinges have to swing over.

After a turn of the bevel the curvature swings over linearly along a few millimetres, the backlash. The heading is
then that of a bend that changes at once, but half the backlash later; the position differs by less than curvature
times backlash squared over 24, which is 0.004 mm here. Likewise a tip whose hinges close along the first
millimetres goes straight along half of them. So a path still consists of arcs, and every turn acts a lag after the
place where it was made.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labrig.needle.kinematics import FloatArray, rotation_x, rotation_z
from labrig.steering.motion import step_position_mm
from labrig.steering.tip import TipObservation, freeze


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


def advance_pose(
    pose: FloatArray, steps: Sequence[TipObservation], curvature: float, slip: float = 0.0
) -> FloatArray:
    """Return the pose (4, 4) after these steps, equations (16) and (17); the tip stays behind by a share of each."""
    rotation, position = pose[:3, :3], pose[:3, 3]
    for step in steps:
        bend, step_mm = curvature if step.bends else 0.0, step.step_mm * (1.0 - slip)
        rolled = rotation @ rotation_z(step.roll_rad)
        position = position + rolled @ step_position_mm(step_mm, bend)
        rotation = rolled @ rotation_x(step_mm * bend)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = rotation, position
    return freeze(moved)
