"""The scene as the lens sees it, layer by layer: light, clouds, bubbles, older cuts, sheath, needle."""

import math
from dataclasses import dataclass

import numpy as np

from labrig.simulation.band import Region, find_band
from labrig.simulation.description import WorldDescription
from labrig.simulation.gel import GelBlock, Hole
from labrig.simulation.lens import Field32, Floats, pixel_plane
from labrig.simulation.sensor import BLUR_REACH_PX, blur
from labrig.simulation.strokes import (
    PathSpan,
    draw_ball,
    draw_bubble,
    draw_cut,
    draw_needle,
    draw_shadow,
    draw_sheath,
)
from labrig.simulation.unevenness import NODE_MM

_CUT_WIDTH_MM = 0.4  # of the slit that a withdrawn needle leaves
_AIR = 1.06  # the light table is a little brighter where no gel lies on it


@dataclass(frozen=True)
class Backdrop:
    """A scene without the needle (H, W): sharp, and as the lens blurs it."""

    sharp: Field32
    soft: Field32


def draw_gel(world: WorldDescription, specimen: GelBlock, present: Hole, white: Field32) -> Field32:
    """Return the gel at the present hole, sharp, without that hole's own cuts."""
    shift_mm = present.position_mm
    sharp = _draw_clear_gel(world, specimen, shift_mm, white)
    for ball in specimen.obstacles:
        draw_ball(sharp, ball, world)
    for bubble in specimen.look.bubbles:
        draw_bubble(sharp, bubble, shift_mm, world)
    for hole in specimen.holes.values():
        if hole is not present:
            draw_channel(sharp, hole, shift_mm - hole.position_mm, world)
            _draw_old_cut(sharp, hole, shift_mm - hole.position_mm, world)
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


def _draw_old_cut(sharp: Field32, hole: Hole, shift_mm: float, world: WorldDescription) -> None:
    """Draw the slit that the needle has left at another hole."""
    if hole.track is None:
        return
    table = hole.track.table()
    table[:, 1] += shift_mm
    band = find_band(table, world.lens)
    if band is not None:
        span = PathSpan(0.0, hole.track.length_mm)
        draw_cut(sharp[band.region.slices], band, span, _CUT_WIDTH_MM, hole.patchiness)


def draw_channel(sharp: Field32, hole: Hole, shift_mm: float, world: WorldDescription) -> None:
    """Draw the channel that the sheath has left: as wide as the sheath, and fainter than the needle's slit."""
    if hole.sheath_reach_mm <= 0:
        return
    entry = hole.sheath_point_mm(-world.sheath_tip_at_origin_linear_mm)
    table = _make_straight_table(entry, hole, hole.sheath_reach_mm)
    table[:, 1] += shift_mm
    band = find_band(table, world.lens)
    if band is not None:
        span = PathSpan(0.0, hole.sheath_reach_mm)
        draw_cut(sharp[band.region.slices], band, span, world.sheath.diameter_mm, 0.5 * hole.patchiness)


def _make_straight_table(start_mm: tuple[float, float, float], hole: Hole, length_mm: float) -> Floats:
    """Return a straight path along the sheath of a hole as a table of nodes."""
    arc = np.arange(0.0, length_mm, NODE_MM)
    in_plane = arc * math.cos(hole.lean_rad)
    y = start_mm[1] + in_plane * math.sin(hole.heading_rad)
    z = start_mm[2] + in_plane * math.cos(hole.heading_rad)
    x = start_mm[0] + arc * math.sin(hole.lean_rad)
    straight = np.zeros_like(arc)
    heading, lean = np.full_like(arc, hole.heading_rad), np.full_like(arc, hole.lean_rad)
    return np.stack([arc, y, z, heading, straight, x, lean, straight], axis=1)


def draw_backdrop(world: WorldDescription, scene: Field32, hole: Hole, linear_mm: float) -> Backdrop:
    """Return a scene with the present hole's channel and the sheath in it."""
    sharp = scene.copy()
    draw_channel(sharp, hole, 0.0, world)
    draw_sheath(sharp, hole, linear_mm - world.sheath_tip_at_origin_linear_mm, world)
    return Backdrop(sharp, blur(sharp, world.blur_px))


def draw_with_needle(world: WorldDescription, behind: Backdrop, hole: Hole, span: PathSpan) -> Field32:
    """Return the blurred picture (H, W) with the needle, and with the slit from which it has been withdrawn.

    `span` is the part of the hole's track, possibly empty, that the needle fills beyond the sheath.
    """
    light = behind.soft.copy()
    if hole.track is None:
        return light
    band = find_band(hole.track.table(span.from_mm), world.lens, margin_px=2 * BLUR_REACH_PX + 2)
    if band is None:
        return light
    patch = behind.sharp[band.region.slices].copy()
    if hole.track.length_mm > span.to_mm:
        left = PathSpan(max(0.0, span.from_mm), hole.track.length_mm)
        draw_cut(patch, band, left, _CUT_WIDTH_MM, hole.patchiness)
    if span.to_mm > span.from_mm:
        draw_shadow(patch, band, span, world.light)
        draw_needle(patch, band, span, world)
    _paste(light, blur(patch, world.blur_px), band.region)
    return light


def _paste(light: Field32, patch: Field32, region: Region) -> None:
    """Put a blurred patch back without the rim whose blur lacks neighbours; the picture's edge has no such rim."""
    height, width = light.shape
    top = region.top + (BLUR_REACH_PX if region.top > 0 else 0)
    left = region.left + (BLUR_REACH_PX if region.left > 0 else 0)
    bottom = region.bottom - (BLUR_REACH_PX if region.bottom < height else 0)
    right = region.right - (BLUR_REACH_PX if region.right < width else 0)
    core = (slice(top - region.top, bottom - region.top), slice(left - region.left, right - region.left))
    light[top:bottom, left:right] = patch[core]
