"""What the camera of a simulated rig would say of sheath, tip and shaft, without pictures.

A place is seen where the world's lens shows it, and read by the map of the plane that the rig was calibrated with, as
from a picture. What else is off in pictures is drawn: `SIGHTING_ERRORS`, which were fitted to runs of the whole rig.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from labrig.experiments.insertion.aim import RIM_PX
from labrig.experiments.insertion.virtual_shaft import SeenPath, draw_shaft, square_distances
from labrig.needle.kinematics import FloatArray
from labrig.simulation.description import LensDescription
from labrig.simulation.lens import plane_to_pixels
from labrig.simulation.parallax import see_points
from labrig.simulation.world import World
from labrig.vision.perspective import Perspective
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import ShaftTip
from labrig.vision.sheath import SheathPose


@dataclass(frozen=True)
class SightingErrors:
    """Errors of places and directions that are measured in pictures, besides those of the map.

    Attributes
    ----------
    along_mm, along_sd_mm, across_mm, across_sd_mm : float
        Mean and standard deviation of the tip's place by its template, along the needle and to its left.
    rim_mm : float
        What is added along `RIM_MM` from the camera's foot; this grows with the squared distance.
    fresh_share, correlated_mm : float
        Share of these variances that is drawn anew in each picture, and length over which the rest decays to 1/e.
    side_mm, turn_mm : float
        What is added across, towards the side to which the bevel bends: the template shows a tip that is bent to that
        side, so that a straight one is read off by `side_mm`, and `turn_mm` less for each radian that the last
        `TURN_MM` are turned.
    missed_share : float
        Share of pictures in which the tip is not found.
    hidden_mm, hidden_share : float
        Length of needle below which the sheath hides the tip, and the share of pictures in which it does.
    sheath_along_mm, sheath_sd_mm, sheath_sd_rad : float
        Mean error of the sheath's end along it, the standard deviation along each axis, and that of the heading.
    bend_mm, bend_sd_mm : float
        Of the end of a shaft bent to one side as in the search for the roll zero: mean towards that side, and standard
        deviation across.
    """

    along_mm: float
    along_sd_mm: float
    across_mm: float
    across_sd_mm: float
    rim_mm: float
    fresh_share: float
    correlated_mm: float
    side_mm: float
    turn_mm: float
    missed_share: float
    hidden_mm: float
    hidden_share: float
    sheath_along_mm: float
    sheath_sd_mm: float
    sheath_sd_rad: float
    bend_mm: float
    bend_sd_mm: float


SIGHTING_ERRORS = SightingErrors(
    along_mm=0.038,
    along_sd_mm=0.0122,
    across_mm=-0.007,
    across_sd_mm=0.0066,
    rim_mm=0.026,
    fresh_share=0.5,
    correlated_mm=5.0,
    side_mm=0.046,
    turn_mm=0.477,
    missed_share=0.001,
    hidden_mm=1.0,
    hidden_share=0.58,
    sheath_along_mm=0.006,
    sheath_sd_mm=0.008,
    sheath_sd_rad=0.0008,
    bend_mm=0.042,
    bend_sd_mm=0.028,
)
"""Of 40 runs of protocols/insertion.yaml on the simulated rig, seeds 700001 to 700040, with 4306 sightings.

They hold for its light, its noise and its template. `fresh_share` and `correlated_mm` are between those of the errors
along and across, whose autocorrelations are 0.56 and 0.33 at 1 mm and 0.26 and 0.10 at 5 mm: correlated ones alone make
the heading too sure, and leave the final errors without their largest. `python -m tests.benchmarks world-agrees` fits
the others anew.
"""

TURN_MM = 2.0
"""Length of the tip over which its turn counts for `SightingErrors.turn_mm`."""

_SHEATH_MM = 5.0
"""Length of the sheath's end whose direction is seen."""
_SHORTEST_SHAFT_MM = 1.0


class VirtualCamera(Protocol):
    """What is seen in a world, without pictures, and how the rig maps it."""

    plane: PlaneMap

    def see_tip(self, world: World, base_rad: float) -> FloatArray | None:
        """Return where the tip is seen (x, y, z), with x 0; None where it is not found.

        `base_rad` is where the base of the bevel stands, from the roll zero.
        """
        ...

    def see_shaft(self, path_mm: FloatArray, diameter_mm: float, since_turn_mm: float) -> ShaftTip | None:
        """Return the shaft of a needle with this path (N, 3); None where it cannot be measured.

        `since_turn_mm` is the length inserted since the bevel was turned.
        """
        ...


