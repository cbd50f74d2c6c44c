"""Why there is no path: said before any search where geometry alone decides, and after it where the search does."""

import math

import numpy as np
from numpy.typing import NDArray

from labrig.steering.planar import Field, close, grow, hits, root
from labrig.steering.problem import Surroundings

FloatArray = NDArray[np.float64]

_SAMPLES = (40, 16)


def refusal_at_once(around: Surroundings) -> str | None:
    """Return why the target cannot be reached, whatever the path, or None.

    The path points forwards everywhere, so its depth never falls, and no path bends faster than the needle's
    circle: what is beside the circles in which the needle could turn at once stays out of reach.
    """
    distance = float(np.linalg.norm(around.target_mm))
    if distance <= around.problem.tolerance_mm:
        return _blocked_ends(around)
    return _out_of_reach(around, distance) or _blocked_ends(around)


def _out_of_reach(around: Surroundings, distance: float) -> str | None:
    problem = around.problem
    x, y, z = around.target_mm.tolist()
    tolerance_mm, radius_mm = problem.tolerance_mm, problem.radius_mm
    lateral = abs(y) if problem.planar else math.hypot(x, y)
    if problem.planar and abs(x) > tolerance_mm:
        return f"the target lies {abs(x):.1f} mm outside of the steering plane, more than {tolerance_mm:g} mm"
    if z < -tolerance_mm:
        return f"the target lies {-z:.1f} mm behind the needle's tip"
    if math.hypot(lateral - radius_mm, z) < radius_mm - tolerance_mm:
        return (
            f"the target lies inside the turning circles: {lateral:.1f} mm beside the needle and {z:.1f} mm "
            f"ahead, with a radius of {radius_mm:g} mm"
        )
    if lateral - tolerance_mm > _widest(z + tolerance_mm, radius_mm):
        return (
            f"the target lies {lateral:.1f} mm beside the needle: the path would turn by more than 90 degrees"
        )
    if distance - tolerance_mm > problem.max_length_mm:
        return f"too long: the target is {distance:.1f} mm away, and {problem.max_length_mm:g} mm are allowed"
    return None


def _widest(depth_mm: float, radius_mm: float) -> float:
    """Return how far to the side the needle can be at a depth; beyond its radius, without limit."""
    if depth_mm >= radius_mm:
        return math.inf
    return radius_mm - math.sqrt(radius_mm**2 - max(depth_mm, 0.0) ** 2)


def _blocked_ends(around: Surroundings) -> str | None:
    """Return which obstacle is too near to the start, or leaves no room within the target's tolerance."""
    apart = np.linalg.norm(around.centres_mm, axis=1)
    for k in np.flatnonzero(apart < around.keep_off_mm):
        gap = apart[k] - around.needle_and_obstacle_mm[k]
        return f"the start is blocked by obstacle {k + 1}: {gap:.2f} mm of clearance, {_wanted(around)} asked for"
    apart = np.linalg.norm(around.centres_mm - around.target_mm, axis=1)
    for k in np.flatnonzero(apart + around.problem.tolerance_mm < around.keep_off_mm):
        gap = apart[k] - around.needle_and_obstacle_mm[k]
        return f"the target is blocked by obstacle {k + 1}: {gap:.2f} mm of clearance, {_wanted(around)} asked for"
    return None


def _wanted(around: Surroundings) -> str:
    return f"{around.problem.clearance_mm + around.problem.margin_mm:.2f} mm"


def refusal_after_search(around: Surroundings) -> str:
    """Return what stands in the way of a target that geometry allows and that the search did not reach."""
    problem = around.problem
    if not problem.planar:
        return f"no path found with up to {problem.max_arcs} arcs and {problem.max_length_mm:g} mm{_suspects(around)}"
    field = Field.of(around)
    target = complex(around.target_mm[2], around.target_mm[1])
    counts, shortest_mm = _paths_if_nothing_stood_there(field, target, problem.max_arcs)
    if math.isinf(shortest_mm):
        return f"no path of {problem.max_arcs} arcs leads to the target, obstacles or not"
    if shortest_mm > problem.max_length_mm:
        return f"too long: the shortest path is {shortest_mm:.1f} mm, and {problem.max_length_mm:g} mm are allowed"
    if not len(counts):
        return f"no path of {problem.max_arcs} arcs leads to the target without pointing too far aside"
    worst = int(np.argmax(counts))
    named = np.flatnonzero(field_order(around))[worst] + 1
    return f"blocked by obstacle {named}: it cuts {100 * counts[worst]:.0f} % of the paths that lead to the target"


def field_order(around: Surroundings) -> NDArray[np.bool_]:
    """Return which obstacles are discs of the steering plane; discs keep the obstacles' order."""
    return np.asarray(around.keep_off_mm**2 - around.centres_mm[:, 0] ** 2 > 0)


def _paths_if_nothing_stood_there(field: Field, target: complex, max_arcs: int) -> tuple[FloatArray, float]:
    """Return the share of paths of up to four arcs that each disc cuts, and the length of the shortest path."""
    empty = field.without_limits()
    tips, cut, total, shortest = root(), np.zeros(len(field.discs)), 0, math.inf
    for level in range(min(max_arcs - 1, 3)):
        if level:
            tips = grow(tips, empty, _SAMPLES[level - 1])
        closures = close(tips, empty, target)
        if not len(closures.parent):
            continue
        lengths = tips.angles_rad[closures.parent].sum(axis=1) + closures.angles_rad.sum(axis=1)
        shortest = min(shortest, field.radius_mm * float(lengths.min()))
        cut += hits(closures, tips, field, target).sum(axis=0)
        total += len(closures.parent)
    return cut / max(total, 1), shortest


def _suspects(around: Surroundings) -> str:
    """Return the obstacle that the straight line to the target meets first, as a guess in words."""
    along = np.clip(around.centres_mm @ around.target_mm / np.sum(around.target_mm**2), 0, 1)
    apart = np.linalg.norm(around.centres_mm - along[:, None] * around.target_mm, axis=1)
    near = np.flatnonzero(apart < around.keep_off_mm)
    return f"; blocked by obstacle {near[np.argmin(along[near])] + 1}" if near.size else ""
