"""Disturbances of the path that the hinges alone would cut: uneven gel, a wandering tip, cavities.

They are drawn once for a path, on its fixed grid of nodes, so that a path does not depend on how often it was
extended.
"""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import accumulate

import numpy as np

from labrig.simulation.description import DisturbancesDescription
from labrig.simulation.lens import Floats

NODE_MM = 0.05  # arc length between nodes
LONGEST_PATH_MM = 500.0
_STRETCHES = round(LONGEST_PATH_MM / NODE_MM)
_CAVITIES_BETWEEN = (12.0, 90.0)  # along the path, before the end of an insertion [mm]


@dataclass(frozen=True, eq=False)
class Unevenness:
    """For each stretch between nodes: the share of the curvature that is left, and the tip's own turns.

    curvature_share (N,) : 1 in even gel, 0 in a cavity; turn_rad (N,) in the plane; lean_rad (N,) out of it.
    """

    curvature_share: Floats
    turn_rad: Floats
    lean_rad: Floats

    @cached_property
    def stretches(self) -> tuple[list[float], list[float], list[float]]:
        """The three as a path takes them, stretch by stretch."""
        return self.curvature_share.tolist(), self.turn_rad.tolist(), self.lean_rad.tolist()


@cache
def no_unevenness() -> Unevenness:
    """Return even gel, without disturbances."""
    return Unevenness(np.ones(_STRETCHES), np.zeros(_STRETCHES), np.zeros(_STRETCHES))


def draw_unevenness(disturbances: DisturbancesDescription, random: np.random.Generator) -> Unevenness:
    """Draw the disturbances of a path.

    The curvature's share wanders about 1 as an Ornstein-Uhlenbeck process, so that its spread does not depend on the
    grid; the tip's turns are white noise, so that the heading's spread grows with the root of the length.
    """
    steps = random.standard_normal((3, _STRETCHES))
    share = 1.0 + disturbances.curvature_fraction * _draw_wander(steps[0], disturbances.curvature_length_mm)
    for start_mm, end_mm in _draw_cavities(disturbances, random):
        share[int(start_mm / NODE_MM) : int(end_mm / NODE_MM)] = 0.0
    per_stretch = math.sqrt(NODE_MM)
    return Unevenness(
        share,
        math.radians(disturbances.heading_deg_per_root_mm) * per_stretch * steps[1],
        math.radians(disturbances.out_of_plane_deg_per_root_mm) * per_stretch * steps[2],
    )


def _draw_wander(steps: Floats, length_mm: float) -> Floats:
    """Return noise of unit standard deviation with this correlation length, (N,)."""
    kept = math.exp(-NODE_MM / length_mm)
    fresh = math.sqrt(1.0 - kept**2)
    drawn = (fresh * steps).tolist()
    drawn[0] = float(steps[0])
    return np.array(list(accumulate(drawn, lambda value, step: kept * value + step)))


def _draw_cavities(
    disturbances: DisturbancesDescription, random: np.random.Generator
) -> list[tuple[float, float]]:
    starts = random.uniform(*_CAVITIES_BETWEEN, disturbances.cavities)
    lengths = random.uniform(*disturbances.cavity_mm, disturbances.cavities)
    return list(zip(starts.tolist(), (starts + lengths).tolist(), strict=True))
