"""The aim of an insertion: target and obstacles of the protocol in mm, and what rules them out."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from labrig.errors import InputError, Problem
from labrig.experiments.insertion.protocol import InsertionObstacle, InsertionProtocol, Place, Target
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.steering.problem import Obstacle
from labrig.vision.plane import PlaneMap
from labrig.vision.tip import RIM_PX, is_off_rim

Point = tuple[float, float, float]
Pixel = tuple[float, float]


@dataclass(frozen=True)
class Aim:
    """Target and obstacles in the frame of the steering plane."""

    target_mm: Point
    obstacles: tuple[Obstacle, ...]


@dataclass(frozen=True)
class PickedPlaces:
    """Pixels (u, v) that the operator named: that of the target, and those of obstacles by their numbers from 0."""

    target_px: Pixel | None = None
    obstacles_px: Mapping[int, Pixel | None] = field(default_factory=dict)


def make_aim(protocol: InsertionProtocol, plane: PlaneMap, picked: PickedPlaces | None = None) -> Aim:
    """Return the target of an insertion and the obstacles that it avoids.

    Parameters
    ----------
    protocol : InsertionProtocol
    plane : PlaneMap
        Maps pixels of the protocol, and those picked, to mm.
    picked : PickedPlaces, optional
        The pixels that the protocol asks for.

    Raises
    ------
    InputError
        When the protocol asks for a place and no pixel was picked.
    """
    picked = picked or PickedPlaces()
    return Aim(
        _locate_picked(protocol.target, picked.target_px, "the target", plane),
        tuple(
            Obstacle(
                _locate_picked(obstacle, picked.obstacles_px.get(number), f"obstacle {number + 1}", plane),
                obstacle.radius_mm,
            )
            for number, obstacle in enumerate(protocol.obstacles)
        ),
    )


def locate_stated_obstacles(protocol: InsertionProtocol, plane: PlaneMap) -> tuple[Obstacle, ...]:
    """Return in mm the obstacles whose places the protocol states."""
    return tuple(
        Obstacle(_locate(obstacle, plane), obstacle.radius_mm)
        for obstacle in protocol.obstacles
        if not obstacle.ask
    )


def _locate_picked(
    place: Target | InsertionObstacle, picked_px: Pixel | None, what: str, plane: PlaneMap
) -> Point:
    """Return a place in mm, by the picked pixel if the protocol asks for it. Raises `InputError`."""
    if place.ask and picked_px is None:
        raise InputError(f"{what} was asked for and not named", "name its pixel")
    return _locate(Place(pixel=picked_px) if place.ask else place, plane)


def find_pixel_problems(protocol: InsertionProtocol, plane: PlaneMap) -> Iterator[Problem]:
    """Yield pixels that lie outside the camera's picture."""
    for where, place in protocol.places.items():
        if place.pixel is None or plane.image_size is None:
            continue
        (u, v), (width, height) = place.pixel, plane.image_size
        if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
            message = f"pixel ({u:g}, {v:g}) lies outside of the camera's view of {width}x{height} px"
            yield Problem(f"{where}.pixel", message, "u counts to the right, v down, both from 0")


def find_aim_problems(protocol: InsertionProtocol, aim: Aim, plane: PlaneMap) -> Iterator[Problem]:
    """Yield the problems of an aim: a target out of tissue, out of view or inside an obstacle, and stray obstacles."""
    yield from _find_target_outside_tissue(protocol, aim.target_mm)
    yield from _find_target_out_of_view(aim.target_mm, plane)
    for number, obstacle in enumerate(aim.obstacles):
        yield from _find_stray_obstacle(protocol, f"obstacles.{number}", obstacle, plane)
    try:
        make_insertion_settings(protocol, aim.target_mm, aim.obstacles)
    except InputError as error:
        yield Problem("target", error.message, error.hint)


def _locate(place: Place, plane: PlaneMap) -> Point:
    if place.position_mm is not None:
        return place.position_mm
    y_mm, z_mm = plane.to_mm(np.array([place.pixel], dtype=float))[0].tolist()
    return 0.0, y_mm, z_mm


def _find_target_outside_tissue(protocol: InsertionProtocol, target_mm: Point) -> Iterator[Problem]:
    y_mm, z_mm = target_mm[1:]
    if _is_in_tissue(protocol, target_mm, reach_mm=0.0):
        return
    message = f"the target at y {y_mm:.1f}, z {z_mm:.1f} mm lies outside of the tissue, {_describe_tissue(protocol)}"
    yield Problem(
        "target", message, "aim at a point of the block, or correct specimen length_mm and width_mm"
    )


def _is_in_tissue(protocol: InsertionProtocol, position_mm: Point, reach_mm: float) -> bool:
    """Return whether a sphere of radius `reach_mm` at a position lies in the block, at least in part."""
    _, y_mm, z_mm = position_mm
    depth_mm = protocol.sheath.depth_mm
    far_mm, half_mm = protocol.specimen.length_mm - depth_mm, protocol.specimen.width_mm / 2
    return -depth_mm - reach_mm <= z_mm <= far_mm + reach_mm and abs(y_mm) <= half_mm + reach_mm


def _describe_tissue(protocol: InsertionProtocol) -> str:
    block, depth_mm = protocol.specimen, protocol.sheath.depth_mm
    return (
        f"which reaches from z {-depth_mm:g} to {block.length_mm - depth_mm:g} mm and to "
        f"{block.width_mm / 2:g} mm aside"
    )


def _find_stray_obstacle(
    protocol: InsertionProtocol, where: str, obstacle: Obstacle, plane: PlaneMap
) -> Iterator[Problem]:
    """Yield an obstacle that no path could touch, because it lies wholly outside the tissue or the camera's view."""
    _, y_mm, z_mm = obstacle.position_mm
    place = f"the obstacle at y {y_mm:.1f}, z {z_mm:.1f} mm, radius {obstacle.radius_mm:g} mm"
    hint = "correct its position (mm, or a pixel of the picture), or leave it out"
    if not _is_in_tissue(protocol, obstacle.position_mm, reach_mm=obstacle.radius_mm):
        yield Problem(where, f"{place}, lies outside of the tissue, {_describe_tissue(protocol)}", hint)
    elif plane.image_size is not None:
        width, height = plane.image_size
        u, v = plane.to_px(np.array([[y_mm, z_mm]]))[0].tolist()
        reach_px = obstacle.radius_mm / plane.mm_per_px
        if not (-reach_px <= u <= width - 1 + reach_px and -reach_px <= v <= height - 1 + reach_px):
            seen = f"it would be seen at ({u:.0f}, {v:.0f}) px of {width}x{height} px"
            yield Problem(where, f"{place}, lies outside of the camera's view: {seen}", hint)


def _find_target_out_of_view(target_mm: Point, plane: PlaneMap) -> Iterator[Problem]:
    if plane.image_size is None:
        return
    width, height = plane.image_size
    u, v = plane.to_px(np.array([target_mm[1:]]))[0].tolist()
    if not is_off_rim(u, v, plane.image_size):
        message = (
            f"the target is outside of the camera's view: it would be seen at ({u:.0f}, {v:.0f}) px, and a tip is "
            f"found down to {RIM_PX:g} px from the rim of {width}x{height} px"
        )
        yield Problem("target", message, "aim at a point in view, or move the camera and calibrate it again")
