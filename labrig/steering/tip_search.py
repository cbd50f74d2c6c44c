"""Searches for the tip in a picture: near the estimate, and more widely and at any heading after misses.

A live insertion and the analysis of its record search by this one function, so that a record is gone through again as
it was.
"""

import math
from dataclasses import dataclass

import numpy as np

from labrig.needle.kinematics import FloatArray
from labrig.steering.tip import TipState
from labrig.vision.picture import Mask, Picture
from labrig.vision.plane import PlaneMap
from labrig.vision.template import TipTemplate
from labrig.vision.tip import TipFix, locate_tip

_SIGMAS = 4.0
_LEAST_REACH_PX = 12.0
# Growth of the region with each miss, up to so many.
_GROWTH, _MOST_MISSES = 1.6, 16
_MISSES_WITH_HEADING = 2
"""A cavity leads the heading astray by as much as a fix may turn; after so many misses every heading is tried."""


@dataclass(frozen=True, eq=False)
class TipView:
    """Plane map, mask and template for finding the tip; the template's heading is relative to that plane."""

    plane: PlaneMap
    template: TipTemplate
    mask: Mask | None = None


@dataclass(frozen=True, eq=False)
class TipSearched:
    """Where the tip was searched for, and what was found; `position_mm` (3,) is None if it was not found.

    region_px : side of the square around `near_px` that was searched.
    """

    fix: TipFix
    position_mm: FloatArray | None
    near_px: tuple[float, float]
    heading_rad: float
    region_px: float


def find_tip(
    view: TipView, image: Picture, expected: FloatArray, tip: TipState, roll_rad: float
) -> TipSearched:
    """Find the tip near where it is expected; the more pictures have shown none, the wider, and then at any heading.

    Parameters
    ----------
    expected : (4, 4) array
        Predicted pose of the tip.
    tip : TipState
        The last estimate, whose uncertainty and misses set how far is searched.
    roll_rad : float
        Of the bevel.
    """
    u, v = view.plane.to_px(expected[None, 1:3, 3])[0].tolist()
    heading_rad = math.atan2(expected[1, 2], expected[2, 2])
    reach_px = max(_LEAST_REACH_PX, _SIGMAS * tip.position_sd_mm / view.plane.mm_per_px)
    region_px = (max(view.template.picture.shape) + 2 * reach_px) * _GROWTH ** min(tip.misses, _MOST_MISSES)
    fix = locate_tip(
        image,
        view.template,
        near_px=(u, v),
        heading_rad=heading_rad if tip.misses < _MISSES_WITH_HEADING else None,
        roll_rad=roll_rad,
        region_px=region_px,
        mask=view.mask,
    )
    position = None
    if fix.tip_px is not None:
        position = np.array((0.0, *view.plane.to_mm(np.array([fix.tip_px]))[0]))
    return TipSearched(fix, position, (u, v), heading_rad, region_px)
