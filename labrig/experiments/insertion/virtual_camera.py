"""What the camera of a simulated rig would say of sheath, tip and shaft, without pictures.

A place is seen where the world's lens shows it, and read by the map of the plane that the rig was calibrated with, as
from a picture. What else is off in pictures is drawn: `SIGHTING_ERRORS`, which were fitted to runs of the whole rig.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from labrig.experiments.insertion.virtual_shaft import SHAFT_ERRORS, SeenPath, draw_shaft
from labrig.needle.kinematics import FloatArray
from labrig.simulation.description import LensDescription
from labrig.simulation.lens import plane_to_pixels
from labrig.simulation.parallax import see_points
from labrig.simulation.world import World
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import ShaftTip
from labrig.vision.sheath import SheathPose


@dataclass(frozen=True)
class SightingErrors:
    """Errors of places and directions that are measured in pictures, besides those of the map.

    Attributes
    ----------
    tip_sd_mm : float
        Of the tip by its template, along each axis.
    sheath_sd_mm, sheath_sd_rad : float
        Of the sheath's end along each axis, and of its heading.
    """

    tip_sd_mm: float
    sheath_sd_mm: float
    sheath_sd_rad: float


SIGHTING_ERRORS = SightingErrors(tip_sd_mm=0.05, sheath_sd_mm=0.01, sheath_sd_rad=math.radians(0.05))

_SHEATH_MM = 5.0
"""Length of the sheath's end whose direction is seen."""


class VirtualCamera(Protocol):
    """What is seen in a world, without pictures, and how the rig maps it."""

    plane: PlaneMap

    def see_tip(self, world: World) -> FloatArray | None:
        """Return where the tip is seen (x, y, z), with x 0; None where it is not found."""
        ...

    def see_shaft(self, path_mm: FloatArray, diameter_mm: float) -> ShaftTip | None:
        """Return the shaft of a needle with this path (N, 3); None where it cannot be measured."""
        ...


@dataclass
class CalibratedCamera:
    """The camera of a rig, with the map of the plane that it was calibrated with.

    Attributes
    ----------
    lens : LensDescription
        The world's own.
    plane : PlaneMap
        The rig's.
    noise : Generator
        Draws the errors.
    errors : SightingErrors
    """

    lens: LensDescription
    plane: PlaneMap
    noise: np.random.Generator
    errors: SightingErrors = field(default=SIGHTING_ERRORS)

    def locate(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where points (N, 3) are read in the plane (N, 2), as (y, z), and their scales (N,)."""
        flat_mm, scales = see_points(points_mm, self.lens)
        return self.plane.to_mm(plane_to_pixels(flat_mm, self.lens)), scales

    def see_tip(self, world: World) -> FloatArray:
        """Return where the tip is seen (x, y, z), with x 0."""
        seen_mm = self.locate(np.array([world.tip_mm()]))[0][0]
        return np.array((0.0, *(seen_mm + self.noise.normal(0.0, self.errors.tip_sd_mm, 2))))

    def see_sheath(self, world: World) -> SheathPose:
        """Return the pose of the sheath, as measured in a picture."""
        points_mm = np.array([world.sheath_point_mm(_SHEATH_MM), world.sheath_point_mm(0.0)])
        before, end = self.locate(points_mm)[0]
        y, z = (end + self.noise.normal(0.0, self.errors.sheath_sd_mm, 2)).tolist()
        heading_rad = math.atan2(*(end - before)) + self.noise.normal(0.0, self.errors.sheath_sd_rad)
        u, v = self.plane.to_px(np.array([[y, z]]))[0].tolist()
        return SheathPose((u, v), (y, z), float(heading_rad), world.description.sheath.diameter_mm)

    def see_shaft(self, path_mm: FloatArray, diameter_mm: float) -> ShaftTip:
        """Return the shaft of a needle with this path (N, 3)."""
        seen = SeenPath.of(*self.locate(path_mm))
        return draw_shaft(seen, self.plane, diameter_mm, self.noise, SHAFT_ERRORS)
