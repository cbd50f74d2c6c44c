"""Closed loop without a camera: planner, estimator and steering step in the simulated world with all disturbances.

Each world draws its radius (16 % gel), play of the sheath, wandering heading and curvature, and one cavity; target and
two obstacles come from the planner's problems. The tip is observed every millimetre with a noise of 0.2 mm. The
figures are those of the world's own truth.
"""

import math
import statistics
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from labrig.simulation.description import WorldDescription
from labrig.simulation.gel import Ball
from labrig.simulation.world import World
from labrig.steering.parameters import SteeringPolicy
from labrig.steering.policy import SteeringSettings, TipSighting
from labrig.steering.problem import PlanProblem
from labrig.steering.step import start_steering, step_steering
from labrig.steering.tip import EstimatorSettings
from tests.benchmarks.planning_problems import RADIUS_MM, draw_planar_problem
from tests.benchmarks.table import print_rows

WORLDS = 200
SIGMA_MM = 0.2
# 0.3 degrees of wandering heading, and what the wandering curvature adds to it.
PROCESS_SD_RAD = math.radians(0.4)
MOST_STEPS = 1000


@dataclass(frozen=True)
class InsertionEnd:
    """The end of an insertion: why it stopped, and the world's truth about it."""

    stop: str
    error_mm: float
    clearance_mm: float
    replans: int
    turns: int


def print_table() -> None:
    """Print the default policy and the paper's in the same worlds, and the default policy without cavities."""
    rows = [
        _row(name, policy, cavities)
        for name, policy, cavities in (
            ("default", "default", 1),
            ("paper's", "paper", 1),
            ("default", "default", 0),
        )
    ]
    heads = (
        "policy",
        "cavities",
        "within 2 mm",
        "mean mm",
        "median",
        "95 %",
        "worst",
        "touched",
        "replans",
        "turns",
        "stops",
    )
    print_rows(heads, rows)
    print("limits for the default policy: within 2 mm in 99 %, mean error 0.4 mm, no obstacle touched")


def _row(name: str, policy: str, cavities: int) -> list[object]:
    with ProcessPoolExecutor() as executor:
        done = list(
            executor.map(partial(insert, policy=policy, cavities=cavities), range(WORLDS), chunksize=4)
        )
    errors = sorted(insertion.error_mm for insertion in done)
    stops = ", ".join(
        f"{stop} {count}" for stop, count in Counter(insertion.stop for insertion in done).most_common()
    )
    return [
        name, cavities, f"{100 * sum(error <= 2 for error in errors) / WORLDS:.1f} %", f"{statistics.mean(errors):.2f}",
        f"{statistics.median(errors):.2f}", f"{np.percentile(errors, 95):.2f}", f"{errors[-1]:.2f}",
        sum(insertion.clearance_mm < 0 for insertion in done),
        f"{statistics.mean(insertion.replans for insertion in done):.0f}",
        f"{statistics.mean(insertion.turns for insertion in done):.0f}", stops,
    ]  # fmt: skip


def steering_settings(problem: PlanProblem, policy: str) -> SteeringSettings:
    """Return the settings of a policy for the worlds of this table."""
    if policy == "paper":
        estimator = EstimatorSettings(RADIUS_MM, SIGMA_MM, PROCESS_SD_RAD, "paper", planar=True)
        return SteeringSettings(problem, estimator, SteeringPolicy.paper(), "paper")
    estimator = EstimatorSettings(
        RADIUS_MM, SIGMA_MM, PROCESS_SD_RAD, planar=True, radius_sd_mm=0.6, cavity_every_mm=50.0
    )
    return SteeringSettings(problem, estimator)


def insert(seed: int, policy: str, cavities: int) -> InsertionEnd:
    """Carry out one insertion in the world of a seed."""
    problem = draw_planar_problem(np.random.default_rng([2, seed]), 2)
    world = _make_world(seed, problem, cavities)
    chosen = steering_settings(problem, policy)
    noise = np.random.default_rng([seed, 3])
    linear_mm = world.description.sheath_tip_at_origin_linear_mm
    world.advance(0.0, 0.0, linear_mm)
    roll_rad, turns = 0.0, 0
    state, command = start_steering(chosen)
    for _ in range(MOST_STEPS):
        if command.stop is not None:
            break
        roll_rad += command.roll_rad
        turns += command.roll_rad != 0.0
        world.advance(command.observe_at_mm, roll_rad, linear_mm)
        y, z = world.centre_line_mm(2)[-1]
        seen = np.array((0.0, y, z)) + np.array((0.0, *noise.normal(0.0, SIGMA_MM, 2)))
        state, command = step_steering(state, TipSighting(command.observe_at_mm, seen), chosen)
    truth: Any = world.truth()
    return InsertionEnd(
        command.stop or "never",
        truth["true_target_error_mm"],
        truth["true_min_clearance_mm"],
        state.replans,
        turns,
    )


def _make_world(seed: int, problem: PlanProblem, cavities: int) -> World:
    description = WorldDescription()
    disturbances = description.disturbances.model_copy(update={"cavities": cavities})
    world = World(description.model_copy(update={"disturbances": disturbances}), seed)
    world.mount_needle("N1")
    world.place_phantom("phantom", 16.0, [Ball(o.position_mm, o.radius_mm) for o in problem.obstacles])
    world.aim_at(problem.target_mm)
    return world
