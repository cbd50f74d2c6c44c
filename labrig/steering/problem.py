"""The planning problem, checked when it is made, and its view from the needle's tip."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from labrig.errors import InputError
from labrig.needle.kinematics import FloatArray
from labrig.steering.parameters import PlanWeights
from labrig.steering.tip import require_pose

Point = tuple[float, float, float]

HIGHEST_MAX_ARCS = 12
_MARGIN_SIGMAS, _MARGIN_REACH_MM = 2.0, 10.0
"""The required clearance grows by so many standard deviations of the tip's position this far ahead, and of the place of
an obstacle."""


@dataclass(frozen=True)
class Obstacle:
    """A sphere that the needle must not touch, in the world frame."""

    position_mm: Point
    radius_mm: float


@dataclass(frozen=True)
class PlanProblem:
    """Where the needle is, where it has to go, and the obstacles between; a path turns by 90 degrees at most.

    Parameters
    ----------
    target_mm : (x, y, z)
        In the world frame, as all positions here.
    obstacles : tuple of Obstacle
    start : (4, 4) array
        Pose of {1b}: of the needle's tip, its z axis along the needle.
    radius_mm, diameter_mm : float
        Of the needle's arcs, and of the needle.
    radius_range_mm : (float, float) or None
        Smallest and largest radius that the needle may have, as a design file states; None: not stated.
    cavity_mm : float
        Length of a cavity, in which the needle goes straight, that the path should tolerate; 0: no cavities.
    tolerance_mm : float
        How far from the target the path may end.
    clearance_mm : float
        Required distance from the needle's surface to an obstacle's.
    max_arcs : int
    max_length_mm : float
    axis, max_off_axis_rad : (x, y, z) or None, float
        Largest angle between a direction and the path at the ends of its arcs; None: no limit. It keeps a path that
        is replanned many times near the direction of its first plan.
    planar : bool
        The path stays in the y-z plane of the start: delta_1 is 0 or pi, every later roll is pi (errata, planar rule).
    covariance : (k, k) array, optional
        Of the start's position [mm] and rotation vector [rad] in the tip's frame, in the first six places.
    obstacle_sds_mm : tuple of float
        Standard deviation of each obstacle's place along each axis; empty: they are where they are said to be.
    weights : PlanWeights

    Raises
    ------
    InputError
        If a value is not a number, a size is not positive, or the start is not a pose.
    """

    target_mm: Point
    obstacles: tuple[Obstacle, ...] = ()
    start: FloatArray = field(default_factory=lambda: np.eye(4))
    radius_mm: float = 27.6
    radius_range_mm: tuple[float, float] | None = None
    cavity_mm: float = 0.0
    diameter_mm: float = 1.2
    tolerance_mm: float = 2.0
    clearance_mm: float = 0.6
    max_arcs: int = 6
    max_length_mm: float = 150.0
    axis: Point | None = None
    max_off_axis_rad: float = math.pi / 2
    planar: bool = False
    covariance: FloatArray | None = None
    obstacle_sds_mm: tuple[float, ...] = ()
    weights: PlanWeights = field(default_factory=PlanWeights)

    def __post_init__(self) -> None:
        """Refuse a problem for which no path can be planned; what a protocol states is checked there."""
        sizes = (self.radius_mm, self.diameter_mm, self.tolerance_mm, self.max_length_mm, self.clearance_mm)
        _require(all(map(math.isfinite, (*self.target_mm, *sizes))), "target or a size", "not a number")
        _require(min(sizes) >= 0 and self.radius_mm > 0 and self.tolerance_mm > 0, "a size", "not positive")
        _require(1 <= self.max_arcs <= HIGHEST_MAX_ARCS, "max_arcs", f"not 1 to {HIGHEST_MAX_ARCS}")
        _require(self.diameter_mm < 2 * self.radius_mm, "diameter_mm", "not below twice the radius")
        if self.radius_range_mm is not None:
            low_mm, high_mm = self.radius_range_mm
            about = self.diameter_mm / 2 < low_mm <= self.radius_mm <= high_mm
            _require(about, "radius_range_mm", f"not about radius_mm, {self.radius_mm:g}")
        require_pose("start", self.start)
        for number, obstacle in enumerate(self.obstacles, start=1):
            _require(obstacle.radius_mm > 0, f"obstacle {number} radius_mm", "not positive")
            self._check_obstacle(number, obstacle)

    def _check_obstacle(self, number: int, obstacle: Obstacle) -> None:
        centre = np.asarray(obstacle.position_mm)
        for name, point in (("start", np.asarray(self.start)[:3, 3]), ("target", np.asarray(self.target_mm))):
            offset = point - centre
            apart = math.sqrt(offset @ offset)
            if apart <= obstacle.radius_mm:
                raise InputError(
                    f"the {name} lies inside obstacle {number}: {apart:.2f} mm from its centre, "
                    f"and its radius is {obstacle.radius_mm:g} mm",
                    f"move the {name} or the obstacle",
                )

    @property
    def margin_mm(self) -> float:
        """Growth of the clearance, because the start is not known exactly."""
        if self.covariance is None:
            return 0.0
        position = float(np.linalg.eigvalsh(self.covariance[:3, :3])[-1])
        turning = float(np.linalg.eigvalsh(self.covariance[3:6, 3:6])[-1])
        return _MARGIN_SIGMAS * math.sqrt(max(position + turning * _MARGIN_REACH_MM**2, 0.0))

    @property
    def margins_mm(self) -> FloatArray:
        """Growth of the clearance from each obstacle, (K,): also because its own place is not known exactly."""
        margins_mm = np.full(len(self.obstacles), self.margin_mm)
        if not self.obstacle_sds_mm:
            return margins_mm
        return np.asarray(np.hypot(margins_mm, _MARGIN_SIGMAS * np.array(self.obstacle_sds_mm)))


@dataclass(frozen=True)
class Surroundings:
    """A problem in {1b}: the start is the origin and the needle points along z.

    `keep_off_mm` (K,) is the distance that the needle's centre line keeps from each obstacle's centre.
    """

    problem: PlanProblem

    @cached_property
    def target_mm(self) -> FloatArray:
        """The target, (3,)."""
        return self._to_start_frame(np.asarray(self.problem.target_mm, dtype=float))

    @cached_property
    def centres_mm(self) -> FloatArray:
        """The obstacles' centres, (K, 3)."""
        positions = [obstacle.position_mm for obstacle in self.problem.obstacles]
        return self._to_start_frame(np.asarray(positions, dtype=float).reshape(-1, 3))

    @cached_property
    def needle_and_obstacle_mm(self) -> FloatArray:
        """The distance from the centre line at which needle and obstacle touch, (K,)."""
        radii = np.array([obstacle.radius_mm for obstacle in self.problem.obstacles], dtype=float)
        return radii + self.problem.diameter_mm / 2

    @cached_property
    def keep_off_mm(self) -> FloatArray:
        """The distance from the centre line that keeps the required clearance and the margin, (K,)."""
        return self.needle_and_obstacle_mm + self.problem.clearance_mm + self.problem.margins_mm

    def _to_start_frame(self, points: FloatArray) -> FloatArray:
        start = np.asarray(self.problem.start, dtype=float)
        return np.asarray((points - start[:3, 3]) @ start[:3, :3])


def _require(holds: bool, name: str, fault: str) -> None:
    if not holds:
        raise InputError(f"{name} is {fault}", "correct it and plan again")
