"""What perspective does to points out of the plane of the map.

A point at x behind the plane (away from the camera) is seen where its line of sight meets the plane, nearer to the
camera's foot than it is, and as much smaller as it is farther away. So what the map states for it is off by x over the
camera's height for each millimetre from the foot. In gel the lines of sight are steeper, by about the gel's index.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Perspective:
    """The camera's foot on the plane (y, z), and its height, enlarged by the index of the gel [mm]."""

    foot_mm: FloatArray
    height_mm: float

    @classmethod
    def of(cls, plane: PlaneMap) -> "Perspective | None":
        """Return the perspective of a map; None where the camera's place is not known."""
        if plane.intrinsics is None:
            return None
        y, z, height_mm = plane.camera_mm()
        return cls(np.array((y, z)), float(height_mm) * (1.0 if plane.gel is None else plane.gel.index))

    def find_slope(self, seen_mm: FloatArray) -> FloatArray:
        """Return by how much (y, z) the true place moves for each millimetre of x along the line of sight, (2,)."""
        return np.asarray((seen_mm - self.foot_mm) / self.height_mm)
