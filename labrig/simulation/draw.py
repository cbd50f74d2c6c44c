"""The picture as the lens sees it, layer by layer: light, clouds, bubbles, older cuts, sheath, needle, markers, noise.

Strokes are drawn on the pixels near a path (`Band`) with their coordinates along it, sharp, and blurred as the lens
does. Markers are squares of black and white bits on a white card, over all of it.
"""

import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from labrig.errors import InputError
from labrig.simulation.description import (
    LensDescription,
    LightDescription,
    NeedleDescription,
    PrintedMarkerDescription,
    WorldDescription,
)
from labrig.simulation.gel import Ball, GelBlock, Hole
from labrig.simulation.lens import (
    Field32,
    Floats,
    camera_place_mm,
    pixel_plane,
    plane_to_pixels,
    see_points,
)
from labrig.simulation.track import NODE_MM

BLUR_REACH_PX = 4
_BANK_RIM_PX = 256


def blur(sharp: Field32, blur_px: float) -> Field32:
    """Return the picture as the lens draws it: Gaussian, cut off at `BLUR_REACH_PX`."""
    if blur_px == 0:
        return sharp
    side = 2 * BLUR_REACH_PX + 1
    return np.asarray(cv2.GaussianBlur(sharp, (side, side), blur_px, borderType=cv2.BORDER_REFLECT_101))


def draw_noise_bank(lens: LensDescription, random: np.random.Generator) -> Field32:
    """Return noise of unit standard deviation, larger than a picture: each picture takes another piece of it."""
    bank = (lens.height_px + _BANK_RIM_PX, lens.width_px + _BANK_RIM_PX)
    return random.standard_normal(bank, dtype=np.float32)


def expose(
    light: Field32, bank: Field32, world: WorldDescription, random: np.random.Generator
) -> npt.NDArray[np.uint8]:
    """Return the picture (H, W) uint8 of the light (H, W) in grey levels, with a piece of the bank mirrored at random.

    At the light's level half of the variance is read-out noise; the other half, photon noise, grows with the light.
    """
    height, width = light.shape
    row, column = random.integers(0, _BANK_RIM_PX, 2)
    piece = bank[row : row + height, column : column + width]
    noise = cv2.flip(piece, int(random.integers(-1, 2)))
    variance = 0.5 * world.noise_sd**2
    deviation = cv2.addWeighted(light, variance / world.light.level, light, 0.0, variance)
    # In place: fresh memory of this size costs more than the arithmetic.
    cv2.sqrt(deviation, deviation)
    cv2.multiply(noise, deviation, noise)
    return np.asarray(cv2.add(light, noise, dtype=cv2.CV_8U), np.uint8)


Indexes = npt.NDArray[np.intp]
Pixels = tuple[Indexes, Indexes]

HALO_MM = 1.6  # how far from its centre line a stroke may change the picture
_CHAMFER_RIM_PX = 8  # a path that leaves the picture still has its nearest node on the canvas


Window = tuple[slice, slice]
"""A rectangle of the picture: its rows and its columns."""


def find_window(pixels: Floats, margin_px: float, lens: LensDescription) -> Window:
    """Return the part of the picture within a margin of pixels (N, 2); it may be empty."""
    lows = np.maximum(np.floor(pixels.min(axis=0) - margin_px), 0).astype(int)
    highs = np.ceil(pixels.max(axis=0) + margin_px).astype(int) + 1
    ends = np.maximum(lows, np.minimum(highs, (lens.width_px, lens.height_px)))
    (left, top), (right, bottom) = lows.tolist(), ends.tolist()
    return slice(top, bottom), slice(left, right)


def _look_around(
    points_mm: Floats, margin_px: float, lens: LensDescription
) -> tuple[Window, Field32, Field32]:
    """Return the part of the picture about places (N, 2) as (y, z), and its pixels' dy and dz from the first."""
    plane = pixel_plane(lens)
    window = find_window(plane_to_pixels(points_mm, lens), margin_px, lens)
    dy, dz = (
        np.asarray(flat[window] - np.float32(place), np.float32)
        for flat, place in zip((plane.y_mm, plane.z_mm), points_mm[0], strict=True)
    )
    return window, dy, dz


