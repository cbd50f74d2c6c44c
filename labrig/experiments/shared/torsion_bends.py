"""What the pictures of a hole say about the torsion of the needle, for the live run and its reanalysis."""

import math

from labrig.experiments.shared.roll_zero_events import TorsionHole
from labrig.protocol.sections import TorsionSteps
from labrig.steering.torsion_fit import BendLengths, TorsionBend
from labrig.vision.shaft_tip import ShaftTip

ARC_MM = 20.0
"""Length of the arcs to the depth of the turn; the needle bends to one side and to the other, and stays in view."""

BENT_MM = 12.0
"""Length before the turn, of which the bend at the roll zero gives the radius; the hinges have swung over before."""


def find_lengths(steps: TorsionSteps) -> BendLengths:
    """Return the lengths over which the deflections are measured."""
    return BendLengths(BENT_MM, steps.further_mm, steps.backlash_mm)


def list_arcs_mm(depth_mm: float) -> list[float]:
    """Return the lengths of the arcs to a depth, the shortest first."""
    first_mm = depth_mm % ARC_MM or ARC_MM
    return [first_mm, *[ARC_MM] * round((depth_mm - first_mm) / ARC_MM)]


def measure_bend(hole: TorsionHole, bent: ShaftTip, turn: ShaftTip, end: ShaftTip) -> TorsionBend:
    """Return the deflections in a hole from its three pictures: before the last bend, at the turn, at the end."""
    return TorsionBend(
        hole.depth_mm,
        hole.direction,
        hole.depth_mm - list_arcs_mm(hole.depth_mm)[-1],
        _deflect_mm(bent, turn),
        _deflect_mm(turn, end),
    )


def _deflect_mm(start: ShaftTip, end: ShaftTip) -> float:
    """Return how far a tip is aside of the straight line ahead of another, towards +y."""
    y_mm, z_mm = end.tip_mm[0] - start.tip_mm[0], end.tip_mm[1] - start.tip_mm[1]
    return y_mm * math.cos(start.heading_rad) - z_mm * math.sin(start.heading_rad)
