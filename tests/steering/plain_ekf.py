"""A second filter to check the default one by: no filterpy, no formula of it, Jacobians by central differences."""

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from tests.steering.insertions import (
    PROCESS_SD_RAD,
    RADIUS_MM,
    SIGMA_MM,
    START_SD_RAD,
    Floats,
    SimulatedInsertion,
    insert,
)

_SMALL = 1e-6


def plain_ekf(
    insertion: SimulatedInsertion, planar: bool, radius_sd_mm: float = 0.0
) -> tuple[Floats, Floats, Floats]:
    """Return poses (T + 1, 4, 4), covariances (T + 1, 7, 7), and NIS and log-likelihood of each sighting (T, 2)."""
    seen, turning = ([1, 2], (1, 0, 0)) if planar else ([0, 1, 2], (1, 1, 1))
    pose, curvature = _rigid(np.zeros(3), insertion.positions_mm[0]), 1.0 / RADIUS_MM
    start = (
        np.isin(range(3), seen) * SIGMA_MM,
        np.multiply(turning, START_SD_RAD),
        radius_sd_mm * curvature**2,
    )
    p = np.diag(np.hstack(start) ** 2)
    poses, covariances, sightings = [pose], [p], []
    for position, roll in zip(insertion.positions_mm[1:], insertion.roll_rad, strict=True):
        f = _propagate(float(roll), round(curvature, 12))
        p = f @ p @ f.T + np.diag((0, 0, 0, *np.multiply(turning, PROCESS_SD_RAD**2), 0))
        pose = pose @ _step(roll, curvature)
        h = np.hstack((pose[:3, :3], np.zeros((3, 4))))[seen]
        innovation, spread = (position - pose[:3, 3])[seen], h @ p @ h.T + SIGMA_MM**2 * np.eye(len(seen))
        gain = p @ h.T @ np.linalg.inv(spread)
        pose, curvature = _apply(pose, gain @ innovation), curvature + (gain @ innovation)[6]
        p = (np.eye(7) - gain @ h) @ p
        poses.append(pose)
        covariances.append(p)
        likely = multivariate_normal(cov=spread).logpdf(innovation)
        sightings.append((innovation @ np.linalg.inv(spread) @ innovation, likely))
    return np.stack(poses), np.stack(covariances), np.array(sightings)


def bound_heading_rad2(seed: int, planar: bool, radius_sd_mm: float = 0.0) -> Floats:
    """Return the posterior Cramer-Rao bound of the heading's squared error after each step (T + 1,).

    By Tichavsky, Muravchik and Nehorai (1998). With the error in the tip's own frame a step leads to the same error
    whatever the pose, so that the recursion is that of the filter along a path without noise.
    """
    _, covariances, _ = plain_ekf(insert(seed, planar, noise=0.0), planar, radius_sd_mm)
    return np.asarray(covariances[:, 3, 3] + covariances[:, 4, 4])


def _rigid(turn: Floats, place: Floats) -> Floats:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), place
    return pose


def _apply(pose: Floats, error: Floats) -> Floats:
    """Return the pose whose position and orientation are off by an error in its own frame."""
    return np.asarray(pose @ _rigid(error[3:6], error[:3]))


def _step(roll_rad: float, curvature: float) -> Floats:
    """Return a roll about the needle's axis, and then a millimetre along an arc, (4, 4)."""
    aside, along = (np.cos(curvature) - 1.0) / curvature, np.sin(curvature) / curvature
    roll = _rigid(np.array((0.0, 0.0, roll_rad)), np.zeros(3))
    return np.asarray(roll @ _rigid(np.array((curvature, 0.0, 0.0)), np.array((0.0, aside, along))))


@lru_cache(64)
def _propagate(roll_rad: float, curvature: float) -> Floats:
    """Return how the errors after a step grow with each error before it, (7, 7)."""
    back, slopes = np.linalg.inv(_step(roll_rad, curvature)), np.eye(7)
    for number, axis in enumerate(_SMALL * np.eye(7)):
        ahead, behind = (
            _apply(np.eye(4), error) @ _step(roll_rad, curvature + error[6]) for error in (axis, -axis)
        )
        change = back @ (ahead - behind) / (2.0 * _SMALL)
        slopes[:6, number] = (*change[:3, 3], change[2, 1], change[0, 2], change[1, 0])
    return slopes
