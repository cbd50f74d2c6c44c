"""Targets and obstacles that move while the needle goes in, as tissue is pushed or drawn along.

They are told to move evenly with the inserted length. A path is planned to where the target will be when the tip gets
there, past obstacles where they will be when the tip comes to them. The tip needs at least the straight distance for
it; a path is some percent longer, which matters the less the nearer the tip is.
"""

from dataclasses import dataclass, replace

import numpy as np

from labrig.needle.kinematics import FloatArray
from labrig.steering.problem import Obstacle, PlanProblem, Point

# Rounds in which the length at which the tip meets a moving place is found.
_ROUNDS = 8


@dataclass(frozen=True)
class Motion:
    """How target and obstacles move, along (x, y, z), for each millimetre that the needle is inserted [mm/mm]."""

    target: Point
    obstacles: tuple[Point, ...]


def move_target(target_mm: Point, motion: Motion | None, inserted_mm: float) -> Point:
    """Return where a target (x, y, z) is at an insertion length."""
    return target_mm if motion is None else _move(target_mm, motion.target, inserted_mm)


def move_obstacles(
    obstacles: tuple[Obstacle, ...], motion: Motion | None, inserted_mm: float
) -> tuple[Obstacle, ...]:
    """Return obstacles where they are at an insertion length."""
    if motion is None:
        return obstacles
    return tuple(
        replace(obstacle, position_mm=_move(obstacle.position_mm, rate, inserted_mm))
        for obstacle, rate in zip(obstacles, motion.obstacles, strict=True)
    )


def expect_places(
    problem: PlanProblem, motion: Motion | None, inserted_mm: float, tip_mm: FloatArray
) -> tuple[Point, tuple[Obstacle, ...]]:
    """Return target and obstacles where they will be when a tip, now at this insertion length and place, gets there."""
    if motion is None:
        return problem.target_mm, problem.obstacles
    obstacles = tuple(
        replace(obstacle, position_mm=_meet(obstacle.position_mm, rate, inserted_mm, tip_mm))
        for obstacle, rate in zip(problem.obstacles, motion.obstacles, strict=True)
    )
    return _meet(problem.target_mm, motion.target, inserted_mm, tip_mm), obstacles


def _meet(place_mm: Point, rate: Point, inserted_mm: float, tip_mm: FloatArray) -> Point:
    met_mm = _move(place_mm, rate, inserted_mm)
    for _ in range(_ROUNDS):
        met_mm = _move(place_mm, rate, inserted_mm + float(np.linalg.norm(np.subtract(met_mm, tip_mm))))
    return met_mm


def _move(place_mm: Point, rate: Point, inserted_mm: float) -> Point:
    x, y, z = (place + along * inserted_mm for place, along in zip(place_mm, rate, strict=True))
    return x, y, z
