"""A scenario as the planner's problem; a file of its own, as it loads numpy and `labrig --help` must not."""

import numpy as np

from labrig.protocol.scenario import Scenario
from labrig.steering.problem import Obstacle, PlanProblem, PlanWeights


def problem_of(scenario: Scenario) -> PlanProblem:
    """Return the problem that a scenario states.

    Raises
    ------
    InputError
        Where values that are right alone make no problem: a start or target inside an obstacle, no rotation.
    """
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = scenario.start.rotation, scenario.start.position_mm
    return PlanProblem(
        target_mm=scenario.target.position_mm,
        obstacles=tuple(Obstacle(one.position_mm, one.radius_mm) for one in scenario.obstacles),
        start=start,
        radius_mm=scenario.needle.radius_mm,
        radius_range_mm=scenario.needle.radius_range_mm,
        diameter_mm=scenario.needle.diameter_mm,
        tolerance_mm=scenario.target.tolerance_mm,
        clearance_mm=scenario.clearance_mm,
        max_arcs=scenario.max_arcs,
        max_length_mm=scenario.max_length_mm,
        planar=scenario.planar,
        weights=PlanWeights(**scenario.weights.model_dump()),
    )
