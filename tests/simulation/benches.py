"""A simulated bench in the states that the tests start from."""

import json
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from labrig.simulation.description import WorldDescription
from labrig.simulation.gel import Ball
from labrig.simulation.world import World

QUIET = WorldDescription(noise_sd=0.0, bubbles_per_specimen=0)
STILL_SHEATH = {"lateral_play_sd_mm": 0, "angle_play_sd_deg": 0}
SMALL_LENS = {"width_px": 64, "height_px": 64, "cx_px": 32, "cy_px": 32, "origin_px": [32, 32]}


def bench(
    description: WorldDescription = QUIET, seed: int = 5, *, hole: int = 0, position_mm: float = 35.0
) -> World:
    """Return a world with a needle and a 13 % gel, shifted to a hole, the sheath outside."""
    world = World(description, seed)
    world.mount_needle("N1")
    world.place_specimen("A", 13.0)
    world.shift_to_hole("A", hole, position_mm)
    return world


def before_gel(seed: int = 1, balls: Sequence[Ball] | None = None, **changes: object) -> World:
    """Return a quiet world with a needle before a gel, or before a phantom with these obstacles; the sheath is in."""
    values = {"noise_sd": 0, "bubbles_per_specimen": 0, **changes}
    world = World(WorldDescription.model_validate_json(json.dumps(values)), seed)
    world.mount_needle("N1")
    if balls is None:
        world.place_specimen("block", 13.0)
    else:
        world.place_phantom("block", 13.0, balls)
    world.advance(0.0, 0.0, 15.0)
    return world


def one_radius(radius_mm: float) -> list[dict[str, float]]:
    """Return the gels of a world in which every needle has this radius."""
    return [{"gelatin_percent": 13, "radius_mean_mm": radius_mm, "radius_sd_mm": 0}]


def insert(world: World, depth_mm: float, *, roll_rad: float = 0.0, step_mm: float = 0.5) -> None:
    """Introduce the sheath and insert the needle in steps."""
    world.advance(0.0, roll_rad, 15.0)
    for count in range(1, round(depth_mm / step_mm) + 1):
        world.advance(count * step_mm, roll_rad, 15.0)


def withdraw(world: World) -> None:
    """Withdraw the needle, then the sheath."""
    world.advance(0.0, 0.0, 15.0)
    world.advance(0.0, 0.0, 0.0)


def centre_line_mm(world: World, points: int = 400) -> npt.NDArray[np.float64]:
    """Return the needle's true path up to its tip, (points, 2) as (y, z); empty while it is inside the sheath."""
    seen = world.glance()
    if seen.track is None:
        return np.empty((0, 2))
    nodes = [seen.track.node_at(arc) for arc in np.linspace(0.0, seen.tip_arc_mm, points)]
    return np.array([(node.y_mm, node.z_mm) for node in nodes])
