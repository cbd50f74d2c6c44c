"""The aim of an insertion: target and obstacles of the protocol in mm, and what rules them out."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from labrig.errors import InputError, Problem
from labrig.experiments.insertion.protocol import InsertionProtocol, Place
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.steering.problem import Obstacle
from labrig.vision.plane import PlaneMap
from labrig.vision.tip import RIM_PX

Point = tuple[float, float, float]
Pixel = tuple[float, float]

_CORRECT = "correct its position (mm, or a pixel of the picture, u to the right and v down from 0)"


@dataclass(frozen=True)
class Aim:
    """Target and obstacles in the frame of the steering plane."""

    target_mm: Point
    obstacles: tuple[Obstacle, ...]


def make_aim(
    protocol: InsertionProtocol, plane: PlaneMap, picked: Mapping[str, Pixel | None] = MappingProxyType({})
) -> Aim:
    """Return the target of an insertion and the obstacles that it avoids.

    Parameters
    ----------
    protocol : InsertionProtocol
    plane : PlaneMap
        Maps pixels of the protocol, and those picked, to mm.
    picked : mapping of str to (float, float)
        The pixels (u, v) that the protocol asks for, by dotted keys.

    Raises
    ------
    InputError
        When the protocol asks for a place and no pixel was picked.
    """
    target_mm, *centres_mm = (
        locate_place(key, place, plane, picked.get(key)) for key, place in protocol.places.items()
    )
    radii_mm = (obstacle.radius_mm for obstacle in protocol.obstacles)
    return Aim(target_mm, tuple(map(Obstacle, centres_mm, radii_mm)))


def locate_place(key: str, place: Place, plane: PlaneMap, picked_px: Pixel | None = None) -> Point:
    """Return a place in mm, by the picked pixel if the protocol asks for it. Raises `InputError` without one."""
    if place.position_mm is not None:
        return place.position_mm
    pixel = picked_px if place.ask else place.pixel
    if pixel is None:
        raise InputError(f"{key} was asked for and not named", "name its pixel")
    y_mm, z_mm = plane.to_mm(np.array([pixel], dtype=float))[0].tolist()
    return 0.0, y_mm, z_mm


def find_pixel_problems(protocol: InsertionProtocol, plane: PlaneMap) -> Iterator[Problem]:
    """Yield stated pixels that lie outside the camera's picture, where the map says nothing."""
    for key, place in protocol.places.items():
        for at, size in zip(place.pixel or (), plane.image_size or (), strict=False):
            if not 0 <= at <= size - 1:
                yield Problem(
                    f"{key}.pixel", f"pixel {place.pixel} lies outside of the camera's view", _CORRECT
                )
                break


def find_aim_problems(protocol: InsertionProtocol, aim: Aim, plane: PlaneMap) -> Iterator[Problem]:
    """Yield the problems of an aim: a target or an obstacle out of tissue or view, and a target inside an obstacle.

    An obstacle that no path could touch, because it lies wholly outside, was placed by mistake.
    """
    yield from _find_stray("target", aim.target_mm, 0.0, protocol, plane)
    for number, obstacle in enumerate(aim.obstacles):
        yield from _find_stray(
            f"obstacles.{number}", obstacle.position_mm, obstacle.radius_mm, protocol, plane
        )
    try:
        make_insertion_settings(protocol, aim.target_mm, aim.obstacles)
    except InputError as error:
        yield Problem("target", error.message, error.hint)


def _find_stray(
    key: str, place_mm: Point, radius_mm: float, protocol: InsertionProtocol, plane: PlaneMap
) -> Iterator[Problem]:
    """Yield a sphere of this radius that lies wholly outside the tissue or the camera's view."""
    block, depth_mm, (_, y, z) = protocol.specimen, protocol.sheath.depth_mm, place_mm
    far_mm, half_mm = block.length_mm - depth_mm, block.width_mm / 2
    what = f"obstacle {int(key.split('.')[1]) + 1}" if radius_mm else "the target"
    at = f"{what} at y {y:.1f}, z {z:.1f} mm" + (f", radius {radius_mm:g} mm," if radius_mm else "")
    if not (-depth_mm - radius_mm <= z <= far_mm + radius_mm and abs(y) <= half_mm + radius_mm):
        tissue = f"which reaches from z {-depth_mm:g} to {far_mm:g} mm and to {half_mm:g} mm aside"
        hint = f"{_CORRECT}, or specimen length_mm and width_mm"
        yield Problem(key, f"{at} lies outside of the tissue, {tissue}", hint)
    elif plane.image_size is not None:
        width, height = plane.image_size
        u, v = plane.to_px(np.array([[y, z]]))[0].tolist()
        # A tip is found down to the rim; of an obstacle a part has to be in view.
        reach_px = radius_mm / plane.mm_per_px if radius_mm else -RIM_PX
        if not (-reach_px <= u <= width - 1 + reach_px and -reach_px <= v <= height - 1 + reach_px):
            seen = f"it would be seen at ({u:.0f}, {v:.0f}) px of {width}x{height} px"
            rim = "" if radius_mm else f", and a tip is found down to {RIM_PX:g} px from the rim"
            hint = f"{_CORRECT}, or move the camera and calibrate it again"
            yield Problem(key, f"{at} lies outside of the camera's view: {seen}{rim}", hint)
