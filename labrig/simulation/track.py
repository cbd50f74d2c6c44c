"""The path that the needle cuts into the gel.

Headings are zero along +z and positive towards +y. A bevel at roll 0 bends the path towards -y, at roll pi
towards +y (equation 5 of the paper): the final curvature at roll delta is -cos(delta) / r in the plane and
sin(delta) / r out of it, towards +x; in a layer of a phantom, r is scaled. The roll by which a lean turns the bevel's
frame, of second order, is left out. The hinges need arc length to close: over the first `hinge_closing_mm` the
curvature grows linearly. From then on only their play matters: after half a turn of the bevel the curvature swings over
in `backlash_mm`.

What disturbs a path (uneven gel, a wandering tip, cavities) is drawn once for it, on its fixed grid of nodes, so that
a path does not depend on how often it was extended. The bevel follows its base, which the drive turns, with play:
friction along the needle holds it until the base has wound it up, however long one waits (Reed, Okamura and Cowan
2009, IEEE Trans. Biomed. Eng. 56(12)).
"""

import math
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from labrig.simulation.description import DisturbancesDescription, LayerDescription, NeedleDescription
from labrig.simulation.lens import Floats

NODE_MM = 0.05  # arc length between nodes
_SHORTEST_STRETCH_MM = 1e-6  # a shorter one at the end has no direction
LONGEST_PATH_MM = 500.0
_STRETCHES = round(LONGEST_PATH_MM / NODE_MM)
_CAVITIES_BETWEEN = (12.0, 90.0)  # along the path, before the end of an insertion [mm]


class Unevenness(NamedTuple):
    """For each stretch between nodes: the share of the curvature that is left, and the tip's own turns.

    curvature_share (N) : 1 in even gel, 0 in a cavity; turn_rad (N) in the plane; lean_rad (N) out of it.
    """

    curvature_share: list[float]
    turn_rad: list[float]
    lean_rad: list[float]

    def turns_in(self, stretch: int, length_mm: float) -> tuple[float, float]:
        """Return how the tip turns by itself in the first `length_mm` of a stretch, in the plane and out of it."""
        part = length_mm / NODE_MM
        return part * self.turn_rad[stretch], part * self.lean_rad[stretch]


EVEN = Unevenness([1.0] * _STRETCHES, [0.0] * _STRETCHES, [0.0] * _STRETCHES)
"""Gel without disturbances."""


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
        share.tolist(),
        (math.radians(disturbances.heading_deg_per_root_mm) * per_stretch * steps[1]).tolist(),
        (math.radians(disturbances.out_of_plane_deg_per_root_mm) * per_stretch * steps[2]).tolist(),
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


def follow_with_play(bevel_rad: float, base_rad: float, lag_rad: float) -> float:
    """Return the bevel's angle after the base has turned, by the play operator: never further away than the lag.

    Parameters
    ----------
    bevel_rad : float
        Angle of the bevel before.
    base_rad : float
        Angle of the base now.
    lag_rad : float
        By how much the bevel can be behind, in each direction.
    """
    return min(max(bevel_rad, base_rad - lag_rad), base_rad + lag_rad)


class PathNode(NamedTuple):
    """A point of the path: arc length, position, heading, and curvature (d heading / d arc).

    x_mm, lean_rad, bend_1_mm : the same out of the plane: place, angle towards +x, and its change with the arc.
    """

    arc_mm: float
    y_mm: float
    z_mm: float
    heading_rad: float
    curvature_1_mm: float
    x_mm: float = 0.0
    lean_rad: float = 0.0
    bend_1_mm: float = 0.0

    def advance(
        self,
        length_mm: float,
        curvature_1_mm: float,
        bend_1_mm: float = 0.0,
        wander: tuple[float, float] = (0.0, 0.0),
        arc_mm: float | None = None,
    ) -> "PathNode":
        """Return the node `length_mm` further on, if curvature and bend change linearly to these values.

        Its arc length is `arc_mm`, where a grid has it without the sum's rounding. `wander` is the additional turn of
        the tip in the plane and out of it. The heading is the azimuth of a needle that leans: it changes by more than
        the angle through which the needle bends.
        """
        before_mm, y_mm, z_mm, heading_rad, curved_1_mm, x_mm, lean_rad, bent_1_mm = self
        lean = 0.5 * (bent_1_mm + bend_1_mm) * length_mm + wander[1]
        halfway_rad = lean_rad + 0.5 * lean
        along = math.cos(halfway_rad)
        turn = (0.5 * (curved_1_mm + curvature_1_mm) * length_mm + wander[0]) / along
        middle_rad = heading_rad + 0.5 * turn
        chord_mm = length_mm * (1.0 - turn * turn / 24.0)  # of a short arc
        in_plane_mm = chord_mm * along
        return PathNode(
            before_mm + length_mm if arc_mm is None else arc_mm,
            y_mm + in_plane_mm * math.sin(middle_rad),
            z_mm + in_plane_mm * math.cos(middle_rad),
            heading_rad + turn,
            curvature_1_mm,
            x_mm + chord_mm * math.sin(halfway_rad),
            lean_rad + lean,
            bend_1_mm,
        )


