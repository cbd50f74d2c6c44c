"""A simulated bench in the states that the tests start from."""

import numpy as np
import numpy.typing as npt

from labrig.simulation.description import WorldDescription
from labrig.simulation.world import World

QUIET = WorldDescription(noise_sd=0.0, bubbles_per_specimen=0)


def bench(
    description: WorldDescription = QUIET, seed: int = 5, *, hole: int = 0, position_mm: float = 35.0
) -> World:
    """Return a world with a needle and a 13 % gel, shifted to a hole, the sheath outside."""
    world = World(description, seed)
    world.mount_needle("N1")
    world.place_specimen("A", 13.0)
    world.shift_to_hole("A", hole, position_mm)
    return world


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