@dataclass(frozen=True)
class Band:
    """The pixels near a centre line.

    window : the rectangle around them; inside : their rows and columns (N,) in it; lateral_mm (N,) : distance to
    the line at the line's own distance from the camera, positive on its +y side; arc_mm (N,) : arc length at the foot;
    heading_rad (N,) : heading there as it is seen.
    """

    window: Window
    inside: Pixels
    lateral_mm: Field32
    arc_mm: Field32
    heading_rad: Field32


def find_band(path: Floats, lens: LensDescription, margin_px: int = 0) -> Band | None:
    """Return the pixels within `HALO_MM` of a path, or None if the path is out of view.

    Parameters
    ----------
    path : (N, 4) array
        Columns arc, x, y, z, spaced `NODE_MM` in arc, as from `Track.points_mm`.
    lens : LensDescription
        The camera.
    margin_px : int
        Rim of the region beyond the band.
    """
    if len(path) < 2:
        return None
    plane = pixel_plane(lens)
    seen, scale = see_points(path[:, 1:], lens)
    pixels = plane_to_pixels(seen, lens)
    halo_px = HALO_MM / plane.mm_per_px
    window = rows, columns = find_window(pixels, halo_px + margin_px, lens)
    shape = rows.stop - rows.start, columns.stop - columns.start
    nearest, inside = _find_nearest_nodes(pixels - (columns.start, rows.start), shape, halo_px)
    if nearest.size == 0:
        return None
    y, z = plane.y_mm[window][inside], plane.z_mm[window][inside]
    nearest, lateral, along = _find_feet(seen, nearest, y, z)
    headings = np.arctan2(*np.gradient(seen, axis=0).T)
    found = (lateral / scale[nearest], path[nearest, 0] + along, headings[nearest])
    return Band(window, inside, *(np.asarray(values, np.float32) for values in found))


def _find_nearest_nodes(pixels: Floats, shape: tuple[int, int], halo_px: float) -> tuple[Indexes, Pixels]:
    """Return for each pixel near the path a node at most a few nodes from the nearest, and the pixels."""
    height, width = shape
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


def _find_feet(seen: Floats, nearest: Indexes, y: Field32, z: Field32) -> tuple[Indexes, Field32, Field32]:
    """Return each point's nearest node, and how far it is from that across the path and along it.

    Between two nodes the path is straight but for 0.00001 mm; a first round finds the nearest node.
    """
    places = seen.astype(np.float32)
    steps = np.gradient(places, axis=0)
    sines, cosines = (steps / np.linalg.norm(steps, axis=1, keepdims=True)).T
    for moves_on in (True, False):
        dy, dz = y - places[nearest, 0], z - places[nearest, 1]
        along = dy * sines[nearest] + dz * cosines[nearest]
        if moves_on:
            moved = np.rint(along / np.float32(NODE_MM)).astype(np.intp)
            nearest = np.clip(nearest + moved, 0, len(seen) - 1)
    return nearest, dy * cosines[nearest] - dz * sines[nearest], along


_SHEATH_SEEN_MM = 60.0  # more of the sheath than any picture shows
_LAMP_HEIGHT = 1.2  # height of the lamp over its distance aside


@dataclass(frozen=True)
class PathSpan:
    """A part of a path between two arc lengths, with the bevel's roll at its front."""

    from_mm: float
    to_mm: float
    roll_rad: float = 0.0


def coverage(inside_mm: Field32, mm_per_px: float) -> Field32:
    """Return the covered share of a pixel whose centre lies `inside_mm` within an edge."""
    share = inside_mm / np.float32(mm_per_px) + np.float32(0.5)
    return np.asarray(np.clip(share, 0, 1), np.float32)


