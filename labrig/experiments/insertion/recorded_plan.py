"""The plans of an insertion from its record."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from labrig.experiments.insertion.events import PathSought
from labrig.record.reader import Run
from labrig.steering.planner import Plan, sample_path
from labrig.steering.problem import PlanProblem


def sample_plan(event: PathSought) -> NDArray[np.float64]:
    """Return the points (N, 2) of a recorded plan, (y, z) [mm]; none if there was no path."""
    bent = [arc for arc in event.arcs if arc.angle_rad > 0.0]
    if not event.found or not bent:
        return np.empty((0, 2))
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = event.start.rotation, event.start.position_mm
    radius_mm = bent[0].length_mm / bent[0].angle_rad
    # Where the arcs lie depends on their start and radius alone.
    problem = PlanProblem(target_mm=event.start.position_mm, start=start, radius_mm=radius_mm)
    return sample_path(problem, Plan(found=True, reason=None, arcs=event.arcs))[:, 1:]


def read_plans(run: Run) -> Mapping[int, Sequence[PathSought]]:
    """Return the plans of each trial, in the order of time."""
    plans: dict[int, list[PathSought]] = {}
    for event in run.read_events(PathSought):
        plans.setdefault(event.trial, []).append(event)
    return plans
