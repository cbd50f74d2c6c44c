"""Mend paths that reach the target but come too near to obstacles, or the reverse: both are demanded at once.

Each step is one of Gauss-Newton, damped: the tip goes towards the target, and the place of the path that is nearest to
an obstacle goes away from it by what its clearance lacks. In a narrow tunnel the walls on both sides push. A path that
is longer than allowed is shortened by the same step.
"""

import numpy as np

from labrig.needle.kinematics import ArcFrames, FloatArray, path_frames, place_jacobians
from labrig.steering.clearance import find_nearest_places
from labrig.steering.problem import Surroundings

# The clearance is demanded with this much more [mm], as a step leaves a part of what it lacked.
_SPARE_MM = 0.02
_OBSTACLES = 16
_DAMPING_MM2 = 0.3
_LARGEST_STEP_RAD = 0.3
_CONVERGED_RAD = 1e-6


def mend_paths(psi: FloatArray, around: Surroundings, steps: int) -> FloatArray:
    """Return paths (M, n, 2) after at most so many steps towards the target and off the obstacles; some may fail."""
    radius_mm, planar = around.problem.radius_mm, around.problem.planar
    for _ in range(steps):
        frames = path_frames(psi, radius_mm)
        lacks, jacobian_of_tip, slopes = _find_lacks(psi, frames, around)
        misses = around.target_mm - frames.positions_mm[:, -1]
        excess, shortening = _find_excess(psi, around)
        jacobian = np.concatenate((jacobian_of_tip, slopes, shortening), axis=1)
        wanted = np.concatenate((misses, lacks, excess), axis=1)
        if planar:  # the rolls are fixed: only the columns of theta are variables
            jacobian = jacobian[..., ::2]
        across = np.swapaxes(jacobian, -1, -2)
        normal = across @ jacobian + _DAMPING_MM2 * np.eye(jacobian.shape[-1])
        step = np.linalg.solve(normal, across @ wanted[..., None])[..., 0]
        step = np.clip(step, -_LARGEST_STEP_RAD, _LARGEST_STEP_RAD)
        changes = np.stack((step, np.zeros_like(step)), axis=-1) if planar else step.reshape(psi.shape)
        psi = psi + changes
        psi[..., 0] = np.clip(psi[..., 0], 0.0, np.pi)
        if np.abs(step).max(initial=0.0) < _CONVERGED_RAD:
            break
    return psi


def rank_by_lack(psi: FloatArray, around: Surroundings, kept: int) -> FloatArray:
    """Return the paths with the least sum of miss, excess of length and missing clearance, least first."""
    frames = path_frames(psi, around.problem.radius_mm)
    misses = np.linalg.norm(around.target_mm - frames.positions_mm[:, -1], axis=-1)
    near = find_nearest_places(psi, around.problem.radius_mm, around.centres_mm, frames)
    lacks = np.maximum(around.keep_off_mm - near.distances_mm, 0.0).sum(axis=-1)
    excess, _ = _find_excess(psi, around)
    return psi[np.argsort(misses + lacks + excess[:, 0], kind="stable")[:kept]]


def _find_lacks(
    psi: FloatArray, frames: ArcFrames, around: Surroundings
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what the clearance of each path lacks at its nearest obstacles, (M, k) [mm], and the slopes by psi.

    The slope of the path's tip is (M, 3, 2n), that of the clearance (M, k, 2n).
    """
    near = find_nearest_places(psi, around.problem.radius_mm, around.centres_mm, frames)
    lacks = around.keep_off_mm + _SPARE_MM - near.distances_mm
    worst = np.argsort(-lacks, axis=-1, kind="stable")[:, :_OBSTACLES]
    paths = np.arange(len(psi))[:, None]
    places, lacks = near.places_mm[paths, worst], lacks[paths, worst]
    away = places - around.centres_mm[worst]
    away /= np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
    # The tip is a place on the last arc that moves with its angle.
    places = np.concatenate((frames.positions_mm[:, -1:], places), axis=1)
    arcs = np.concatenate((np.full_like(paths, psi.shape[1] - 1), near.arcs[paths, worst]), axis=1)
    jacobians = place_jacobians(
        around.problem.radius_mm, frames, places, arcs, np.arange(places.shape[1]) == 0
    )
    slopes = (away[..., None, :] @ jacobians[:, 1:])[..., 0, :]
    touching = lacks > 0.0
    return np.where(touching, lacks, 0.0), jacobians[:, 0], np.where(touching[..., None], slopes, 0.0)


def _find_excess(psi: FloatArray, around: Surroundings) -> tuple[FloatArray, FloatArray]:
    """Return by how much each path is too long, (M, 1) [mm], and the slope of its shortening by psi, (M, 1, 2n)."""
    radius_mm = around.problem.radius_mm
    excess = radius_mm * psi[..., 0].sum(axis=-1) - around.problem.max_length_mm
    slopes = np.zeros((len(psi), 1, psi[0].size))
    slopes[excess > 0.0, 0, ::2] = -radius_mm
    return np.maximum(excess, 0.0)[:, None], slopes
