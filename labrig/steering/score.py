"""The best feasible path among many candidates."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.needle.kinematics import ArcFrames, FloatArray, path_frames
from labrig.steering.clearance import arc_distances, find_nearest_places
from labrig.steering.problem import Surroundings

_RADIUS_ERROR = 0.01
ROUNDING = 1e-9
"""Costs, lengths [mm] and angles [rad] that differ by less differ by rounding."""
_PIECES = 3
# So many paths are scored first; no other is that costs more before its room, cavities and radius are looked at.
_LIKELY = 8
# Cost of each millimetre by which the tip would miss after a cavity, averaged over its place on the path.
_CAVITY_PER_MM = 20.0


@dataclass(frozen=True, eq=False)
class ScoredPath:
    """A feasible path (n, 2) and its cost."""

    psi: FloatArray
    cost: float


def pick_best_feasible(psi: FloatArray, around: Surroundings) -> ScoredPath | None:
    """Return the path of least cost among those of paths (M, n, 2) that are feasible, or None.

    A feasible path reaches the target, keeps off the obstacles, and stays within the limits; `PlanWeights` holds the
    costs. Empty arcs at the end of the path are dropped.
    """
    frames = path_frames(psi, around.problem.radius_mm)
    kept = _find_within_caps(psi, frames, around)
    psi, frames = psi[kept], frames.take(kept)
    gaps = np.full(len(psi), np.inf)
    if len(around.centres_mm):
        apart = arc_distances(psi, around.problem.radius_mm, around.centres_mm, frames).min(axis=1)
        gaps = (apart - around.needle_and_obstacle_mm).min(axis=1)
        clear = np.flatnonzero(np.all(apart >= around.keep_off_mm - ROUNDING, axis=1))
        psi, gaps, frames = psi[clear], gaps[clear], frames.take(clear)
    if not len(psi):
        return None
    least, costs = _cost_lengths(psi, frames, gaps, around), np.full(len(psi), np.inf)
    likely = np.argsort(least, kind="stable")[:_LIKELY]
    costs[likely] = _path_costs(psi[likely], frames.take(likely), gaps[likely], around)
    others = np.flatnonzero((least <= costs.min() + ROUNDING) & np.isinf(costs))
    if len(others):
        costs[others] = _path_costs(psi[others], frames.take(others), gaps[others], around)
    best = find_cheapest(costs)
    last = np.flatnonzero(psi[best, :, 0] > ROUNDING).max(initial=-1)
    return ScoredPath(psi[best, : last + 1], float(costs[best]))


def find_cheapest(costs: FloatArray) -> int:
    """Return the index of the least cost; the first, if others differ from it by rounding alone.

    Mirrored paths cost the same, and which of them rounds to less is a matter of the processor.
    """
    return int(np.argmax(costs <= costs.min() + ROUNDING))


def choose_cheaper(path: ScoredPath | None, other: ScoredPath | None) -> ScoredPath | None:
    """Return the path that costs less, the first if they differ by rounding alone; None counts as the most."""
    if path is None or other is None:
        return other if path is None else path
    return other if other.cost < path.cost - ROUNDING else path


def _find_within_caps(psi: FloatArray, frames: ArcFrames, around: Surroundings) -> NDArray[np.intp]:
    problem = around.problem
    errors = np.linalg.norm(frames.positions_mm[:, -1] - around.target_mm, axis=-1)
    # An arc whose ends point forwards points forwards everywhere.
    headings = frames.rotations[:, :, 2, 2].min(axis=-1)
    good = (errors <= problem.tolerance_mm) & (headings >= -ROUNDING)
    if problem.axis is not None:
        axis = np.asarray(problem.axis) @ np.asarray(problem.start)[:3, :3]
        off = frames.rotations[:, 1:, :, 2] @ axis
        good &= off.min(axis=-1) >= np.cos(problem.max_off_axis_rad) - ROUNDING
    good &= np.all((psi[..., 0] >= 0) & (psi[..., 0] <= np.pi), axis=-1)
    good &= problem.radius_mm * psi[..., 0].sum(axis=-1) <= problem.max_length_mm + ROUNDING
    return np.flatnonzero(good)


def _cost_lengths(
    psi: FloatArray, frames: ArcFrames, gaps_mm: FloatArray, around: Surroundings
) -> FloatArray:
    """Return the part of the costs (M,) that is quick to know; the others only add to it."""
    weights, radius_mm = around.problem.weights, around.problem.radius_mm
    cost = weights.length_per_mm * radius_mm * psi[..., 0].sum(axis=-1)
    cost += weights.turn * (psi[..., 0] > ROUNDING).sum(axis=-1)
    cost += weights.target_error_per_mm * np.linalg.norm(
        frames.positions_mm[:, -1] - around.target_mm, axis=-1
    )
    cost += weights.clearance_per_mm * np.maximum(weights.comfortable_clearance_mm - gaps_mm, 0.0)
    return np.asarray(cost)


def _path_costs(psi: FloatArray, frames: ArcFrames, gaps_mm: FloatArray, around: Surroundings) -> FloatArray:
    weights, radius_mm = around.problem.weights, around.problem.radius_mm
    tips = frames.positions_mm[:, -1]
    others_mm = around.problem.radius_range_mm or (radius_mm * (1 + _RADIUS_ERROR),)
    moved = [
        path_frames(*_scale_to_radius(psi, radius_mm, other_mm)).positions_mm[:, -1] - tips
        for other_mm in others_mm
    ]
    cost = _cost_lengths(psi, frames, gaps_mm, around)
    cost += weights.curvature_per_mm * np.linalg.norm(moved, axis=-1).max(axis=0)
    if around.problem.cavity_mm > 0.0:
        cost += _CAVITY_PER_MM * _miss_after_cavity(psi, around)
    if around.problem.planar and weights.room_per_mm > 0.0 and len(around.centres_mm):
        rooms = find_least_rooms(psi, frames, around)
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
    pieces = np.repeat(psi * np.array([1 / _PIECES, 1.0]), _PIECES, axis=1)
    pieces[:, np.arange(pieces.shape[1]) % _PIECES > 0, 1] = 0.0
    frames = path_frames(pieces, radius_mm)
    to_target = around.target_mm - frames.positions_mm
    ahead = np.einsum("mka,mka->mk", to_target, frames.rotations[..., 2])
    beside = np.sqrt(np.maximum(np.sum(to_target**2, axis=-1) - ahead**2, 0.0))
    left = ahead - around.problem.cavity_mm
    misses = np.where(
        left > 0.0, radius_mm - np.hypot(beside - radius_mm, left), np.where(ahead > -ROUNDING, beside, 0.0)
    )
    lengths = pieces[..., 0] / np.maximum(pieces[..., 0].sum(axis=-1, keepdims=True), ROUNDING)
    return np.asarray((np.maximum(misses[:, 1:], 0.0) * lengths).sum(axis=-1))


def find_least_rooms(psi: FloatArray, frames: ArcFrames, around: Surroundings) -> FloatArray:
    """Return the least room of each path (M, n, 2) in the plane, (M,) [mm]; infinite without an obstacle ahead.

    Room to turn aside is the clearance that a needle would have if it bent away from an obstacle from here on. It
    cannot bend more tightly than its radius: a path may pass with clearance and still have little room, if it bends
    away all the way there. A tip that strays towards the obstacle can then no longer pass it on that side. Room is
    largest at the start, and a needle that first bends one way and then the other uses it up on both sides.

    Each obstacle that cuts the plane counts on the side on which the path passes it. The room is negative where even
    the tightest bend would touch.
    """
    radius_mm, centres, touching_mm = (
        around.problem.radius_mm,
        around.centres_mm,
        around.needle_and_obstacle_mm,
    )
    ahead = (centres[:, 2] > 0.0) & (np.abs(centres[:, 0]) < touching_mm)
    if not ahead.any():
        return np.full(len(psi), np.inf)
    centres = centres[ahead]
    disc_radii_mm = np.sqrt(touching_mm[ahead] ** 2 - centres[:, 0] ** 2)
    places = find_nearest_places(psi, radius_mm, centres, frames).places_mm
    sides = np.where(places[..., 1] > centres[:, 1], 1.0, -1.0)
    from_middle = np.hypot(centres[:, 2], radius_mm - sides * centres[:, 1])
    return np.asarray((from_middle - radius_mm - disc_radii_mm).min(axis=-1))


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
