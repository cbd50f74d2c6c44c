"""How the bend of the tip follows the bevel: with a lag, because the hinges have to swing over.

After a turn of the bevel the curvature swings over linearly along a few millimetres, the backlash. The heading is
then that of a bend that changes at once, but half the backlash later; the position differs by less than curvature
times backlash squared over 24, which is 0.004 mm here. Likewise a tip whose hinges close along the first
millimetres goes straight along half of them. So a path still consists of arcs, and every turn acts a lag after the
place where it was made.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labrig.needle.kinematics import FloatArray, rotation_x, rotation_z
from labrig.steering.motion import step_position_mm
from labrig.steering.tip import freeze


@dataclass(frozen=True)
class Turn:
    """A turn of the bend about the needle's axis, at an insertion length."""

    at_mm: float
    roll_rad: float


@dataclass(frozen=True)
class PathStretch:
    """A turn of the bend, then a length without another; `bends` is False where the tip goes straight."""

    length_mm: float
    roll_rad: float
    bends: bool


def split_into_stretches(
    from_mm: float, to_mm: float, turns: tuple[Turn, ...], straight_to_mm: float
) -> tuple[PathStretch, ...]:
    """Return the stretches between two insertion lengths, without a turn at the second length."""
    acting = [turn for turn in turns if from_mm <= turn.at_mm < to_mm]
    between = {turn.at_mm for turn in acting} | {straight_to_mm}
    cuts = sorted({from_mm, to_mm} | {cut for cut in between if from_mm < cut < to_mm})
    return tuple(
        PathStretch(
            length_mm=end - start,
            roll_rad=sum(turn.roll_rad for turn in acting if turn.at_mm == start),
            bends=start >= straight_to_mm,
        )
        for start, end in pairwise(cuts)
    )


def shorten(along: tuple[PathStretch, ...], slip: float) -> tuple[PathStretch, ...]:
    """Return the stretches by which the tip advances when it stays behind by this share of what is inserted."""
    return tuple(
        PathStretch(stretch.length_mm * (1.0 - slip), stretch.roll_rad, stretch.bends) for stretch in along
    )


def advance_pose(pose: FloatArray, along: tuple[PathStretch, ...], curvature: float) -> FloatArray:
    """Return the pose (4, 4) at the end of these stretches, equations (16) and (17)."""
    rotation, position = pose[:3, :3], pose[:3, 3]
    for stretch in along:
        bend = curvature if stretch.bends else 0.0
        rolled = rotation @ rotation_z(stretch.roll_rad)
        position = position + rolled @ step_position_mm(stretch.length_mm, bend)
        rotation = rolled @ rotation_x(stretch.length_mm * bend)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = rotation, position
    return freeze(moved)