def draw_cut(patch: Field32, band: Band, span: PathSpan, width_mm: float, patchiness: Field32) -> None:
    """Darken the gel along a cut, faintly and in patches.

    Parameters
    ----------
    patch : (H, W) array
        The region of the band; changed in place.
    band : Band
        Pixels near the cut.
    span : PathSpan
        Of the cut.
    width_mm : float
        Width of the cut.
    patchiness : (K,) array
        Contrast at steps of 1 mm from arc length 0.
    """
    ends = np.clip((band.arc_mm - span.from_mm) / 0.3, 0, 1)
    ends = ends * np.clip((span.to_mm - band.arc_mm) / 0.3, 0, 1)
    contrast = np.interp(band.arc_mm, np.arange(len(patchiness)), patchiness).astype(np.float32)
    inside_mm = np.float32(0.5 * width_mm) - np.abs(band.lateral_mm)
    walls = np.exp(-((inside_mm / 0.12) ** 2))
    patch[band.inside] *= 1 - contrast * ends * (0.7 * coverage(inside_mm, 0.08) + 0.5 * walls)


def draw_shadow(patch: Field32, band: Band, span: PathSpan, light: LightDescription) -> None:
    """Darken the gel softly beside the needle, on the side away from the lamp."""
    side = np.sin(math.radians(light.azimuth_deg) - band.heading_rad)
    ends = np.clip((band.arc_mm - span.from_mm) / 0.4, 0, 1)
    ends *= np.clip((span.to_mm + 0.4 - band.arc_mm) / 0.4, 0, 1)
    away = (band.lateral_mm + 0.35 * side) / 0.75
    patch[band.inside] *= 1 - 0.10 * ends * np.exp(-(away**2))


def draw_needle(patch: Field32, band: Band, span: PathSpan, world: WorldDescription) -> None:
    """Draw the needle: dark steel, an off-centre glint, ticks at the hinges, a bevelled tip."""
    radius = 0.5 * world.needle.diameter_mm
    mm_per_px = pixel_plane(world.lens).mm_per_px
    across = np.clip(band.lateral_mm / radius, -1, 1)
    place, strength = _find_glint(band.heading_rad, world.light)
    ticks = _draw_hinge_ticks(span.to_mm - band.arc_mm, world.needle.link_mm)
    glint = world.light.glint * strength * np.exp(-(((across - place) / 0.17) ** 2)) * (1 - 0.75 * ticks)
    body = world.light.level * (0.17 + 0.15 * np.sqrt(1 - across**2)) * (1 - 0.35 * ticks)
    end_mm = np.float32(span.to_mm) - _bevel_cut_mm(across, span.roll_rad, world.needle)
    share = coverage(np.float32(radius) - np.abs(band.lateral_mm), mm_per_px)
    share *= coverage(end_mm - band.arc_mm, mm_per_px)
    share *= coverage(band.arc_mm - np.float32(span.from_mm), mm_per_px)
    patch[band.inside] += share * (body + glint - patch[band.inside])


def _find_glint(heading_rad: Field32, light: LightDescription) -> tuple[Field32, Field32]:
    """Return where on a cylinder (-1 to 1, positive on its +y side) the lamp's glint lies, and its strength.

    Seen along the axis, the glint lies where the normal bisects the angle between lamp and camera. It fades as that
    direction leans along the axis.
    """
    aside = math.radians(light.azimuth_deg) - heading_rad
    height = math.hypot(1.0, _LAMP_HEIGHT) + _LAMP_HEIGHT
    along, across = np.cos(aside), np.sin(aside)
    return across / np.sqrt(across**2 + np.float32(height**2)), 1 - np.float32(0.5) * along**2


def _draw_hinge_ticks(from_tip_mm: Field32, link_mm: float) -> Field32:
    """Return 1 at each laser cut and 0 between: a cut per link, behind the tip's own link."""
    off = np.abs((from_tip_mm + 0.5 * link_mm) % link_mm - 0.5 * link_mm)
    ticks = np.where(from_tip_mm > 0.5 * link_mm, np.exp(-((off / 0.09) ** 2)), 0)
    return ticks.astype(np.float32)


def _bevel_cut_mm(across: Field32, roll_rad: float, needle: NeedleDescription) -> Field32:
    """Return the distance from the needle's foremost point back to its bevel, by lateral place (-1 to 1).

    The point leads on the side to which the needle bends: towards -y at roll 0. The outline is the farthest
    point of the face over the depth of the cylinder.
    """
    length_mm = needle.diameter_mm / math.tan(math.radians(needle.bevel_deg))
    lead = -math.cos(roll_rad) * across + abs(math.sin(roll_rad)) * np.sqrt(1 - across**2)
    return np.asarray(0.5 * length_mm * (1 - lead), np.float32)


