"""Strokes: needle, sheath, cuts and bubbles drawn into a sharp picture, before the lens blurs it.

Everything is evaluated in mm in the steering plane at the foot of each pixel's ray, so lens and tilt are exact.
Edges are those of a flat ribbon; a cylinder's outline differs by (radius / distance)^2, a few parts in 100 000. An
edge covers a pixel in proportion to its distance from the pixel's centre.
"""

import math
from dataclasses import dataclass

import numpy as np

from labrig.simulation.band import HALO_MM, Band, find_region
from labrig.simulation.description import LightDescription, NeedleDescription, WorldDescription
from labrig.simulation.gel import Ball, Bubble, Hole
from labrig.simulation.lens import Field32, pixel_plane, plane_to_pixels
from labrig.simulation.parallax import see_path, see_points

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
    plane = pixel_plane(world.lens)
    x_mm, y_mm, z_mm = hole.sheath_point_mm(beyond_origin_mm)
    end = np.array([(0.0, y_mm, z_mm, hole.heading_rad, 0.0, x_mm, hole.lean_rad, 0.0)])
    seen = see_path(end, world.lens)
    _, *tip, heading_rad, _ = seen.table[0].tolist()
    along_axis = (math.sin(heading_rad), math.cos(heading_rad))
    axis = np.array(tip) - np.linspace(0, _SHEATH_SEEN_MM, 13)[:, None] * along_axis
    diameter_mm = world.sheath.diameter_mm * float(seen.scale[0])
    margin_px = (diameter_mm + HALO_MM) / plane.mm_per_px
    region = find_region(plane_to_pixels(axis, world.lens), margin_px, world.lens)
    if region.is_empty:
        return
    dy, dz = plane.y_mm[region.slices] - np.float32(tip[0]), plane.z_mm[region.slices] - np.float32(tip[1])
    lateral = np.asarray(dy * along_axis[1] - dz * along_axis[0], np.float32)
    behind = np.asarray(-dy * along_axis[0] - dz * along_axis[1], np.float32)
    inside = np.float32(0.5 * diameter_mm) - np.abs(lateral)
    share = coverage(inside, plane.mm_per_px) * coverage(behind, plane.mm_per_px)
    patch = picture[region.slices]
    patch *= 1 - 0.12 * np.exp(-((np.minimum(inside, 0) / 0.5) ** 2)) * (behind > 0)
    steel = _draw_sheath_steel(lateral / np.float32(0.5 * diameter_mm), heading_rad, world.light)
    patch += share * (steel - patch)


def _draw_sheath_steel(across: Field32, heading_rad: float, light: LightDescription) -> Field32:
    inner = np.clip(across, -1, 1)
    place, strength = _find_glint(np.array([heading_rad], np.float32), light)
    brushed = 0.28 + 0.30 * np.sqrt(1 - inner**2) + 0.02 * np.sin(23 * inner)
    glow = 0.45 * light.glint * strength * np.exp(-(((inner - place) / 0.28) ** 2))
    return np.asarray(light.level * brushed + glow, np.float32)


def draw_bubble(picture: Field32, bubble: Bubble, shift_mm: float, world: WorldDescription) -> None:
    """Draw a bubble: a dark refracting rim, a clear middle, a bright spot towards the lamp."""
    plane = pixel_plane(world.lens)
    centre = (bubble.lateral_mm + shift_mm, bubble.z_mm)
    middle = plane_to_pixels(np.array([centre]), world.lens)
    region = find_region(middle, 1.6 * bubble.radius_mm / plane.mm_per_px + 2, world.lens)
    if region.is_empty:
        return
    dy = (plane.y_mm[region.slices] - np.float32(centre[0])) / bubble.radius_mm
    dz = (plane.z_mm[region.slices] - np.float32(centre[1])) / bubble.radius_mm
    out = np.sqrt(dy**2 + dz**2)
    azimuth = math.radians(world.light.azimuth_deg)
    lit = dy * math.sin(azimuth) + dz * math.cos(azimuth)
    rim = np.exp(-(((out - 0.86) / 0.16) ** 2)) * (1 - 0.35 * lit)
    spot = np.exp(-(((lit - 0.45) / 0.18) ** 2) - ((out - 0.45) / 0.2) ** 2)
    picture[region.slices] *= 1 - 0.45 * rim + 0.30 * spot + 0.05 * np.exp(-(((out - 1.15) / 0.1) ** 2))


def draw_ball(picture: Field32, ball: Ball, world: WorldDescription) -> None:
    """Draw an obstacle of tinted, translucent gel: darker with its thickness, and with a faint rim."""
    plane = pixel_plane(world.lens)
    centre, scale = see_points(np.array([ball.centre_mm]), world.lens)
    (y_mm, z_mm), radius_mm = centre[0], ball.radius_mm * float(scale[0])
    middle = plane_to_pixels(centre, world.lens)
    region = find_region(middle, 1.2 * radius_mm / plane.mm_per_px + 2, world.lens)
    if region.is_empty:
        return
    dy = plane.y_mm[region.slices] - np.float32(y_mm)
    dz = plane.z_mm[region.slices] - np.float32(z_mm)
    out = np.sqrt(dy**2 + dz**2) / np.float32(radius_mm)
    inside = np.sqrt(np.clip(1 - out**2, 0, 1))
    rim = np.exp(-(((out - 0.98) * np.float32(radius_mm) / 0.25) ** 2))
    picture[region.slices] *= 1 - 0.28 * inside - 0.06 * rim
