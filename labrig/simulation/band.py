"""The pixels near a path and their coordinates along it, on which strokes are drawn."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from labrig.simulation.description import LensDescription
from labrig.simulation.lens import Field32, Floats, pixel_plane, plane_to_pixels
from labrig.simulation.parallax import see_path
from labrig.simulation.unevenness import NODE_MM

Indexes = npt.NDArray[np.intp]
Pixels = tuple[Indexes, Indexes]

HALO_MM = 1.6  # how far from its centre line a stroke may change the picture
_CHAMFER_RIM_PX = 8  # a path that leaves the picture still has its nearest node on the canvas


@dataclass(frozen=True)
class Region:
    """A rectangle of the picture: rows and columns, both half open."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """The index of the region in a picture."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    @property
    def is_empty(self) -> bool:
        """Whether the region has no pixel."""
        return self.bottom <= self.top or self.right <= self.left


def find_region(pixels: Floats, margin_px: float, lens: LensDescription) -> Region:
    """Return the part of the picture within a margin of pixels (N, 2)."""
    left, top = np.floor(pixels.min(axis=0) - margin_px).astype(int).tolist()
    right, bottom = (np.ceil(pixels.max(axis=0) + margin_px).astype(int) + 1).tolist()
    return Region(max(0, top), min(lens.height_px, bottom), max(0, left), min(lens.width_px, right))


@dataclass(frozen=True)
class Band:
    """The pixels near a centre line.

    region : the rectangle around them; inside : their rows and columns (N,) in it; lateral_mm (N,) : distance to
    the line at the line's own distance from the camera, positive on its +y side; arc_mm (N,) : arc length at the foot;
    heading_rad (N,) : heading there as it is seen.
    """

    region: Region
    inside: Pixels
    lateral_mm: Field32
    arc_mm: Field32
    heading_rad: Field32


def find_band(table: Floats, lens: LensDescription, margin_px: int = 0) -> Band | None:
    """Return the pixels within `HALO_MM` of a path, or None if the path is out of view.

    Parameters
    ----------
    table : (N, 8) array
        Columns arc, y, z, heading, curvature, x, lean, bend, spaced `NODE_MM` in arc, as from `Track.table`.
    lens : LensDescription
        The camera.
    margin_px : int
        Rim of the region beyond the band.
    """
    plane = pixel_plane(lens)
    seen = see_path(table, lens)
    pixels = plane_to_pixels(seen.table[:, 1:3], lens)
    halo_px = HALO_MM / plane.mm_per_px
    region = find_region(pixels, halo_px + margin_px, lens)
    if region.is_empty:
        return None
    nearest, inside = _find_nearest_nodes(pixels - (region.left, region.top), region, halo_px)
    if nearest.size == 0:
        return None
    y, z = plane.y_mm[region.slices][inside], plane.z_mm[region.slices][inside]
    lateral, arc, heading = _find_feet(seen.table.astype(np.float32), nearest, y, z)
    scale = np.asarray(seen.scale[nearest], np.float32)
    return Band(region, inside, np.divide(lateral, scale, dtype=np.float32), arc, heading)


def _find_nearest_nodes(pixels: Floats, region: Region, halo_px: float) -> tuple[Indexes, Pixels]:
    """Return each pixel near the path, and for each a node at most a few nodes from the nearest."""
    height, width = region.bottom - region.top, region.right - region.left
    pad = int(halo_px) + _CHAMFER_RIM_PX
    canvas = np.full((height + 2 * pad, width + 2 * pad), 255, np.uint8)
    places = np.rint(pixels).astype(int) + pad
    seen = ((places >= 0) & (places < (canvas.shape[1], canvas.shape[0]))).all(axis=1)
    nodes, places = np.flatnonzero(seen), places[seen]
    canvas[places[:, 1], places[:, 0]] = 0
    distance, labels = cv2.distanceTransformWithLabels(canvas, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    node_of_label = np.zeros(len(nodes) + 1, np.intp)
    node_of_label[labels[places[:, 1], places[:, 0]]] = nodes
    core = (slice(pad, pad + height), slice(pad, pad + width))
    rows, columns = np.nonzero(distance[core] < halo_px)
    return node_of_label[labels[core][rows, columns]], (rows, columns)


def _find_feet(table: Field32, nearest: Indexes, y: Field32, z: Field32) -> tuple[Field32, Field32, Field32]:
    """Return lateral distance, arc length and heading at each point's foot.

    The foot is on the osculating circle of the nearest node; a first round finds that node.
    """
    arcs, ys, zs, headings, curvatures = table.T
    sines, cosines = np.sin(headings), np.cos(headings)
    for _ in range(2):
        dy, dz = y - ys[nearest], z - zs[nearest]
        along = dy * sines[nearest] + dz * cosines[nearest]
        across = dy * cosines[nearest] - dz * sines[nearest]
        curvature = curvatures[nearest]
        bent = 1 - curvature * across
        foot_arc = arcs[nearest] + along / bent
        foot_heading = headings[nearest] + curvature * along / bent
        lateral = (2 * across - curvature * (along**2 + across**2)) / (
            1 + np.sqrt(bent**2 + (curvature * along) ** 2)
        )
        steps = np.rint(along / bent / np.float32(NODE_MM)).astype(np.intp)
        nearest = np.clip(nearest + steps, 0, len(table) - 1)
    return lateral, foot_arc, foot_heading
