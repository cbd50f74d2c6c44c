"""A second filter to check the default one by: no filterpy, no formula of it, Jacobians by central differences."""

import numpy as np
from scipy.linalg import expm

from tests.steering.insertions import (
    PROCESS_SD_RAD,
    RADIUS_MM,
    SIGMA_MM,
    START_SD_RAD,
    Floats,
    SimulatedInsertion,
)


def hat(v: Floats) -> Floats:
    """Return the twist matrix (4, 4) of (rho, phi)."""
    return np.array([[0, -v[5], v[4], v[0]], [v[5], 0, -v[3], v[1]], [-v[4], v[3], 0, v[2]], [0, 0, 0, 0]])


def apply_error(pose: Floats, error: Floats) -> Floats:
    """Return the pose whose position and orientation are off by an error in its own frame."""
    return (
        pose
        @ np.vstack((np.hstack((np.eye(3), error[:3, None])), [0, 0, 0, 1]))
        @ expm(hat(np.r_[0, 0, 0, error[3:]]))
    )


def plain_ekf(insertion: SimulatedInsertion) -> tuple[Floats, Floats]:
    """Return poses (T + 1, 4, 4) and covariances (T + 1, 6, 6), in space, with the radius known."""
    pose = np.eye(4)
    pose[:3, 3] = insertion.positions_mm[0]
    p = np.diag([SIGMA_MM**2] * 3 + [START_SD_RAD**2] * 3)
    poses, covariances = [pose], [p]
    for seen, roll in zip(insertion.positions_mm[1:], insertion.roll_rad, strict=True):
        step = expm(hat(np.r_[0, 0, 0, 0, 0, roll])) @ expm(hat(np.r_[0, 0, 1.0, 1.0 / RADIUS_MM, 0, 0]))
        f = np.zeros((6, 6))
        for i in range(6):
            plus, minus = (
                np.linalg.inv(pose @ step) @ apply_error(pose, s * 1e-6 * np.eye(6)[i]) @ step
                for s in (1, -1)
            )
            change = (plus - minus) / 2e-6
            f[:, i] = (*change[:3, 3], change[2, 1], change[0, 2], change[1, 0])
        p = f @ p @ f.T + np.diag([0.0] * 3 + [PROCESS_SD_RAD**2] * 3)
        pose = pose @ step
        h = np.hstack((pose[:3, :3], np.zeros((3, 3))))
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + SIGMA_MM**2 * np.eye(3))
        pose, p = apply_error(pose, gain @ (seen - pose[:3, 3])), (np.eye(6) - gain @ h) @ p
        poses.append(pose)
        covariances.append(p)
    return np.stack(poses), np.stack(covariances)
