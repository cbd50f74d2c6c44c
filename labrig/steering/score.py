"""The best feasible path among many candidates."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labrig.needle.kinematics import ArcFrames, FloatArray, path_frames
from labrig.steering.clearance import NearestPlaces, arc_distances, find_nearest_places
from labrig.steering.problem import Surroundings

_RADIUS_ERROR = 0.01
ROUNDING = 1e-9
"""Costs, lengths [mm] and angles [rad] that differ by less differ by rounding."""
_PIECES = 3
# Cost of each millimetre by which the tip would miss after a cavity, averaged over its place on the path.
_CAVITY_PER_MM = 20.0


def pick_best_feasible(families: Sequence[FloatArray], around: Surroundings) -> FloatArray | None:
    """Return the path (n, 2) of least cost among those of families (M, n, 2) that are feasible, or None.

    A feasible path reaches the target, keeps off the obstacles, and stays within the limits; `PlanWeights` holds the
    costs. Empty arcs at the end of the path are dropped.
    """
    psi = _join(families)
    frames = path_frames(psi, around.problem.radius_mm)
    within = np.flatnonzero(_are_within_caps(psi, frames, around))
    psi, frames = psi[within], frames.take(within)
    near = find_nearest_places(psi, around.problem.radius_mm, around.centres_mm, frames)
    feasible = np.flatnonzero(np.all(near.distances_mm >= around.keep_off_mm - ROUNDING, axis=1))
    if not len(feasible):
        return None
    psi = psi[feasible]
    best = find_cheapest(_cost_paths(psi, frames.take(feasible), near.take(feasible), around))
    return np.asarray(psi[best, : np.flatnonzero(psi[best, :, 0] > ROUNDING).max(initial=-1) + 1])


def find_cheapest(costs: FloatArray) -> int:
    """Return the index of the least cost; the first, if others differ from it by rounding alone.

    Mirrored paths cost the same, and which of them rounds to less is a matter of the processor.
    """
    return int(np.argmax(costs <= costs.min() + ROUNDING))


def _join(families: Sequence[FloatArray]) -> FloatArray:
    """Return the paths of all families, with empty arcs at their ends so that all have as many."""
    psi = np.zeros((sum(map(len, families)), max(family.shape[1] for family in families), 2))
    first = 0
    for family in families:
        psi[first : first + len(family), : family.shape[1]] = family
        first += len(family)
    return psi


def _are_within_caps(psi: FloatArray, frames: ArcFrames, around: Surroundings) -> NDArray[np.bool_]:
    problem, angles = around.problem, psi[..., 0]
    good = np.linalg.norm(frames.positions_mm[:, -1] - around.target_mm, axis=-1) <= problem.tolerance_mm
    # An arc whose ends point forwards points forwards everywhere.
    good &= frames.rotations[:, :, 2, 2].min(axis=-1) >= -ROUNDING
    if problem.axis is not None:
        axis = np.asarray(problem.axis) @ np.asarray(problem.start)[:3, :3]
        off = frames.rotations[:, 1:, :, 2] @ axis
        good &= off.min(axis=-1) >= np.cos(problem.max_off_axis_rad) - ROUNDING
    good &= (angles.min(axis=-1) >= 0) & (angles.max(axis=-1) <= np.pi)
    good &= problem.radius_mm * angles.sum(axis=-1) <= problem.max_length_mm + ROUNDING
    return np.asarray(good)


def _cost_paths(psi: FloatArray, frames: ArcFrames, near: NearestPlaces, around: Surroundings) -> FloatArray:
    weights, radius_mm, angles = around.problem.weights, around.problem.radius_mm, psi[..., 0]
    tips = frames.positions_mm[:, -1]
    cost = weights.length_per_mm * radius_mm * angles.sum(axis=-1)
    cost += weights.turn * (angles > ROUNDING).sum(axis=-1)
    cost += weights.target_error_per_mm * np.linalg.norm(tips - around.target_mm, axis=-1)
    gaps_mm = (near.distances_mm - around.needle_and_obstacle_mm).min(axis=-1, initial=np.inf)
    cost += weights.clearance_per_mm * np.maximum(weights.comfortable_clearance_mm - gaps_mm, 0.0)
    others_mm = around.problem.radius_range_mm or (radius_mm * (1 + _RADIUS_ERROR),)
    moved = [
        path_frames(*_scale_to_radius(psi, radius_mm, other_mm)).positions_mm[:, -1] - tips
        for other_mm in others_mm
    ]
    cost += weights.curvature_per_mm * np.linalg.norm(moved, axis=-1).max(axis=0)
    if around.problem.cavity_mm > 0.0:
        cost += _CAVITY_PER_MM * _miss_after_cavity(psi, around)
    if around.problem.planar and weights.room_per_mm > 0.0:
        rooms = find_least_rooms(near, around)
        cost += weights.room_per_mm * np.maximum(weights.comfortable_room_mm - rooms, 0.0)
    return np.asarray(cost)


def _miss_after_cavity(psi: FloatArray, around: Surroundings) -> FloatArray:
    """Return the miss of each path after a cavity, averaged over the cavity's place, (M,) [mm].

    Beyond the cavity the needle turns towards the target as tightly as it can. If the target then lies inside the
    turning circle, the miss is its depth in that circle. If the cavity reaches beyond the target, the miss is the
    target's distance from the straight line. An arc that ends nearest to the target has it beside its tip: ahead, as
    far as rounding tells.
    """
    radius_mm = around.problem.radius_mm
    pieces = np.zeros((*psi.shape[:2], _PIECES, 2))
    pieces[..., 0], pieces[..., 0, 1] = psi[..., :1] / _PIECES, psi[..., 1]
    pieces = pieces.reshape(len(psi), -1, 2)
    frames = path_frames(pieces, radius_mm)
    to_target = around.target_mm - frames.positions_mm[:, 1:]
    ahead = np.einsum("mka,mka->mk", to_target, frames.rotations[:, 1:, :, 2])
    beside = np.sqrt(np.maximum(np.einsum("mka,mka->mk", to_target, to_target) - ahead**2, 0.0))
    left = ahead - around.problem.cavity_mm
    misses = np.where(
        left > 0.0, radius_mm - np.hypot(beside - radius_mm, left), np.where(ahead > -ROUNDING, beside, 0.0)
    )
    lengths = pieces[..., 0] / np.maximum(pieces[..., 0].sum(axis=-1, keepdims=True), ROUNDING)
    return np.asarray((np.maximum(misses, 0.0) * lengths).sum(axis=-1))


def find_least_rooms(near: NearestPlaces, around: Surroundings) -> FloatArray:
    """Return the least room of each path in the plane, (M,) [mm]; infinite without an obstacle ahead.

    Room to turn aside is the clearance that a needle would have if it bent away from an obstacle from here on. It
    cannot bend more tightly than its radius: a path may pass with clearance and still have little room, if it bends
    away all the way there. A tip that strays towards the obstacle can then no longer pass it on that side. Room is
    largest at the start, and a needle that first bends one way and then the other uses it up on both sides.

    Each obstacle that cuts the plane counts on the side on which the path passes it. The room is negative where even
    the tightest bend would touch.
    """
    radius_mm, touching_mm = around.problem.radius_mm, around.needle_and_obstacle_mm
    out, across, along = around.centres_mm.T
    ahead = (along > 0.0) & (np.abs(out) < touching_mm)
    out, across, along, touching_mm = out[ahead], across[ahead], along[ahead], touching_mm[ahead]
    sides = np.where(near.places_mm[:, ahead, 1] > across, 1.0, -1.0)
    from_middle = np.hypot(along, radius_mm - sides * across)
    rooms = from_middle - radius_mm - np.sqrt(touching_mm**2 - out**2)
    return np.asarray(rooms.min(axis=-1, initial=np.inf))


def _scale_to_radius(psi: FloatArray, radius_mm: float, other_mm: float) -> tuple[FloatArray, float]:
    """Return the paths of a needle of another radius with the same inserted lengths and rolls."""
    return psi * np.array([radius_mm / other_mm, 1.0]), other_mm


def find_worst_miss_and_gap(psi: FloatArray, around: Surroundings) -> tuple[float, float | None]:
    """Return the largest miss and the smallest gap [mm] of a path (n, 2) that is followed open loop.

    They are the worst at both ends of the radius's tolerance. The gap is None without obstacles.
    """
    problem = around.problem
    ends_mm = problem.radius_range_mm or (problem.radius_mm,)
    ways = [_scale_to_radius(psi, problem.radius_mm, end_mm) for end_mm in ends_mm]
    misses = [np.linalg.norm(path_frames(*way).positions_mm[-1] - around.target_mm) for way in ways]
    if not len(around.centres_mm) or not len(psi):
        return float(max(misses)), None
    gaps = [
        arc_distances(*way, around.centres_mm).min(axis=-2) - around.needle_and_obstacle_mm for way in ways
    ]
    return float(max(misses)), float(np.min(gaps))
