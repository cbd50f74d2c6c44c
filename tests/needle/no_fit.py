"""Brute force, with nothing of the search in it: at one angle, every translation at once.

The translations at which two convex polygons interfere are one convex polygon, the Minkowski sum of the one
and the other mirrored (the no-fit polygon). Both links are taken apart into convex pieces; what the sums leave of
the box of translations is free. So an angle is allowed or not, exactly, without trying translations.
"""

from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from labrig.needle.hinge import HingeView
from labrig.protocol.design_file import Tube

FloatArray = NDArray[np.float64]

# Free regions below this area (mm²) are rounding: a square of 0.1 nm.
_ROUNDING_MM2 = 1e-14
_CONVEX_TO_MM2 = 1e-12
_NOTHING = np.array([], dtype=object)


class NoFit:
    """The no-fit polygons of a hinge's view."""

    def __init__(self, view: HingeView) -> None:
        lateral, axial = view.box.lateral_mm, view.box.axial_mm
        self._box = shapely.box(-lateral, -axial, lateral, axial)
        self._pairs = [(convex_pieces(pair.knuckle), convex_pieces(pair.socket)) for pair in view.sections]

    def is_free(self, rotation_deg: float) -> bool:
        """Return whether some translation of the box leaves both links without interference."""
        sums = np.concatenate([_NOTHING, *(self._sums(*pair, rotation_deg) for pair in self._pairs)])
        in_box = shapely.intersection(sums, self._box)
        in_box = in_box[np.argsort(-shapely.area(in_box))]
        free: shapely.Geometry = self._box
        for start in range(0, len(in_box), 16):
            free = shapely.difference(free, shapely.union_all(in_box[start : start + 16]))
            if shapely.area(free) < _ROUNDING_MM2:
                return False
        return True

    def _sums(
        self, fixed: list[FloatArray], moved: list[FloatArray], rotation_deg: float
    ) -> NDArray[np.object_]:
        """Return the Minkowski sums that reach into the box."""
        angle = np.radians(rotation_deg)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        mirrored = [-(piece @ turn.T) for piece in moved]
        low = _corners(fixed, np.min)[:, None] + _corners(mirrored, np.min)[None]
        high = _corners(fixed, np.max)[:, None] + _corners(mirrored, np.max)[None]
        x0, z0, x1, z1 = self._box.bounds
        near = (low[..., 0] < x1) & (high[..., 0] > x0) & (low[..., 1] < z1) & (high[..., 1] > z0)
        clouds = [
            (fixed[i][:, None] + mirrored[j][None]).reshape(-1, 2)
            for i, j in zip(*np.nonzero(near), strict=True)
        ]
        if not clouds:
            return _NOTHING
        owners = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
        hulls = shapely.convex_hull(shapely.multipoints(np.concatenate(clouds), indices=owners))
        return np.asarray(hulls)[shapely.intersects(hulls, self._box)]


def convex_pieces(link: shapely.Geometry) -> list[FloatArray]:
    """Take a polygon apart: triangles, grown over their neighbours for as long as they stay convex."""
    triangles = list(shapely.get_parts(shapely.constrained_delaunay_triangles(link)))
    neighbours: list[list[int]] = [[] for _ in triangles]
    for i, j in zip(*shapely.STRtree(triangles).query(triangles, predicate="touches"), strict=True):
        if shapely.intersection(triangles[i], triangles[j]).length > 0:
            neighbours[i].append(int(j))
    left = set(range(len(triangles)))
    largest_first = sorted(left, key=lambda i: -triangles[i].area)
    return [_grown(first, triangles, neighbours, left) for first in largest_first if first in left]


def _grown(first: int, triangles: list[Polygon], neighbours: list[list[int]], left: set[int]) -> FloatArray:
    left.remove(first)
    piece: BaseGeometry = triangles[first]
    border = list(neighbours[first])
    while border:
        other = border.pop()
        if other not in left:
            continue
        larger = shapely.union(piece, triangles[other])
        if shapely.convex_hull(larger).area - larger.area < _CONVEX_TO_MM2:
            left.remove(other)
            piece, border = larger, border + neighbours[other]
    return shapely.get_coordinates(piece)[:-1]


def _corners(pieces: list[FloatArray], of: Callable[..., FloatArray]) -> FloatArray:
    return np.array([of(piece, axis=0) for piece in pieces])


def make_tube(outer_mm: float, inner_mm: float, link_mm: float) -> Tube:
    """Return a tube of these diameters and links."""
    return Tube(outer_diameter_mm=outer_mm, inner_diameter_mm=inner_mm, link_length_mm=link_mm)
