"""Printed markers: squares of black and white bits on a white card, as the lens sees them."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from labrig.errors import InputError
from labrig.simulation.description import LensDescription, PrintedMarkerDescription, WorldDescription
from labrig.simulation.lens import (
    Field32,
    Floats,
    camera_place_mm,
    plane_to_pixels,
    steering_plane_pose,
    unproject,
)
from labrig.simulation.parallax import see_points
from labrig.simulation.sensor import blur

_INK, _CARD = 0.12, 1.05  # brightness over that of clear gel
_SAMPLES = 4  # along each side of a pixel
_RIM_PX = 6  # of the part of the picture around a card, for the lens's blur


@dataclass(frozen=True)
class PrintedMarker:
    """A marker: its brightness over that of clear gel in each cell, its rim included, and how large a cell is."""

    marker: PrintedMarkerDescription
    cells: Field32
    cell_mm: float

    @property
    def half_mm(self) -> float:
        """Half the side of the card."""
        return len(self.cells) * self.cell_mm / 2


def print_marker(marker: PrintedMarkerDescription) -> PrintedMarker:
    """Return a marker as it is printed.

    Raises
    ------
    InputError
        For an id that the dictionary does not have.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, marker.dictionary))
    if marker.marker_id >= len(dictionary.bytesList):
        raise InputError(
            f"the world's marker {marker.marker_id} is not in {marker.dictionary}, whose markers are 0 to "
            f"{len(dictionary.bytesList) - 1}",
            "correct markers: under world: in the rig file",
        )
    across = dictionary.markerSize + 2
    bits = cv2.aruco.generateImageMarker(dictionary, marker.marker_id, across)
    cells = np.where(np.pad(bits, 1, constant_values=255) > 0, _CARD, _INK).astype(np.float32)
    return PrintedMarker(marker, cells, marker.side_mm / across)


def draw_marker(
    light: Field32,
    world: WorldDescription,
    printed: PrintedMarker,
    moved_mm: tuple[float, float],
    white: Field32,
) -> None:
    """Draw a marker that has moved by (y, z) over a blurred picture; `white` is the brightness of clear gel (H, W)."""
    window = _frame(printed, moved_mm, world.lens)
    if window is None:
        return
    along, up = _unwarp(window, printed.marker, moved_mm, world.lens)
    count = len(printed.cells)
    column = np.floor((along + printed.half_mm) / printed.cell_mm).astype(int)
    row = np.floor((printed.half_mm - up) / printed.cell_mm).astype(int)
    inside = (column >= 0) & (column < count) & (row >= 0) & (row < count)
    value = printed.cells[np.clip(row, 0, count - 1), np.clip(column, 0, count - 1)]
    total = np.where(inside, value, 0.0).mean(axis=(1, 3), dtype=np.float32)
    cover = inside.mean(axis=(1, 3), dtype=np.float32)
    shown = blur(white[window] * total, world.blur_px)
    light[window] = light[window] * (1 - blur(cover, world.blur_px)) + shown


def _frame(
    printed: PrintedMarker, moved_mm: tuple[float, float], lens: LensDescription
) -> tuple[slice, slice] | None:
    """Return the rows and columns of the picture around the card; None if it is out of view."""
    marker = printed.marker
    y, z = (place + moved for place, moved in zip(marker.position_mm, moved_mm, strict=True))
    reach_mm = math.sqrt(2) * printed.half_mm
    corners = np.array([(marker.x_mm, y + a * reach_mm, z + b * reach_mm) for a in (-1, 1) for b in (-1, 1)])
    px = plane_to_pixels(see_points(corners, lens)[0], lens)
    left, top = (max(0, math.floor(edge) - _RIM_PX) for edge in px.min(axis=0))
    right = min(lens.width_px, math.ceil(px[:, 0].max()) + _RIM_PX + 1)
    bottom = min(lens.height_px, math.ceil(px[:, 1].max()) + _RIM_PX + 1)
    return (slice(top, bottom), slice(left, right)) if left < right and top < bottom else None


def _unwarp(
    window: tuple[slice, slice],
    marker: PrintedMarkerDescription,
    moved_mm: tuple[float, float],
    lens: LensDescription,
) -> tuple[Floats, Floats]:
    """Return where on the card the samples of each pixel lie, along and up from its middle, (H, S, W, S) [mm]."""
    offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    v = (np.arange(window[0].start, window[0].stop)[:, None] + offsets).ravel()
    u = (np.arange(window[1].start, window[1].stop)[:, None] + offsets).ravel()
    grid_u, grid_v = np.meshgrid(u, v)
    rays = unproject(np.column_stack((grid_u.ravel(), grid_v.ravel())), lens)
    seen_y, seen_z = steering_plane_pose(lens).intersect(rays)
    camera_x, foot_y, foot_z = camera_place_mm(lens)
    scale = (camera_x - marker.x_mm) / camera_x
    y = foot_y + (seen_y - foot_y) * scale - marker.position_mm[0] - moved_mm[0]
    z = foot_z + (seen_z - foot_z) * scale - marker.position_mm[1] - moved_mm[1]
    turn = math.radians(marker.turn_deg)
    shape = (len(v) // _SAMPLES, _SAMPLES, len(u) // _SAMPLES, _SAMPLES)
    along = z * math.cos(turn) + y * math.sin(turn)
    up = y * math.cos(turn) - z * math.sin(turn)
    return along.reshape(shape), up.reshape(shape)
