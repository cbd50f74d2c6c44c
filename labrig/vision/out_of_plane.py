"""What perspective and roll do to points out of the plane of the map.

Perspective: a point at x behind the plane (away from the camera) is seen where its line of sight meets the plane,
nearer to the camera's foot than it is, and as much smaller as it is farther away. So what the map states for it is off
by x over the camera's height for each millimetre from the foot. In gel the lines of sight are steeper, by about the
gel's index.

Roll: the plane in which a needle bends is turned by rho about the sheath's direction. A camera square above it would
show cos(rho) times the deflection from that direction, so the radius of a short arc as r / cos(rho), too large
(equation 5 of the paper). Over 60 degrees of arc a fifth of this is left, and beyond 70 the radius is too small. A
camera at a finite distance also shows what comes nearer larger, and that is linear in rho. Refraction of what is out of
the plane is left out; a gel makes the perspective smaller by about its index.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]


def covary_walk(at_mm: FloatArray) -> FloatArray:
    """Return the covariance (N, N) [mm^3] of the integral of a random walk at lengths (N,) [mm].

    The walk begins at 0 and has a variance of 1 after a millimetre: a heading that wanders, and the place that follows.
    """
    first, second = np.minimum.outer(at_mm, at_mm), np.maximum.outer(at_mm, at_mm)
    return np.asarray(first**2 * (3.0 * second - first) / 6.0)


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


_AHEAD_MM = 2.0


@dataclass(frozen=True, eq=False)
class BendingPlane:
    """A plane through the needle's entry that turns about the sheath's direction.

    Attributes
    ----------
    entry_mm, ahead : ndarray (2,)
        The entry, and the unit vector of the sheath's direction, (y, z).
    camera_mm : ndarray (3,) or None
        The camera's foot and height; None if they are not known, and the perspective is then left out.
    """

    entry_mm: FloatArray
    ahead: FloatArray
    camera_mm: FloatArray | None

    @classmethod
    def of(cls, entry_px: FloatArray, arc_mm: FloatArray, centre_mm: FloatArray, plane: PlaneMap) -> Self:
        """Return the plane of a shaft; its axis is the chord of the shaft's first millimetres.

        Parameters
        ----------
        entry_px : ndarray (2,)
        arc_mm : ndarray (N,)
            Arc lengths of the points of its centre line, rising.
        centre_mm : ndarray (N, 2)
            Their places.
        plane : PlaneMap
        """
        last = int(np.searchsorted(arc_mm, arc_mm[0] + _AHEAD_MM))
        chord = centre_mm[max(1, min(last, len(arc_mm) - 1))] - centre_mm[0]
        entry = plane.to_mm(entry_px[None])[0]
        camera = None if plane.intrinsics is None else plane.camera_mm()
        return cls(entry, chord / np.linalg.norm(chord), camera)

    def project(self, seen_mm: FloatArray, roll_rad: float) -> FloatArray:
        """Return the feet (N, 2) in the map's plane of a rolled needle's points, which the map shows at `seen_mm`."""
        if self.camera_mm is None:
            return seen_mm
        height_mm = self._aside(seen_mm) * np.tan(roll_rad)
        return np.asarray(seen_mm - (seen_mm - self.camera_mm[:2]) * (height_mm / self.camera_mm[2])[:, None])

    def unroll(self, seen_mm: FloatArray, roll_rad: float) -> FloatArray:
        """Return the places (N, 2) that these points would have without the roll."""
        feet = self.project(seen_mm, roll_rad)
        further = self._aside(feet) * (1.0 / np.cos(roll_rad) - 1.0)
        return np.asarray(feet + further[:, None] * self._normal)

    @property
    def _normal(self) -> FloatArray:
        return np.array([-self.ahead[1], self.ahead[0]])

    def _aside(self, points_mm: FloatArray) -> FloatArray:
        return np.asarray((points_mm - self.entry_mm) @ self._normal)


def combine_turns(forth: float, back: float) -> float:
    """Return the rms of a change a rho + b rho^2 for a normal rho, from its values at plus and minus its sigma."""
    linear, square = 0.5 * (forth - back), 0.5 * (forth + back)
    return float(np.sqrt(linear**2 + 3.0 * square**2))
