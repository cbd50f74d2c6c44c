"""Recovery in the loop without pictures: the example protocol's insertion in simulated worlds with two cavities.

A cavity is a stretch of the path in which the needle does not steer. With two of them a needle may pass an obstacle on
the wrong side, or find its target inside its turning circle. The listed seeds are those that the search for a place
was made with; the fresh ones are others. A sighting has noise of 0.05 mm, and the sheath's pose is known, as from a
picture. LABRIG_BENCHMARK_WORLDS sets the number of fresh seeds.
"""

import math
import os
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.stats import binomtest

from labrig.experiments.insertion.settings import make_insertion_settings, with_start
from labrig.simulation.gel import Ball
from labrig.simulation.world import World
from labrig.steering.out_of_plane import OutOfPlaneSettings
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import Obstacle
from labrig.steering.torsion import TorsionalLag
from tests.benchmarks.blind_insertion import InsertionEnd, steer
from tests.benchmarks.table import print_rows
from tests.benchmarks.worlds import DrawnWorld, read_protocol, read_world

LISTED = range(1, 13)
FRESH = range(2001, 2001 + int(os.environ.get("LABRIG_BENCHMARK_WORLDS", "200")))
CAVITIES = 2
GELATIN_PERCENT = 13.0
SIGMA_MM = 0.05
TOLERANCE_MM = 2.0


def print_table() -> None:
    """Print how many insertions reach their target without and with recovery."""
    heads = (
        "two cavities", "recovery", "reached", "95 %", "withdrew", "... and reached", "touched", "other stops",
    )  # fmt: skip
    for name, seeds in (("listed", LISTED), ("fresh", FRESH)):
        rows = []
        for recovers in (False, True):
            with ProcessPoolExecutor() as executor:
                ends = list(executor.map(partial(insert, recovers=recovers), seeds, chunksize=2))
            rows.append([f"{name} seeds", "yes" if recovers else "no", *_summarise(ends)])
        print_rows(heads, rows)
        print(flush=True)
    print("limits with recovery: 11 of the 12 listed seeds, 90 % of the fresh ones")


def _summarise(ends: Sequence[InsertionEnd]) -> list[object]:
    reached = [end for end in ends if has_reached(end)]
    limits = binomtest(len(reached), len(ends)).proportion_ci(0.95, "wilson")
    stops = Counter(end.stop for end in ends if not has_reached(end))
    return [
        f"{len(reached)} of {len(ends)}",
        f"{100 * limits.low:.0f} to {100 * limits.high:.0f} %",
        sum(end.retreats > 0 for end in ends),
        sum(end.retreats > 0 for end in reached),
        sum(end.clearance_mm < 0 for end in ends),
        ", ".join(f"{stop} {count}" for stop, count in stops.items()) or "-",
    ]


def has_reached(end: InsertionEnd) -> bool:
    """Return whether an insertion stopped at its target, and is there in truth."""
    return end.stop == "target_reached" and end.error_mm <= TOLERANCE_MM


def insert(seed: int, *, recovers: bool) -> InsertionEnd:
    """Carry out an insertion in the world of a seed."""
    settings = _make_settings(recovers)
    world = _make_world(seed, settings)
    settings = _start_from_sheath(world, settings)
    nothing = OutOfPlaneSettings(0.0, 0.0, 0.0, 0.0, 0.0)
    noise = np.random.default_rng([seed, 3])
    drawn = DrawnWorld(world, settings.problem, SIGMA_MM, 0.0, TorsionalLag(), nothing, noise)
    return steer(drawn, settings, "back_and_forth")


def _make_settings(recovers: bool) -> SteeringSettings:
    protocol = read_protocol()
    target_mm = protocol.target.position_mm
    assert target_mm is not None
    obstacles = tuple(
        Obstacle(obstacle.position_mm, obstacle.radius_mm)
        for obstacle in protocol.obstacles
        if obstacle.position_mm is not None
    )
    settings = make_insertion_settings(protocol, target_mm, obstacles)
    return settings if recovers else replace(settings, recovery=None)


def _make_world(seed: int, settings: SteeringSettings) -> World:
    description = read_world("simulated")
    disturbances = description.disturbances.model_copy(update={"cavities": CAVITIES})
    world = World(description.model_copy(update={"disturbances": disturbances}), seed)
    world.mount_needle("N1")
    balls = [Ball(obstacle.position_mm, obstacle.radius_mm) for obstacle in settings.problem.obstacles]
    world.place_phantom("phantom", GELATIN_PERCENT, balls)
    world.aim_at(settings.problem.target_mm)
    return world


def _start_from_sheath(world: World, settings: SteeringSettings) -> SteeringSettings:
    """Return the settings with the start at the sheath's true tip, in its true direction."""
    world.advance(0.01, 0.0, world.description.sheath_tip_at_origin_linear_mm)
    start, end = world.centre_line_mm(2)
    heading_rad = math.atan2(*(end - start))
    return with_start(settings, start, heading_rad)
