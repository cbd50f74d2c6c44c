"""The scenario of `labrig plan`: a needle, a target and obstacles, without any rig."""

from pathlib import Path
from typing import TypeAlias

import numpy as np
from pydantic import Field

from labrig.protocol.model import Model, NonNegativeMm, PointMm, PositiveMm
from labrig.protocol.yaml_file import load_yaml_model
from labrig.steering.parameters import PlanMethod, PlanWeights
from labrig.steering.problem import Obstacle, PlanProblem

_OTHERS = {"experiment": ("this is a protocol, expected a scenario", "see: labrig manual steer-to-target")}
Direction3: TypeAlias = tuple[float, float, float]


class ScenarioNeedle(Model):
    """The needle of the plan."""

    radius_mm: PositiveMm
    """Radius of the arcs that the needle follows [mm]."""
    diameter_mm: float = Field(gt=0, le=10)
    """Outer diameter of the needle [mm]."""
    radius_range_mm: tuple[PositiveMm, PositiveMm] | None = None
    """Smallest and largest radius within the tolerances of its design; null: not stated [mm]."""


class ScenarioStart(Model):
    """The pose of the needle's tip."""

    position_mm: PointMm = (0.0, 0.0, 0.0)
    """Where the tip is: x, y, z [mm]."""
    rotation: tuple[Direction3, Direction3, Direction3] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """Rotation matrix by rows, from the tip's frame to the world; z along the needle."""


class ScenarioTarget(Model):
    """The point to reach."""

    position_mm: PointMm
    """Where the target is: x, y, z [mm]."""
    tolerance_mm: PositiveMm = 2.0
    """How far from the target the path may end [mm]."""


class ScenarioObstacle(Model):
    """A sphere that the needle avoids."""

    position_mm: PointMm
    """Centre of the sphere: x, y, z [mm]."""
    radius_mm: PositiveMm
    """Radius of the sphere [mm]."""


class Scenario(Model):
    """A planning problem in a file, YAML or JSON."""

    needle: ScenarioNeedle
    start: ScenarioStart = ScenarioStart()
    target: ScenarioTarget
    obstacles: tuple[ScenarioObstacle, ...] = Field((), max_length=100)
    """Spheres to keep off, any number up to a hundred."""
    planar: bool = False
    """Stay in the y-z plane of the start; rolls are 0 and pi then."""
    clearance_mm: NonNegativeMm = 0.6
    """Asked for, from the needle's surface to an obstacle's [mm]."""
    max_arcs: int = Field(6, ge=1, le=12)
    """Most arcs of a path."""
    max_length_mm: PositiveMm = 150.0
    """Longest path [mm]."""
    method: PlanMethod = "best"
    """The default planner, or the paper's for comparison."""
    weights: PlanWeights = PlanWeights()


def load_scenario(path: Path | str) -> Scenario:
    """Return the scenario in a file, YAML or JSON.

    Raises
    ------
    FileFormatError
        With every problem of the file.
    """
    return load_yaml_model(path, Scenario, others=_OTHERS)


def make_problem(scenario: Scenario) -> PlanProblem:
    """Return the problem that a scenario states.

    Raises
    ------
    InputError
        When values that are valid alone contradict each other: a start or target inside an obstacle, no rotation.
    """
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = scenario.start.rotation, scenario.start.position_mm
    return PlanProblem(
        **vars(scenario.needle),
        **scenario.model_dump(include={"planar", "clearance_mm", "max_arcs", "max_length_mm"}),
        target_mm=scenario.target.position_mm,
        tolerance_mm=scenario.target.tolerance_mm,
        obstacles=tuple(Obstacle(**vars(obstacle)) for obstacle in scenario.obstacles),
        start=start,
        weights=scenario.weights,
    )