def draw_sheath(picture: Field32, hole: Hole, beyond_origin_mm: float, world: WorldDescription) -> None:
    """Draw the sheath from the picture's edge to its tip: brushed steel, lighter than the needle."""
    mm_per_px = pixel_plane(world.lens).mm_per_px
    ends = [hole.sheath_point_mm(beyond_origin_mm - before_mm) for before_mm in (0.0, _SHEATH_SEEN_MM)]
    (tip, back), scale = see_points(np.array(ends), world.lens)
    heading_rad = math.atan2(*(tip - back))
    sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
    radius_mm = 0.5 * world.sheath.diameter_mm * float(scale[0])
    margin_px = (2 * radius_mm + HALO_MM) / mm_per_px
    window, dy, dz = _look_around(np.linspace(tip, back, 13), margin_px, world.lens)
    lateral, behind = (
        np.asarray(way, np.float32) for way in (dy * cosine - dz * sine, -dy * sine - dz * cosine)
    )
    inside = np.float32(radius_mm) - np.abs(lateral)
    share = coverage(inside, mm_per_px) * coverage(behind, mm_per_px)
    patch = picture[window]
    patch *= 1 - 0.12 * np.exp(-((np.minimum(inside, 0) / 0.5) ** 2)) * (behind > 0)
    steel = _draw_sheath_steel(lateral / np.float32(radius_mm), heading_rad, world.light)
    patch += share * (steel - patch)


def _draw_sheath_steel(across: Field32, heading_rad: float, light: LightDescription) -> Field32:
    inner = np.clip(across, -1, 1)
    place, strength = _find_glint(np.array([heading_rad], np.float32), light)
    brushed = 0.28 + 0.30 * np.sqrt(1 - inner**2) + 0.02 * np.sin(23 * inner)
    glow = 0.45 * light.glint * strength * np.exp(-(((inner - place) / 0.28) ** 2))
    return np.asarray(light.level * brushed + glow, np.float32)


def draw_bubble(picture: Field32, bubble: list[float], shift_mm: float, world: WorldDescription) -> None:
    """Draw a bubble: a dark refracting rim, a clear middle, a bright spot towards the lamp."""
    lateral_mm, z_mm, radius_mm = bubble
    centre, margin_px = [lateral_mm + shift_mm, z_mm], 1.6 * radius_mm / pixel_plane(world.lens).mm_per_px + 2
    window, *places = _look_around(np.array([centre]), margin_px, world.lens)
    dy, dz = (place / radius_mm for place in places)
    out = np.sqrt(dy**2 + dz**2)
    azimuth = math.radians(world.light.azimuth_deg)
    lit = dy * math.sin(azimuth) + dz * math.cos(azimuth)
    rim = np.exp(-(((out - 0.86) / 0.16) ** 2)) * (1 - 0.35 * lit)
    spot = np.exp(-(((lit - 0.45) / 0.18) ** 2) - ((out - 0.45) / 0.2) ** 2)
    picture[window] *= 1 - 0.45 * rim + 0.30 * spot + 0.05 * np.exp(-(((out - 1.15) / 0.1) ** 2))


def draw_ball(picture: Field32, ball: Ball, world: WorldDescription) -> None:
    """Draw an obstacle of tinted, translucent gel: darker with its thickness, and with a faint rim."""
    centre, scale = see_points(np.array([ball.position_mm]), world.lens)
    radius_mm = ball.radius_mm * float(scale[0])
    margin_px = 1.2 * radius_mm / pixel_plane(world.lens).mm_per_px + 2
    window, dy, dz = _look_around(centre, margin_px, world.lens)
    out = np.sqrt(dy**2 + dz**2) / np.float32(radius_mm)
    inside = np.sqrt(np.clip(1 - out**2, 0, 1))
    rim = np.exp(-(((out - 0.98) * np.float32(radius_mm) / 0.25) ** 2))
    picture[window] *= 1 - 0.28 * inside - 0.06 * rim


_CUT_WIDTH_MM = 0.4  # of the slit that a withdrawn needle leaves
_AIR = 1.06  # the light table is a little brighter where no gel lies on it


