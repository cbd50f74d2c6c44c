"""What the pictures of a hole say about the torsion of the needle, for the live run and its reanalysis."""

import math
from collections.abc import Sequence

import numpy as np

from labrig.experiments.shared.roll_zero_events import TorsionHole
from labrig.protocol.sections import TorsionSteps
from labrig.steering.torsion_fit import BendLengths, TorsionBend
from labrig.vision.circle import fit_circle
from labrig.vision.shaft_tip import ShaftTip

ARC_MM = 20.0
"""Length of the arcs to the depth of the turn; the needle bends to one side and to the other, and stays in view."""

BENT_MM = 12.0
"""Length of the arc at the roll zero whose deflection gives the radius."""

# A circle is fitted to the last arc before the turn, where the hinges have swung over, and before the bevel's onset.
_FITTED_MM = (0.5, 16.0)


def find_lengths(steps: TorsionSteps) -> BendLengths:
    """Return the lengths over which the deflections are measured."""
    return BendLengths(BENT_MM, steps.further_mm, steps.backlash_mm)


def list_arcs_mm(depth_mm: float) -> list[float]:
    """Return the lengths of the arcs to a depth, the shortest first."""
    first_mm = depth_mm % ARC_MM or ARC_MM
    return [first_mm, *[ARC_MM] * round((depth_mm - first_mm) / ARC_MM)]


def measure_bend(hole: TorsionHole, turn: ShaftTip, end: ShaftTip) -> TorsionBend:
    """Return the deflections in a hole from its two pictures: at the turn, and at the end.

    Raises
    ------
    MeasurementRefusedError
        When the needle at the turn shows no arc.
    """
    line_mm = turn.centre_line_mm
    left_mm = turn.length_mm - np.concatenate(
        ([0.0], np.cumsum(np.linalg.norm(np.diff(line_mm, axis=0), axis=1)))
    )
    circle = fit_circle(line_mm[(left_mm >= _FITTED_MM[0]) & (left_mm <= _FITTED_MM[1])])
    out_mm = np.array(turn.tip_mm) - circle.centre
    # The tangent at the tip, ahead: at right angles to the radius, on the side to which the needle heads.
    side = np.sign(out_mm[0] * math.cos(turn.heading_rad) - out_mm[1] * math.sin(turn.heading_rad))
    return TorsionBend(
        hole.depth_mm,
        hole.direction,
        hole.depth_mm - list_arcs_mm(hole.depth_mm)[-1],
        float(-side * circle.radius * (1.0 - math.cos(BENT_MM / circle.radius))),
        _deflect_mm(turn.tip_mm, math.atan2(-side * out_mm[1], side * out_mm[0]), end.tip_mm),
    )


def _deflect_mm(start_mm: Sequence[float], heading_rad: float, end_mm: Sequence[float]) -> float:
    """Return how far a tip is aside of the straight line ahead of an earlier one, towards +y."""
    y_mm, z_mm = end_mm[0] - start_mm[0], end_mm[1] - start_mm[1]
    return y_mm * math.cos(heading_rad) - z_mm * math.sin(heading_rad)
