"""The path that the needle cuts into the gel, in the steering plane.

Headings are zero along +z and positive towards +y. A bevel at roll 0 bends the path towards -y, at roll pi
towards +y (equation 5 of the paper). Only the component in the plane is followed: the curvature sought at
roll delta is -cos(delta) / r, and what leaves the plane at other rolls is not drawn. The hinges need arc
length to close: curvature changes by at most 1 / (r * hinge_closing_mm) per mm, so it grows linearly over the
first millimetres, and a turned bevel takes twice that length.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from labrig.simulation.lens import Floats

NODE_MM = (
    0.05  # nodes stand on a fixed grid of arc length, so a path does not depend on how often it was extended
)


@dataclass(frozen=True)
class Node:
    """A point of the path: arc length, position, heading, and curvature (d heading / d arc)."""

    arc_mm: float
    y_mm: float
    z_mm: float
    heading_rad: float
    curvature_1_mm: float

    def beyond(self, length_mm: float, curvature_1_mm: float) -> "Node":
        """Return the node `length_mm` further on, if curvature reaches `curvature_1_mm` there linearly."""
        turn = 0.5 * (self.curvature_1_mm + curvature_1_mm) * length_mm
        middle = self.heading_rad + 0.5 * turn
        chord = length_mm * (math.sin(0.5 * turn) / (0.5 * turn) if abs(turn) > 1e-9 else 1.0)
        return Node(
            self.arc_mm + length_mm,
            self.y_mm + chord * math.sin(middle),
            self.z_mm + chord * math.cos(middle),
            self.heading_rad + turn,
            curvature_1_mm,
        )


class Track:
    """A path that can only grow.

    Parameters
    ----------
    start_mm : (float, float)
        Where the needle left the sheath, (y, z).
    heading_rad : float
        Direction of the sheath.
    radius_mm : float
        Radius of curvature once the hinges are closed; infinite for a straight path.
    hinge_closing_mm : float
        Arc length over which the hinges close.
    """

    def __init__(
        self, start_mm: tuple[float, float], heading_rad: float, radius_mm: float, hinge_closing_mm: float
    ) -> None:
        self._curvature_1_mm = 1.0 / radius_mm
        self._closing_rate_1_mm2 = self._curvature_1_mm / hinge_closing_mm
        self._nodes = [Node(0.0, *start_mm, heading_rad, 0.0)]
        self._end = self._nodes[0]

    @property
    def length_mm(self) -> float:
        """Return the arc length cut so far."""
        return self._end.arc_mm

    def extend(self, arc_mm: float, roll_rad: float) -> None:
        """Cut on to `arc_mm` with the bevel at `roll_rad`; what is cut already stays."""
        if arc_mm <= self.length_mm:
            return
        while arc_mm >= len(self._nodes) * NODE_MM:
            grown = self._step(self._nodes[-1], NODE_MM, roll_rad)
            self._nodes.append(replace(grown, arc_mm=len(self._nodes) * NODE_MM))
        self._end = self._step(self._nodes[-1], arc_mm - self._nodes[-1].arc_mm, roll_rad)

    def _step(self, node: Node, length_mm: float, roll_rad: float) -> Node:
        limit = self._closing_rate_1_mm2 * length_mm
        change = -math.cos(roll_rad) * self._curvature_1_mm - node.curvature_1_mm
        return node.beyond(length_mm, node.curvature_1_mm + max(-limit, min(limit, change)))

    def at(self, arc_mm: float) -> Node:
        """Return the path at an arc length; before its start it is straight, past its end it stops."""
        if arc_mm <= 0:
            return self._nodes[0].beyond(arc_mm, 0.0)
        if arc_mm >= self.length_mm:
            return self._end
        index = min(int(arc_mm / NODE_MM), len(self._nodes) - 1)
        before, after = (
            self._nodes[index],
            self._nodes[index + 1] if index + 1 < len(self._nodes) else self._end,
        )
        part = (arc_mm - before.arc_mm) / (after.arc_mm - before.arc_mm)
        return before.beyond(
            arc_mm - before.arc_mm,
            before.curvature_1_mm + part * (after.curvature_1_mm - before.curvature_1_mm),
        )

    def table(self, from_arc_mm: float = 0.0) -> Floats:
        """Return nodes from an arc length, straight before 0, to the end.

        (N, 5), columns arc, y, z, heading, curvature; arcs `NODE_MM` apart but for the last.
        """
        before = [self.at(-count * NODE_MM) for count in range(math.ceil(-from_arc_mm / NODE_MM), 0, -1)]
        end = [] if self._end.arc_mm == self._nodes[-1].arc_mm else [self._end]
        rows = [
            (n.arc_mm, n.y_mm, n.z_mm, n.heading_rad, n.curvature_1_mm) for n in [*before, *self._nodes, *end]
        ]
        return np.array(rows)