Backdrop = tuple[Field32, Field32]
"""A scene without the needle (H, W): sharp, and as the lens blurs it."""


def draw_gel(world: WorldDescription, specimen: GelBlock, present: Hole, white: Field32) -> Field32:
    """Return the gel at the present hole, sharp, without that hole's own cuts."""
    shift_mm = present.position_mm
    sharp = _draw_clear_gel(world, specimen, shift_mm, white)
    for ball in specimen.obstacles:
        draw_ball(sharp, ball, world)
    for bubble in specimen.bubbles:
        draw_bubble(sharp, bubble, shift_mm, world)
    for hole in specimen.holes.values():
        if hole is not present:
            aside_mm = shift_mm - hole.position_mm
            draw_channel(sharp, hole, aside_mm, world)
            track = hole.track
            path = np.empty((0, 4)) if track is None else np.add(track.points_mm(), (0, 0, aside_mm, 0))
            _draw_slit(sharp, path, _CUT_WIDTH_MM, hole.patchiness, world.lens)
    return sharp


def _draw_clear_gel(world: WorldDescription, specimen: GelBlock, shift_mm: float, white: Field32) -> Field32:
    """Return light table, gel, and the dark line of the gel's surface through which the sheath enters."""
    plane = pixel_plane(world.lens)
    depth = plane.z_mm + np.float32(world.sheath_tip_at_origin_linear_mm)
    inside = np.clip(depth / np.float32(plane.mm_per_px) + np.float32(0.5), 0, 1)
    clouds = specimen.clouds_at(plane.y_mm - np.float32(shift_mm), plane.z_mm)
    sharp = white * (_AIR + inside * (1 - _AIR + clouds))
    sharp *= 1 - 0.30 * np.exp(-((depth / 0.22) ** 2)) - 0.10 * np.exp(-(((depth - 0.5) / 0.6) ** 2))
    return np.asarray(sharp, np.float32)


def draw_channel(sharp: Field32, hole: Hole, shift_mm: float, world: WorldDescription) -> None:
    """Draw the channel that the sheath has left: as wide as the sheath, and fainter than the needle's slit."""
    entry_mm = -world.sheath_tip_at_origin_linear_mm
    start, next_mm = (np.array(hole.sheath_point_mm(entry_mm + along_mm)) for along_mm in (0.0, 1.0))
    arc = np.arange(0.0, hole.sheath_reach_mm, NODE_MM)
    path = np.column_stack((arc, start + (0, shift_mm, 0) + arc[:, None] * (next_mm - start)))
    _draw_slit(sharp, path, world.sheath.diameter_mm, 0.5 * hole.patchiness, world.lens)


def _draw_slit(
    sharp: Field32, path: Floats, width_mm: float, patchiness: Field32, lens: LensDescription
) -> None:
    """Draw a cut along a whole path."""
    band = find_band(path, lens)
    if band is not None:
        draw_cut(sharp[band.window], band, PathSpan(0.0, path[-1, 0]), width_mm, patchiness)


def draw_backdrop(world: WorldDescription, scene: Field32, hole: Hole, linear_mm: float) -> Backdrop:
    """Return a scene with the present hole's channel and the sheath in it."""
    sharp = scene.copy()
    draw_channel(sharp, hole, 0.0, world)
    draw_sheath(sharp, hole, linear_mm - world.sheath_tip_at_origin_linear_mm, world)
    return sharp, blur(sharp, world.blur_px)


def draw_with_needle(world: WorldDescription, behind: Backdrop, hole: Hole, span: PathSpan) -> Field32:
    """Return the blurred picture (H, W) with the needle, and with the slit from which it has been withdrawn.

    `span` is the part of the hole's track, possibly empty, that the needle fills beyond the sheath.
    """
    sharp, light = behind[0], behind[1].copy()
    path = np.empty((0, 4)) if hole.track is None else hole.track.points_mm(span.from_mm)
    band = find_band(path, world.lens, margin_px=2 * BLUR_REACH_PX + 2)
    if hole.track is None or band is None:
        return light
    patch = sharp[band.window].copy()
    if hole.track.length_mm > span.to_mm:
        left = PathSpan(max(0.0, span.from_mm), hole.track.length_mm)
        draw_cut(patch, band, left, _CUT_WIDTH_MM, hole.patchiness)
    if span.to_mm > span.from_mm:
        draw_shadow(patch, band, span, world.light)
        draw_needle(patch, band, span, world)
    _paste(light, blur(patch, world.blur_px), band.window)
    return light


