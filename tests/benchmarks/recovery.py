"""Recovery in the loop without pictures: the example protocol's insertion in simulated worlds with two cavities.

A cavity is a stretch of the path in which the needle does not steer. With two of them a needle may pass an obstacle on
the wrong side, or find its target inside its turning circle. The listed seeds are those that the search for a place
was made with; the fresh ones are others. A sighting has noise of 0.05 mm, and the sheath's pose is known, as from a
picture.
"""

import math
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import make_insertion_settings, with_start
from labrig.protocol.load import load_protocol
from labrig.simulation.description import WorldDescription
from labrig.simulation.gel import Ball
from labrig.simulation.world import World
from labrig.steering.policy import SteeringSettings, TipSighting
from labrig.steering.problem import Obstacle
from labrig.steering.step import retreat_steering, start_steering, step_steering
from tests.benchmarks.table import print_rows

PROTOCOL = Path(__file__).parents[2] / "protocols" / "insertion.yaml"
LISTED, FRESH = range(1, 13), range(2001, 2041)
CAVITIES = 2
GELATIN_PERCENT = 13.0
SIGMA_MM = 0.05
MOST_STEPS = 1000


@dataclass(frozen=True)
class Recovered:
    """The end of an insertion: why it stopped, the world's truth about it, and how often the needle was withdrawn."""

    stop: str
    error_mm: float
    clearance_mm: float
    retreats: int


def print_table() -> None:
    """Print how many insertions reach their target without and with recovery."""
    rows = []
    for name, seeds in (("listed", LISTED), ("fresh", FRESH)):
        for recovers in (False, True):
            ends = [insert(seed, recovers=recovers) for seed in seeds]
            reached = [end for end in ends if end.stop == "target_reached" and end.error_mm <= 2.0]
            stops = Counter(end.stop for end in ends if end not in reached)
            rows.append([
                f"{name} seeds", "yes" if recovers else "no", f"{len(reached)} of {len(ends)}",
                sum(end.retreats > 0 for end in ends), sum(end.retreats > 0 for end in reached),
                sum(end.clearance_mm < 0 for end in ends),
                ", ".join(f"{stop} {count}" for stop, count in stops.items()) or "-",
            ])  # fmt: skip
    heads = ("two cavities", "recovery", "reached", "withdrew", "... and reached", "touched", "other stops")
    print_rows(heads, rows)
    print("limits with recovery: 11 of the 12 listed seeds, 90 % of the fresh ones")


def insert(seed: int, *, recovers: bool) -> Recovered:
    """Carry out an insertion in the world of a seed."""
    settings = _make_settings(recovers)
    world = _make_world(seed, settings)
    linear_mm = world.description.sheath_tip_at_origin_linear_mm
    world.advance(0.0, 0.0, linear_mm)
    settings = _start_from_sheath(world, settings)
    noise = np.random.default_rng([seed, 3])
    state, command = start_steering(settings)
    roll_rad, turns = 0.0, list[tuple[float, float]]()
    for _ in range(MOST_STEPS):
        if command.stop is not None:
            break
        if command.withdraw_to_mm is not None and command.leave_mm is not None:
            while turns and turns[-1][0] > command.withdraw_to_mm:
                at_mm, turned_rad = turns.pop()
                world.advance(at_mm, roll_rad, linear_mm)
                roll_rad -= turned_rad
            world.advance(command.withdraw_to_mm, roll_rad, linear_mm)
            state, command = retreat_steering(state, command.leave_mm, settings)
            continue
        if command.roll_rad != 0.0:
            turns.append((state.insertion_mm, command.roll_rad))
            roll_rad += command.roll_rad
        world.advance(command.observe_at_mm, roll_rad, linear_mm)
        y, z = world.centre_line_mm(2)[-1] + noise.normal(0.0, SIGMA_MM, 2)
        sighting = TipSighting(command.observe_at_mm, np.array((0.0, y, z)))
        state, command = step_steering(state, sighting, settings)
    truth: Any = world.truth()
    return Recovered(
        command.stop or "never",
        truth["true_target_error_mm"],
        truth["true_min_clearance_mm"],
        state.retreats,
    )


def _make_settings(recovers: bool) -> SteeringSettings:
    protocol = load_protocol(PROTOCOL, PROTOCOL_MODELS, ["recovery={}"])
    assert isinstance(protocol, InsertionProtocol)
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
    description = WorldDescription()
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
