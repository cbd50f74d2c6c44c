"""Rays through flat, parallel layers to a plane, by Snell's law, with their derivatives.

At a flat surface the part of the ray's direction along the surface, times the refractive index, does not change (Snell;
Born and Wolf, Principles of Optics, section 1.5.1). So it is the same in all parallel layers, and a ray is traced
forward without a search. The inverse is solved by Newton's method with the derivatives.

Frame: x points away from the camera, and (y, z) are the plane's own axes; the plane is x = 0.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Stack:
    """Layers between the air, where the camera stands, and the plane, which lies in the last medium.

    Attributes
    ----------
    indices : tuple of float
        Refractive indices, from the camera to the plane.
    thicknesses_mm : tuple of float
        Thicknesses of all layers but the last, perpendicular to the surfaces.
    depth_mm : float
        Depth of the plane's point (0, 0) below the last surface, perpendicular to the plane.
    slopes : (float, float)
        By how much the surfaces rise towards the camera along +y and +z [mm/mm].
    """

    indices: tuple[float, ...]
    thicknesses_mm: tuple[float, ...]
    depth_mm: float
    slopes: tuple[float, float] = (0.0, 0.0)

    def normal(self) -> _FloatArray:
        """Return the unit vector (3,) perpendicular to the surfaces, away from the camera."""
        normal = np.array([1.0, *self.slopes])
        return np.asarray(normal / np.linalg.norm(normal))

    def height_mm(self) -> float:
        """Return how far above (0, 0) the outermost surface lies, perpendicular to the plane."""
        return self.depth_mm + sum(self.thicknesses_mm) / float(self.normal()[0])


@dataclass(frozen=True, eq=False)
class _Moving:
    """Vectors (N, 3), and their derivatives (N, 3, P) with respect to P parameters."""

    at: _FloatArray
    by: _FloatArray

    def __add__(self, other: "_Moving") -> "_Moving":
        return _Moving(self.at + other.at, self.by + other.by)

    def times(self, factor: "_Moving") -> "_Moving":
        """Return the product with factors (N, 1)."""
        return _Moving(self.at * factor.at, self.by * factor.at[:, :, None] + self.at[:, :, None] * factor.by)

    def dot(self, vector: _FloatArray) -> "_Moving":
        """Return the products (N, 1) with a constant vector (3,)."""
        return _Moving((self.at @ vector)[:, None], np.einsum("nip,i->np", self.by, vector)[:, None])

    def square(self) -> "_Moving":
        """Return the squared lengths (N, 1)."""
        return _Moving(
            np.sum(self.at**2, axis=1)[:, None], 2.0 * np.einsum("ni,nip->np", self.at, self.by)[:, None]
        )


def _power(base: _Moving, exponent: float) -> _Moving:
    slope = exponent * base.at ** (exponent - 1.0)
    return _Moving(base.at**exponent, slope[:, :, None] * base.by)


def _constant(values: _FloatArray, like: _Moving) -> _Moving:
    at = np.broadcast_to(values, (len(like.at), np.size(values)))
    return _Moving(at, np.zeros((*at.shape, like.by.shape[2])))


def _scale(vector: _Moving, factor: float) -> _Moving:
    return _Moving(factor * vector.at, factor * vector.by)


def trace_rays(
    stack: Stack, points_mm: _FloatArray, steps: _FloatArray, centre: _FloatArray
) -> tuple[_FloatArray, _FloatArray]:
    """Return where rays from the camera towards points reach the plane, and how that moves with the points.

    Parameters
    ----------
    points_mm : ndarray (N, 3)
        A point on each straight ray, as without any layer.
    steps : ndarray (3, 2)
        Derivatives of the points with respect to two coordinates.
    centre : ndarray (4,)
        The camera's centre in homogeneous coordinates; the last is 0 for a telecentric lens, whose centre is at
        infinity (Hartley and Zisserman, Multiple View Geometry, section 6.3).

    Returns
    -------
    ndarray (N, 2)
        Columns (y, z).
    ndarray (N, 2, 2)
        Their derivatives: rows (y, z), columns the two coordinates.
    """
    normal = stack.normal()
    towards = np.array([1.0, 0.0, 0.0])
    point = _Moving(points_mm, np.broadcast_to(steps, (len(points_mm), *steps.shape)))
    ray = _scale(point, float(centre[3])) + _constant(-centre[:3], point)
    ray = ray.times(_power(ray.square(), -0.5))
    downwards = _constant(normal, ray)
    above = _constant(np.array([-stack.height_mm() * normal[0]]), ray) + _scale(point.dot(normal), -1.0)
    place = point + ray.times(above.times(_power(ray.dot(normal), -1.0)))
    along = ray + downwards.times(_scale(ray.dot(normal), -1.0))
    tangential = along.square()
    for index, thickness_mm in zip(stack.indices[:-1], stack.thicknesses_mm, strict=True):
        steepness = _power(_descent(index, tangential), -1.0)
        place = place + _scale(downwards + along.times(steepness), thickness_mm)
    last = along + downwards.times(_descent(stack.indices[-1], tangential))
    left = _scale(place.dot(towards), -1.0)
    end = place + last.times(left.times(_power(last.dot(towards), -1.0)))
    return end.at[:, 1:], end.by[:, 1:]


def _descent(index: float, tangential: _Moving) -> _Moving:
    """Return index times the cosine of the ray's angle to the normal, from the squared tangential part."""
    return _power(_constant(np.array([index**2]), tangential) + _scale(tangential, -1.0), 0.5)
