"""Targets and obstacles that move while the needle goes in, as printed markers beside them show.

Their displacement is measured on the way. They are planned with where they are now, and each picture moves them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

from labrig.steering.problem import Obstacle, PlanProblem, Point


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
