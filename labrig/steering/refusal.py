"""Why there is no path: proven by geometry before any search, otherwise what a search without success has seen."""

import math

import numpy as np

from labrig.needle.kinematics import FloatArray
from labrig.steering.clearance import path_distances
from labrig.steering.planar import Field, close_paths, grow_tips, join_paths, start_tree, target_in_plane
from labrig.steering.problem import Surroundings
from labrig.text import format_count

_SAMPLES = (40, 16)
_MEASURED_ARCS, _MEASURED = 4, 300


def find_refusal(around: Surroundings) -> str | None:
    """Return why no path can reach the target, or None.

    A path points forwards everywhere, so its depth never decreases, and it never bends more tightly than the needle's
    circle. So points inside the turning circles at the start, and beside them, are out of reach.
    """
    distance = float(np.linalg.norm(around.target_mm))
    if distance <= around.problem.tolerance_mm:
        return _explain_blocked_ends(around)
    return _explain_out_of_reach(around, distance) or _explain_blocked_ends(around)


def _explain_out_of_reach(around: Surroundings, distance: float) -> str | None:
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
    if lateral - tolerance_mm > _widest_lateral_mm(z + tolerance_mm, radius_mm):
        return (
            f"the target lies {lateral:.1f} mm beside the needle: the path would turn by more than 90 degrees"
        )
    if distance - tolerance_mm > problem.max_length_mm:
        return f"too long: the target is {distance:.1f} mm away, and {problem.max_length_mm:g} mm are allowed"
    return None


def _widest_lateral_mm(depth_mm: float, radius_mm: float) -> float:
    """Return how far aside the needle can be at a depth; unlimited at depths beyond its radius."""
    if depth_mm >= radius_mm:
        return math.inf
    return radius_mm - math.sqrt(radius_mm**2 - max(depth_mm, 0.0) ** 2)


def _explain_blocked_ends(around: Surroundings) -> str | None:
    """Return which obstacle is too near the start, or leaves no room within the target's tolerance."""
    apart = np.linalg.norm(around.centres_mm, axis=1)
    for k in np.flatnonzero(apart < around.keep_off_mm):
        return f"the start is blocked {_describe_gap(around, int(k), apart)}"
    apart = np.linalg.norm(around.centres_mm - around.target_mm, axis=1)
    for k in np.flatnonzero(apart + around.problem.tolerance_mm < around.keep_off_mm):
        return f"the target is blocked {_describe_gap(around, int(k), apart)}"
    return None


def _describe_gap(around: Surroundings, k: int, apart: FloatArray) -> str:
    gap_mm = apart[k] - around.needle_and_obstacle_mm[k]
    wanted_mm = around.problem.clearance_mm + around.problem.margins_mm[k]
    return f"by obstacle {k + 1}: {gap_mm:.2f} mm of clearance, {wanted_mm:.2f} mm asked for"


def explain_failure(around: Surroundings) -> str:
    """Return what is known after a search that found no path: it proves nothing, as it tries some paths only."""
    problem = around.problem
    asked = (
        f"no path found with up to {format_count(problem.max_arcs, 'arc')} and {problem.max_length_mm:g} mm"
    )
    if not problem.planar:
        return f"{asked}{_name_suspect(around)}"
    field = Field.from_surroundings(around)
    shares, shortest_mm = _measure_free_paths(field, around)
    arcs = format_count(min(problem.max_arcs, _MEASURED_ARCS), "arc")
    if math.isinf(shortest_mm):
        return f"{asked}, obstacles or not"
    if shortest_mm > problem.max_length_mm:
        return f"{asked}: too long, the shortest found with up to {arcs} and without obstacles has {shortest_mm:.1f} mm"
    if not shares.any():
        return f"{asked} without pointing too far aside"
    worst = int(np.argmax(shares))
    return f"{asked}: obstacle {worst + 1} cuts {100 * shares[worst]:.0f} % of those tried without obstacles"


def _measure_free_paths(field: Field, around: Surroundings) -> tuple[FloatArray, float]:
    """Return the share of paths of up to four arcs that each obstacle cuts, and the length of the shortest found."""
    empty, target, radius_mm = field.without_limits(), target_in_plane(around), field.radius_mm
    tips, cut, total, shortest = start_tree(), np.zeros(len(around.centres_mm)), 0, math.inf
    for level in range(min(around.problem.max_arcs, _MEASURED_ARCS) - 1):
        if level:
            tips = grow_tips(tips, empty, _SAMPLES[level - 1])
        closures = close_paths(tips, empty, target)
        if not len(closures.parent):
            continue
        psi = join_paths(tips, closures, np.arange(len(closures.parent)))
        shortest = min(shortest, radius_mm * float(psi[..., 0].sum(axis=1).min()))
        some = psi[:: len(psi) // _MEASURED + 1]
        cut += (path_distances(some, radius_mm, around.centres_mm) < around.keep_off_mm).sum(axis=0)
        total += len(some)
    return cut / max(total, 1), shortest


def _name_suspect(around: Surroundings) -> str:
    """Return as text the first obstacle on the straight line to the target; empty if it is free."""
    along = np.clip(around.centres_mm @ around.target_mm / np.sum(around.target_mm**2), 0, 1)
    apart = np.linalg.norm(around.centres_mm - along[:, None] * around.target_mm, axis=1)
    near = np.flatnonzero(apart < around.keep_off_mm)
    return (
        f"; obstacle {near[np.argmin(along[near])] + 1} lies on the straight line to the target"
        if near.size
        else ""
    )
