"""How the bend of the tip follows the bevel: late, because the hinges have to swing over.

After a turn of the bevel the curvature swings over linearly along a few millimetres, the backlash. The heading that
results is the one of a bend that changes at once, half the backlash later; the place differs by less than curvature
times backlash squared over 24, which is 0.004 mm here. In the same way a tip whose hinges close along the first
millimetres goes straight along half of them. So a path stays one of arcs, and every turn acts where it was made
plus a lag.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labrig.needle.kinematics import rotation_x, rotation_z
from labrig.steering.motion import step_position_mm
from labrig.steering.tip import FloatArray, frozen


@dataclass(frozen=True)
class Turn:
    """A turn of the bend about the needle's axis, at an insertion length."""

    at_mm: float
    roll_rad: float


@dataclass(frozen=True)
class Stretch:
    """A length along which the tip keeps its bend, after a turn of it; `bends` is False where it goes straight."""

    length_mm: float
    roll_rad: float
    bends: bool


def stretches(
    from_mm: float, to_mm: float, turns: tuple[Turn, ...], straight_to_mm: float
) -> tuple[Stretch, ...]:
    """Return what the tip does between two insertion lengths; a turn at the second of them is left out."""
    acting = [turn for turn in turns if from_mm <= turn.at_mm < to_mm]
    between = {turn.at_mm for turn in acting} | {straight_to_mm}
    cuts = sorted({from_mm, to_mm} | {cut for cut in between if from_mm < cut < to_mm})
    return tuple(
        Stretch(
            length_mm=end - start,
            roll_rad=sum(turn.roll_rad for turn in acting if turn.at_mm == start),
            bends=start >= straight_to_mm,
        )
        for start, end in pairwise(cuts)
    )


def advanced(pose: FloatArray, along: tuple[Stretch, ...], curvature: float) -> FloatArray:
    """Return the pose (4, 4) after these stretches, equations (16) and (17)."""
    rotation, position = pose[:3, :3], pose[:3, 3]
    for stretch in along:
        bend = curvature if stretch.bends else 0.0
        rolled = rotation @ rotation_z(stretch.roll_rad)
        position = position + rolled @ step_position_mm(stretch.length_mm, bend)
        rotation = rolled @ rotation_x(stretch.length_mm * bend)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = rotation, position
    return frozen(moved)
