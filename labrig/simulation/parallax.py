"""Parallax: where in the steering plane the camera sees what lies out of it, and how large.

The ray from the centre of projection through a point (x, y, z) meets the plane at a point that is moved towards the
camera's foot if x is positive. A figure at one x is thus seen reduced by the factor D / (D + x), where D is the
camera's distance from the plane.
"""

from dataclasses import dataclass

import numpy as np

from labrig.simulation.description import LensDescription
from labrig.simulation.lens import Floats, camera_place_mm


@dataclass(frozen=True, eq=False)
class SeenPath:
    """A path as it is seen in the steering plane.

    table : (N, 5), columns arc (along the path itself), y, z, heading, curvature; scale : (N,), seen width over width.
    """

    table: Floats
    scale: Floats


def see_points(points_mm: Floats, lens: LensDescription) -> tuple[Floats, Floats]:
    """Return where in the plane (N, 2), as (y, z), points (N, 3) are seen, and their scales (N,)."""
    camera_x, *foot = camera_place_mm(lens)
    growth = points_mm[:, 0] / (camera_x - points_mm[:, 0])
    flat = points_mm[:, 1:]
    return flat + growth[:, None] * (flat - foot), 1.0 + growth


def see_path(table: Floats, lens: LensDescription) -> SeenPath:
    """Return how a path is seen; one in the plane is seen exactly as it is.

    Parameters
    ----------
    table : (N, 8) array
        Columns arc, y, z, heading, curvature, x, lean, bend, as from `Track.table`.
    lens : LensDescription
        The camera.
    """
    arc, _, _, heading, curvature, x, lean, bend = table.T
    if not (x.any() or lean.any()):
        return SeenPath(table[:, :5], np.ones(len(table)))
    camera_x, *foot = camera_place_mm(lens)
    points, scale = see_points(table[:, [5, 1, 2]], lens)
    # First and second derivatives with the arc of the scale f = D / (D + x) and of the place r + (f - 1) (r - foot).
    x_1, x_2 = np.sin(lean), np.cos(lean) * bend
    scale_1 = scale**2 * x_1 / camera_x
    scale_2 = (2 * scale * scale_1 * x_1 + scale**2 * x_2) / camera_x
    along = np.stack([np.sin(heading), np.cos(heading)], axis=1)
    across = np.stack([np.cos(heading), -np.sin(heading)], axis=1)
    place_1 = np.cos(lean)[:, None] * along
    # The heading changes by curvature / cos(lean).
    place_2 = curvature[:, None] * across - (x_1 * bend)[:, None] * along
    offset = table[:, 1:3] - foot
    seen_1 = scale[:, None] * place_1 + scale_1[:, None] * offset
    seen_2 = scale[:, None] * place_2 + 2 * scale_1[:, None] * place_1 + scale_2[:, None] * offset
    (y_1, z_1), (y_2, z_2) = seen_1.T, seen_2.T
    seen_curvature = (z_1 * y_2 - y_1 * z_2) / np.hypot(y_1, z_1) ** 3
    return SeenPath(np.column_stack((arc, points, np.arctan2(y_1, z_1), seen_curvature)), scale)
