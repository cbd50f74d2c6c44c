"""Targets and obstacles that move while the needle goes in, as tissue is pushed or drawn along.

They are told to move evenly with the inserted length (`Motion`). A path is planned to where the target will be when the
tip gets there, past obstacles where they will be when the tip comes to them. The tip needs at least the straight
distance for it; a path is some percent longer, which matters the less the nearer the tip is.

Or their displacement is measured on the way (`Displacements`). They are then planned with where they are now, and each
picture moves them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

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


@dataclass(frozen=True)
class Displacement:
    """How far a place has moved in the plane, (y, z), and its standard deviation along each axis [mm]."""

    moved_mm: tuple[float, float]
    sd_mm: float

    def move(self, place_mm: Point) -> Point:
        """Return where a place (x, y, z) is now."""
        x, y, z = place_mm
        return x, y + self.moved_mm[0], z + self.moved_mm[1]


@dataclass(frozen=True)
class Displacements:
    """The measured displacements of target and obstacles; None for what is not followed.

    No obstacle is followed if `obstacles` is empty.
    """

    target: Displacement | None = None
    obstacles: tuple[Displacement | None, ...] = ()

    @classmethod
    def by_marker(cls, marker_ids: Sequence[int | None], moved: Mapping[int, Displacement]) -> Self:
        """Return the displacements of what is bound to markers.

        Parameters
        ----------
        marker_ids : sequence of int or None
            The markers of the target and of each obstacle, the target's first; None for what is bound to none, and
            empty if nothing is bound.
        moved : mapping
            The displacement of each marker that is known.
        """
        if not marker_ids:
            return cls()
        target, *obstacles = (None if marker_id is None else moved.get(marker_id) for marker_id in marker_ids)
        return cls(target, tuple(obstacles))

    def move_target(self, target_mm: Point) -> Point:
        """Return where a target (x, y, z) is now."""
        return target_mm if self.target is None else self.target.move(target_mm)

    def move_obstacles(self, obstacles: tuple[Obstacle, ...]) -> tuple[Obstacle, ...]:
        """Return obstacles where they are now."""
        return tuple(
            obstacle if moved is None else replace(obstacle, position_mm=moved.move(obstacle.position_mm))
            for obstacle, moved in zip(obstacles, self.obstacles or (None,) * len(obstacles), strict=True)
        )


def displace_problem(problem: PlanProblem, displacements: Displacements) -> PlanProblem:
    """Return a problem with target and obstacles where they are now, and with their uncertainty."""
    return replace(
        problem,
        target_mm=displacements.move_target(problem.target_mm),
        obstacles=displacements.move_obstacles(problem.obstacles),
        obstacle_sds_mm=tuple(0.0 if moved is None else moved.sd_mm for moved in displacements.obstacles),
    )


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


def locate_places(
    target_mm: Point,
    obstacles: tuple[Obstacle, ...],
    motion: Motion | None,
    inserted_mm: float,
    displacements: Displacements,
) -> tuple[Point, tuple[Obstacle, ...]]:
    """Return where target and obstacles are at an insertion length, told or measured."""
    return (
        displacements.move_target(move_target(target_mm, motion, inserted_mm)),
        displacements.move_obstacles(move_obstacles(obstacles, motion, inserted_mm)),
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