class Track:
    """A path that grows at its end; a needle that was withdrawn follows it again.

    Parameters
    ----------
    start : PathNode
        Where the needle leaves the sheath, and in its direction; at arc length 0, straight.
    radius_mm : float
        Radius with closed hinges; infinite for a straight path.
    needle : NeedleDescription
        How its hinges close, and their play.
    unevenness : Unevenness
        Disturbances; none by default.
    layers : tuple of LayerDescription
        Where the radius is scaled.
    """

    def __init__(
        self,
        start: PathNode,
        radius_mm: float,
        needle: NeedleDescription,
        unevenness: Unevenness = EVEN,
        layers: tuple[LayerDescription, ...] = (),
    ) -> None:
        self._curvature_1_mm = 1.0 / radius_mm
        self._hinge_closing_mm = needle.hinge_closing_mm
        self._closing_rate_1_mm2 = self._curvature_1_mm / needle.hinge_closing_mm
        self._swing_rate_1_mm2 = 2.0 * self._curvature_1_mm / needle.backlash_mm
        self._uneven = unevenness
        self._layers = layers
        self._nodes = [start]
        self._end = start

    @property
    def length_mm(self) -> float:
        """The arc length cut so far."""
        return self._end.arc_mm

    def extend(self, arc_mm: float, roll_rad: float) -> None:
        """Bring the tip to `arc_mm` with the bevel at `roll_rad`: along the existing cut, and then cutting on."""
        if arc_mm <= self.length_mm:
            return
        nodes, bevel = self._nodes, (-math.cos(roll_rad), math.sin(roll_rad))
        while arc_mm >= len(nodes) * NODE_MM:
            grown = self._step(nodes[-1], NODE_MM, bevel, len(nodes) * NODE_MM)
            nodes.append(grown)
        self._end = self._step(nodes[-1], arc_mm - nodes[-1].arc_mm, bevel)

    def _step(
        self, node: PathNode, length_mm: float, bevel: tuple[float, float], arc_mm: float | None = None
    ) -> PathNode:
        """Return the node a length further on; `bevel` are the shares of the curvature in the plane and out of it."""
        closing = node.arc_mm < self._hinge_closing_mm
        limit = (self._closing_rate_1_mm2 if closing else self._swing_rate_1_mm2) * length_mm
        stretch = len(self._nodes) - 1
        share = self._uneven.curvature_share[stretch]
        if self._layers:
            share /= next((layer.radius_scale for layer in self._layers if node.z_mm < layer.until_mm), 1.0)
        sought = self._curvature_1_mm * share
        curvature_1_mm = _approach(node.curvature_1_mm, bevel[0] * sought, limit)
        bend_1_mm = _approach(node.bend_1_mm, bevel[1] * sought, limit)
        return node.advance(
            length_mm, curvature_1_mm, bend_1_mm, self._uneven.turns_in(stretch, length_mm), arc_mm
        )

    def node_at(self, arc_mm: float) -> PathNode:
        """Return the path at an arc length; it is straight before its start and stays at its end."""
        if arc_mm <= 0:
            return self._nodes[0].advance(arc_mm, 0.0)
        if arc_mm >= self.length_mm:
            return self._end
        index = min(int(arc_mm / NODE_MM), len(self._nodes) - 1)
        before, after = [*self._nodes[index : index + 2], self._end][:2]
        part = (arc_mm - before.arc_mm) / (after.arc_mm - before.arc_mm)
        return before.advance(
            arc_mm - before.arc_mm,
            before.curvature_1_mm + part * (after.curvature_1_mm - before.curvature_1_mm),
            before.bend_1_mm + part * (after.bend_1_mm - before.bend_1_mm),
            self._uneven.turns_in(index, arc_mm - before.arc_mm),
        )

    def points_mm(self, from_arc_mm: float = 0.0) -> Floats:
        """Return the path in space from an arc length, straight before 0, to the end.

        (N, 4), columns arc, x, y, z; spaced `NODE_MM` in arc except for the last.
        """
        before = [self.node_at(-count * NODE_MM) for count in range(math.ceil(-from_arc_mm / NODE_MM), 0, -1)]
        is_on_grid = self._end.arc_mm - self._nodes[-1].arc_mm < _SHORTEST_STRETCH_MM
        nodes = [*before, *self._nodes, *([] if is_on_grid else [self._end])]
        return np.array([(n.arc_mm, n.x_mm, n.y_mm, n.z_mm) for n in nodes])


def _approach(value: float, sought: float, limit: float) -> float:
    """Return the value moved towards the sought value by at most the limit."""
    away = sought - value
    if away > limit:
        return value + limit
    return value - limit if away < -limit else value + away
