"""Where a camera sees what is not in the plane of the map.

A point at x behind the plane (away from the camera) is seen where its line of sight meets the plane, nearer to the
camera's foot than it is. So what the map states for it is off by x over the camera's height for each millimetre from
the foot. In gel the line of sight is steeper, by about the gel's index.
"""

import numpy as np
from numpy.typing import NDArray

from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]


def find_slope(plane: PlaneMap, seen_mm: FloatArray) -> FloatArray:
    """Return by how much (y, z) the true place moves per millimetre of x along the line of sight, (2,).

    Zero for parallel rays, and where the camera's place is not known.

    Parameters
    ----------
    plane : PlaneMap
    seen_mm : ndarray (2,)
        The place (y, z) that the map states.
    """
    if plane.telecentric or plane.intrinsics is None:
        return np.zeros(2)
    y, z, height_mm = plane.camera_mm()
    index = 1.0 if plane.gel is None else plane.gel.index
    return np.asarray((seen_mm - np.array((y, z))) / (height_mm * index))
