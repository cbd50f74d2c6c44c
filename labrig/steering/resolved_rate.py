"""The paper's planner: resolved motion rate with avoidance in the null space, arcs added as in figure 5.

For comparison, with the changes that make it work (errata and failure modes of the paper):

- (11), (13): target and obstacles are transformed into {1b}, with its position subtracted too.
- (13): a smooth ramp over the obstacle's radius, the needle's, and the clearance, pointing away from the centre.
- (14): damped least squares, as J J^T is singular at psi = 0 and always in the plane; the projector by SVD.
- (15): the own-arc block as corrected in `labrig.needle.control_jacobians`.
- Planar rule: delta_1 is 0 or pi and delta_i pi beyond; both signs and several starts run side by side, as psi = 0
  is a saddle. theta is clamped; interference is decided exactly, not at the control points.
"""

import numpy as np

from labrig.needle.kinematics import FloatArray, control_jacobians, control_points, path_frames, path_jacobian
from labrig.steering.problem import Surroundings
from labrig.steering.score import pick_best_feasible

_ITERATIONS = 150
_CHECK_EVERY = 10
_CONTROL_POINTS = 5
_TARGET_GAIN = 0.3
_AVOIDANCE_GAIN = 1.0
_RAMP_MM = 4.0
_DAMPING_MM2 = 1.0
_LARGEST_STEP_RAD = 0.2
_LARGEST_ANGLE_RAD = np.pi / 2


def search_by_resolved_rate(around: Surroundings) -> FloatArray | None:
    """Return the first feasible path (n, 2), with as few arcs as possible, or None."""
    for arcs in range(1, around.problem.max_arcs + 1):
        psi = _make_starts(arcs, around)
        for iteration in range(_ITERATIONS):
            psi = _step(psi, around)
            if iteration % _CHECK_EVERY == _CHECK_EVERY - 1:
                path = pick_best_feasible([psi], around)
                if path is not None:
                    return path
    return None


def _make_starts(arcs: int, around: Surroundings) -> FloatArray:
    """Return starts (S, n, 2): two first rolls (four with free rolls), each with short, equal and growing arcs."""
    first_rolls = np.arange(2) * np.pi if around.problem.planar else np.arange(4) * np.pi / 2
    shapes = np.stack((np.full(arcs, 1e-3), np.full(arcs, 0.4), np.linspace(0.1, 0.8, arcs)))
    psi = np.full((len(first_rolls), len(shapes), arcs, 2), np.pi)
    psi[..., 0] = shapes
    psi[..., 0, 1] = first_rolls[:, None]
    return psi.reshape(-1, arcs, 2)


def _step(psi: FloatArray, around: Surroundings) -> FloatArray:
    """Return the configurations after one step of equation (14)."""
    radius_mm, planar = around.problem.radius_mm, around.problem.planar
    frames = path_frames(psi, radius_mm)
    jacobian = path_jacobian(radius_mm, frames)
    pull = around.target_mm - frames.positions_mm[:, -1]
    push = _avoidance_step(psi, around)
    if planar:  # the rolls are fixed: only the columns of theta are variables
        jacobian, push = jacobian[..., ::2], push[..., ::2]
    step = _TARGET_GAIN * solve_damped(jacobian, pull)
    step += push - (np.linalg.pinv(jacobian, rcond=1e-6) @ (jacobian @ push[..., None]))[..., 0]
    step = np.clip(step, -_LARGEST_STEP_RAD, _LARGEST_STEP_RAD)
    moved = psi.copy()
    if planar:
        moved[..., 0] += step
    else:
        moved += step.reshape(psi.shape)
    moved[..., 0] = np.clip(moved[..., 0], 0.0, _LARGEST_ANGLE_RAD)
    return moved


def _avoidance_step(psi: FloatArray, around: Surroundings) -> FloatArray:
    """Return the sum over control points of equation (14) before its projection, (S, 2n)."""
    if not len(around.centres_mm):
        return np.zeros((len(psi), 2 * psi.shape[1]))
    away = control_points(psi, around.problem.radius_mm, _CONTROL_POINTS)[..., None, :] - around.centres_mm
    apart = np.linalg.norm(away, axis=-1)
    ramp = np.clip((around.keep_off_mm + _RAMP_MM - apart) / _RAMP_MM, 0.0, 2.0)
    velocity = np.sum((ramp / np.maximum(apart, 1e-9))[..., None] * away, axis=-2)
    jacobians = control_jacobians(psi, around.problem.radius_mm, _CONTROL_POINTS)
    return np.asarray(_AVOIDANCE_GAIN * solve_damped(jacobians, velocity).sum(axis=(1, 2)))


def solve_damped(jacobian: FloatArray, velocity: FloatArray, damping_mm2: float = _DAMPING_MM2) -> FloatArray:
    """Return J^T (J J^T + lambda^2 I)^-1 v for any number of Jacobians (..., 3, k)."""
    across = np.swapaxes(jacobian, -1, -2)
    normal = jacobian @ across + damping_mm2 * np.eye(3)
    return np.asarray((across @ np.linalg.solve(normal, velocity[..., None]))[..., 0])