def _paste(light: Field32, patch: Field32, window: Window) -> None:
    """Put a blurred patch back without the rim whose blur lacks neighbours; the picture's edge has no such rim."""
    to, of = zip(*map(_leave_rim, window, light.shape), strict=True)
    light[to] = patch[of]


def _leave_rim(part: slice, size: int) -> tuple[slice, slice]:
    """Return rows or columns without their rim, in the picture and in the patch."""
    start = part.start + (BLUR_REACH_PX if part.start > 0 else 0)
    stop = part.stop - (BLUR_REACH_PX if part.stop < size else 0)
    return slice(start, stop), slice(start - part.start, stop - part.start)


_INK, _CARD = 0.12, 1.05  # brightness over that of clear gel
_SAMPLES = 5  # along each side of a pixel; odd
_RIM_PX = 6  # of the part of the picture around a card, for the lens's blur


@cache
def print_marker(marker: PrintedMarkerDescription) -> Field32:
    """Return the brightness of a marker's cells over that of clear gel, a rim of one cell included.

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
    bits = cv2.aruco.generateImageMarker(dictionary, marker.marker_id, dictionary.markerSize + 2)
    return np.where(np.pad(bits, 1, constant_values=255) > 0, _CARD, _INK).astype(np.float32)


def draw_marker(
    light: Field32,
    world: WorldDescription,
    marker: PrintedMarkerDescription,
    moved_mm: tuple[float, float],
    white: Field32,
) -> None:
    """Draw a marker that has moved by (y, z) over a blurred picture; `white` is the brightness of clear gel (H, W)."""
    lens, plane, cells = world.lens, pixel_plane(world.lens), print_marker(marker)
    cell_mm = marker.side_mm / (len(cells) - 2)
    half_mm = len(cells) * cell_mm / 2
    middle_y, middle_z = (place + moved for place, moved in zip(marker.position_mm, moved_mm, strict=True))
    reach_mm = math.sqrt(2) * half_mm
    corners = [
        (marker.x_mm, middle_y + a * reach_mm, middle_z + b * reach_mm) for a in (-1, 1) for b in (-1, 1)
    ]
    window = find_window(plane_to_pixels(see_points(np.array(corners), lens)[0], lens), _RIM_PX, lens)
    patch = light[window]
    if patch.size == 0:
        return
    camera_x, foot_y, foot_z = camera_place_mm(lens)
    depth, turn = (camera_x - marker.x_mm) / camera_x, math.radians(marker.turn_deg)
    y = foot_y + (plane.y_mm[window] - foot_y) * depth - middle_y
    z = foot_z + (plane.z_mm[window] - foot_z) * depth - middle_z
    along_mm, down_mm = z * math.cos(turn) + y * math.sin(turn), z * math.sin(turn) - y * math.cos(turn)
    fine = math.ceil(cell_mm / plane.mm_per_px) * _SAMPLES
    columns, rows = (
        np.asarray((half_mm + place) * fine / cell_mm + _SAMPLES - 0.5, np.float32)
        for place in (along_mm, down_mm)
    )
    ink, cover = (
        cv2.remap(
            _average(np.kron(sheet, np.ones((fine, fine), np.float32))), columns, rows, cv2.INTER_LINEAR
        )
        for sheet in (cells, np.ones_like(cells))
    )
    patch *= 1 - blur(np.asarray(cover, np.float32), world.blur_px)
    patch += blur(np.asarray(white[window] * ink, np.float32), world.blur_px)


def _average(sheet: Field32) -> Field32:
    """Return what a pixel sees of a sheet, printed `_SAMPLES` times as fine as pixels, with a rim around it."""
    seen = cv2.blur(np.pad(sheet, _SAMPLES), (_SAMPLES, _SAMPLES), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(seen, np.float32)
