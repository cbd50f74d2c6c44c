"""The scenario of `labrig plan`: a needle, a target and obstacles, without any rig."""

from collections.abc import Iterator
from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from labrig.protocol.model import Conflict, Model, NonNegativeMm, PositiveMm

Coordinate: TypeAlias = Annotated[float, Field(ge=-10_000, le=10_000)]
PointMm: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
Direction3: TypeAlias = tuple[float, float, float]
Weight: TypeAlias = Annotated[float, Field(ge=0, le=1000)]


class ScenarioNeedle(Model):
    """The needle that is planned for: its numbers, or `design_file` instead of them."""

    radius_mm: PositiveMm = Field(description="Radius of the arcs that the needle follows [mm].")
    diameter_mm: float = Field(gt=0, le=10, description="Outer diameter of the needle [mm].")
    radius_low_mm: PositiveMm | None = Field(
        None, description="Smallest radius that the needle may have, beside radius_high_mm [mm]."
    )
    radius_high_mm: PositiveMm | None = Field(
        None, description="Largest radius that the needle may have, beside radius_low_mm [mm]."
    )

    def conflicts(self) -> Iterator[Conflict]:
        """Yield half a tolerance, or a radius outside of its tolerance."""
        low_mm, high_mm = self.radius_low_mm, self.radius_high_mm
        if low_mm is None and high_mm is None:
            return
        if low_mm is None or high_mm is None:
            missing = "radius_low_mm" if low_mm is None else "radius_high_mm"
            yield Conflict(missing, f"{missing} is null, and the other end is a number", "give both or none")
        elif not low_mm <= self.radius_mm <= high_mm:
            message = (
                f"radius_mm is {self.radius_mm:g}, must be within its tolerance, {low_mm:g} to {high_mm:g}"
            )
            yield Conflict("radius_mm", message)

    @property
    def radius_range_mm(self) -> tuple[float, float] | None:
        """The tolerance of the radius, low to high; None where none is stated."""
        if self.radius_low_mm is None or self.radius_high_mm is None:
            return None
        return self.radius_low_mm, self.radius_high_mm


class ScenarioStart(Model):
    """The pose of the needle's tip."""

    position_mm: PointMm = Field((0.0, 0.0, 0.0), description="Where the tip is: x, y, z [mm].")
    rotation: tuple[Direction3, Direction3, Direction3] = Field(
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        description="Rotation matrix by rows, from the tip's frame to the world; z along the needle.",
    )


class ScenarioTarget(Model):
    """The point to reach."""

    position_mm: PointMm = Field(description="Where the target is: x, y, z [mm].")
    tolerance_mm: PositiveMm = Field(2.0, description="How far from the target the path may end [mm].")


class ScenarioObstacle(Model):
    """A sphere that the needle keeps off."""

    position_mm: PointMm = Field(description="Centre of the sphere: x, y, z [mm].")
    radius_mm: PositiveMm = Field(description="Radius of the sphere [mm].")


class ScenarioWeights(Model):
    """What makes one feasible path better than another; the smallest sum wins."""

    length_per_mm: Weight = Field(1.0, description="Cost of a millimetre of path.")
    turn: Weight = Field(4.0, description="Cost of an arc.")
    target_error_per_mm: Weight = Field(10.0, description="Cost of each millimetre beside the target.")
    clearance_per_mm: Weight = Field(
        6.0, description="Cost of each millimetre missing to a comfortable clearance."
    )
    comfortable_clearance_mm: NonNegativeMm = Field(
        3.0, description="Clearance beyond which more is no better [mm]."
    )
    curvature_per_mm: Weight = Field(
        4.0,
        description="Cost of each millimetre by which the worst radius of its tolerance moves the tip; without a "
        "tolerance, a radius one per cent larger.",
    )


class Scenario(Model):
    """A planning problem in a file, YAML or JSON."""

    needle: ScenarioNeedle
    start: ScenarioStart = ScenarioStart()
    target: ScenarioTarget
    obstacles: tuple[ScenarioObstacle, ...] = Field(
        (), max_length=100, description="Spheres to keep off, any number up to a hundred."
    )
    planar: bool = Field(
        default=False, description="Stay in the y-z plane of the start; rolls are 0 and pi then."
    )
    clearance_mm: NonNegativeMm = Field(
        0.6, description="Asked for, from the needle's surface to an obstacle's [mm]."
    )
    max_arcs: int = Field(6, ge=1, le=12, description="Most arcs of a path.")
    max_length_mm: PositiveMm = Field(150.0, description="Longest path [mm].")
    method: Literal["best", "paper"] = Field(
        "best", description="The default planner, or the paper's for comparison."
    )
    weights: ScenarioWeights = ScenarioWeights()