def locate_points(
    points_mm: FloatArray, lens: LensDescription, plane: PlaneMap
) -> tuple[FloatArray, FloatArray]:
    """Return where points in space (N, 3) are read by a map of the plane (N, 2), as (y, z), and their scales (N,)."""
    flat_mm, scales = see_points(points_mm, lens)
    return plane.to_mm(plane_to_pixels(flat_mm, lens)), scales


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

    def __post_init__(self) -> None:
        self._scatter, self._arc_mm = self.noise.standard_normal(2), 0.0
        self._perspective = Perspective.of(self.plane)

    def see_tip(self, world: World, base_rad: float) -> FloatArray | None:
        """Return where the tip is seen (x, y, z), with x 0; None where it is not found."""
        errors, tip, before = self.errors, world.node_before_tip(), world.node_before_tip(TURN_MM)
        found, drawn = self.noise.random(), self.noise.standard_normal((2, 2))
        if tip is None or before is None:
            return None
        along, across = self._scatter_on(tip.arc_mm, drawn).tolist()
        if found < (errors.hidden_share if tip.arc_mm < errors.hidden_mm else errors.missed_share):
            return None
        flat_mm, _ = see_points(np.array([(tip.x_mm, tip.y_mm, tip.z_mm)]), self.lens)
        pixels = plane_to_pixels(flat_mm, self.lens)
        if not self._shows(*pixels[0].tolist()):
            return None
        seen_mm = self.plane.to_mm(pixels)
        turn_rad, side = tip.heading_rad - before.heading_rad, -math.cos(base_rad)
        along_mm = errors.along_mm + errors.along_sd_mm * along
        along_mm += errors.rim_mm * float(square_distances(seen_mm, self._perspective)[0])
        across_mm = errors.across_mm + errors.across_sd_mm * across
        across_mm += errors.side_mm * side - errors.turn_mm * turn_rad
        sine, cosine = math.sin(tip.heading_rad), math.cos(tip.heading_rad)
        y, z = seen_mm[0].tolist()
        return np.array(
            (0.0, y + along_mm * sine + across_mm * cosine, z + along_mm * cosine - across_mm * sine)
        )

    def _shows(self, u: float, v: float) -> bool:
        """Return whether a tip at a pixel is far enough from the rim of the picture to be found."""
        width, height = self.lens.width_px, self.lens.height_px
        return RIM_PX <= u <= width - 1 - RIM_PX and RIM_PX <= v <= height - 1 - RIM_PX

    def _locate(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        return locate_points(points_mm, self.lens, self.plane)

    def _scatter_on(self, arc_mm: float, drawn: FloatArray) -> FloatArray:
        """Return what scatters at a length of the path, (2,): an Ornstein-Uhlenbeck process, and noise beside it."""
        kept = math.exp(-abs(arc_mm - self._arc_mm) / self.errors.correlated_mm)
        self._scatter = kept * self._scatter + math.sqrt(1.0 - kept**2) * drawn[0]
        self._arc_mm = arc_mm
        fresh = self.errors.fresh_share
        return np.asarray(math.sqrt(1.0 - fresh) * self._scatter + math.sqrt(fresh) * drawn[1])

    def see_bend(self, world: World, sheath: SheathPose) -> tuple[float, float]:
        """Return the end (y, z) of a needle that is bent to one side of its sheath, as measured by its shaft."""
        y, z = self._locate(np.array([world.tip_mm()]))[0][0].tolist()
        side = math.copysign(1.0, y - sheath.tip_mm[0])
        return y + side * self.errors.bend_mm + float(self.noise.normal(0.0, self.errors.bend_sd_mm)), z

    def locate_sheath(self, world: World) -> tuple[FloatArray, float]:
        """Return where the map has the sheath's end (y, z), and its heading [rad]."""
        points_mm = np.array([world.sheath_point_mm(_SHEATH_MM), world.sheath_point_mm(0.0)])
        before, end = self._locate(points_mm)[0]
        return end, math.atan2(*(end - before))

    def see_sheath(self, world: World) -> SheathPose:
        """Return the pose of the sheath, as measured in a picture."""
        end_mm, heading_rad = self.locate_sheath(world)
        errors_mm = self.noise.normal((0.0, self.errors.sheath_along_mm), self.errors.sheath_sd_mm)
        heading_rad += float(self.noise.normal(0.0, self.errors.sheath_sd_rad))
        y, z = (end_mm + errors_mm).tolist()
        u, v = self.plane.to_px(np.array([[y, z]]))[0].tolist()
        return SheathPose((u, v), (y, z), heading_rad, world.description.sheath.diameter_mm)

    def see_shaft(self, path_mm: FloatArray, diameter_mm: float, since_turn_mm: float) -> ShaftTip | None:
        """Return the shaft of a needle with this path (N, 3); None of one that has hardly left its sheath."""
        seen = SeenPath.of(*self._locate(path_mm))
        if seen.length_mm < _SHORTEST_SHAFT_MM:
            return None
        return draw_shaft(seen, self.plane, diameter_mm, since_turn_mm, self.noise)
