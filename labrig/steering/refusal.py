"""Why there is no path: proven by geometry before any search, otherwise what a search without success has seen."""

import math
from typing import Literal

import numpy as np

from labrig.needle.kinematics import FloatArray
from labrig.steering.parameters import PlanMethod
from labrig.steering.problem import PlanProblem, Surroundings
from labrig.text import format_count

RefusalCause = Literal["turning_circle", "out_of_reach", "blocked", "not_found"]
"""The target is inside a turning circle, or out of reach otherwise; an end is blocked; a search found nothing."""

Refusal = tuple[str, RefusalCause, str]
"""Why there is no path, in words and by its name, and what would give one."""

_AWAY = "move the target"
_EITHER = f"{_AWAY} or an obstacle"
_ACTS = "where a turn of the bevel acts"


def find_refusal(around: Surroundings) -> Refusal | None:
    """Return why no path can reach the target, or None.

    A path points forwards everywhere, so its depth never decreases, and it never bends more tightly than the needle's
    circle. So points inside the turning circles at the start, and beside them, are out of reach.
    """
    distance = float(np.linalg.norm(around.target_mm))
    if distance <= around.problem.tolerance_mm:
        return _explain_blocked_ends(around)
    return _explain_out_of_reach(around, distance) or _explain_blocked_ends(around)


def _explain_out_of_reach(around: Surroundings, distance: float) -> Refusal | None:
    problem = around.problem
    x, y, z = around.target_mm.tolist()
    tolerance_mm, radius_mm = problem.tolerance_mm, problem.radius_mm
    lateral = abs(y) if problem.planar else math.hypot(x, y)
    if problem.planar and abs(x) > tolerance_mm:
        far = f"the target lies {abs(x):.1f} mm outside of the steering plane, more than {tolerance_mm:g} mm"
        return far, "out_of_reach", _AWAY
    if z < -tolerance_mm:
        return f"the target lies {-z:.1f} mm behind the needle's tip", "out_of_reach", _AWAY
    inside_mm = radius_mm - math.hypot(lateral - radius_mm, z)
    if inside_mm > tolerance_mm:
        circle = f"the turning circle of {radius_mm:.1f} mm radius, from {_ACTS}"
        by = f"by {inside_mm - tolerance_mm:.1f} mm or more, away from the middle of the circle"
        return f"the target lies {inside_mm:.1f} mm inside {circle}", "turning_circle", f"{_AWAY} {by}"
    if lateral - tolerance_mm > _widest_lateral_mm(z + tolerance_mm, radius_mm):
        beside = f"the target lies {lateral:.1f} mm beside the needle"
        return f"{beside}: the path would turn by more than 90 degrees", "out_of_reach", _AWAY
    if distance - tolerance_mm > problem.max_length_mm:
        far = f"the target is {distance:.1f} mm from {_ACTS}, and {problem.max_length_mm:g} mm are left"
        return f"too long: {far}", "out_of_reach", f"{_AWAY} or allow a longer path (max_length_mm)"
    return None


def _widest_lateral_mm(depth_mm: float, radius_mm: float) -> float:
    """Return how far aside the needle can be at a depth; unlimited at depths beyond its radius."""
    if depth_mm >= radius_mm:
        return math.inf
    return radius_mm - math.sqrt(radius_mm**2 - max(depth_mm, 0.0) ** 2)


def _explain_blocked_ends(around: Surroundings) -> Refusal | None:
    """Return which obstacle is too near the start, or leaves no room within the target's tolerance."""
    apart = np.linalg.norm(around.centres_mm, axis=1)
    for k in np.flatnonzero(apart < around.keep_off_mm):
        return f"the start is blocked {_describe_gap(around, int(k), apart)}", "blocked", _EITHER
    apart = np.linalg.norm(around.centres_mm - around.target_mm, axis=1)
    for k in np.flatnonzero(apart + around.problem.tolerance_mm < around.keep_off_mm):
        return f"the target is blocked {_describe_gap(around, int(k), apart)}", "blocked", _EITHER
    return None


def _describe_gap(around: Surroundings, k: int, apart: FloatArray) -> str:
    gap_mm = apart[k] - around.needle_and_obstacle_mm[k]
    wanted_mm = around.problem.clearance_mm + around.problem.margins_mm[k]
    return f"by obstacle {k + 1}: {gap_mm:.2f} mm of clearance, {wanted_mm:.2f} mm asked for"


def explain_failure(problem: PlanProblem, method: PlanMethod) -> Refusal:
    """Return what is known after a search that found no path: it proves nothing, as it tries some paths only."""
    arcs = format_count(problem.max_arcs, "arc")
    found = f"no path found with up to {arcs} and {problem.max_length_mm:.1f} mm"
    hint = f"{_EITHER}, or allow more arcs or a longer path"
    return "resolved motion rate found no path" if method == "paper" else found, "not_found", hint
