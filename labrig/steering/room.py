"""Room to turn aside: the clearance that a needle would have if it bent away from an obstacle from here on.

A needle cannot bend more tightly than its radius. A path may pass an obstacle with clearance and still have little
room, if it bends away all the way there: a tip that strays towards the obstacle can then no longer pass it on that
side. Room is largest at the start, and a needle that first bends one way and then the other uses it up on both sides.
"""

import numpy as np

from labrig.needle.kinematics import ArcFrames, FloatArray
from labrig.steering.clearance import find_nearest_places
from labrig.steering.problem import Surroundings


def find_least_rooms(psi: FloatArray, frames: ArcFrames, around: Surroundings) -> FloatArray:
    """Return the least room of each path (M, n, 2) in the plane, (M,) [mm]; infinite without an obstacle ahead.

    Each obstacle that cuts the plane counts on the side on which the path passes it. The room is negative where even
    the tightest bend would touch.
    """
    radius_mm, centres, touching_mm = (
        around.problem.radius_mm,
        around.centres_mm,
        around.needle_and_obstacle_mm,
    )
    ahead = (centres[:, 2] > 0.0) & (np.abs(centres[:, 0]) < touching_mm)
    if not ahead.any():
        return np.full(len(psi), np.inf)
    centres = centres[ahead]
    disc_radii_mm = np.sqrt(touching_mm[ahead] ** 2 - centres[:, 0] ** 2)
    places = find_nearest_places(psi, radius_mm, centres, frames).places_mm
    sides = np.where(places[..., 1] > centres[:, 1], 1.0, -1.0)
    from_middle = np.hypot(centres[:, 2], radius_mm - sides * centres[:, 1])
    return np.asarray((from_middle - radius_mm - disc_radii_mm).min(axis=-1))
