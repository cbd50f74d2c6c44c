"""Simulated insertions for the estimator: truth by the paper's model with its disturbances, and what is seen of it.

The world of the figures: 100 mm in steps of 1 mm, observations with 0.2 mm, the tip turned at random by 0.3 degrees
per square-root millimetre, a start that is 0.02 rad off about each axis, and two flips; in the plane by half turns,
in space by any angle. A false sighting is of a bubble, an old track or a reflection up to 10 mm away.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from labrig.steering.cavities import start_belief, step_belief
from labrig.steering.estimator import start_tip, step_tip
from labrig.steering.tip import EstimatorSettings, TipObservation, TipState

Floats = NDArray[np.float64]

STEPS, RADIUS_MM, SIGMA_MM = 100, 27.6, 0.2
PROCESS_SD_RAD, START_SD_RAD = math.radians(0.3), 0.02


@dataclass(frozen=True, eq=False)
class SimulatedInsertion:
    """Truth (T + 1, 4, 4) and its curvature; observed positions (T + 1, 3), rolls (T,) and stated steps (T,)."""

    truth: Floats
    curvature: float
    positions_mm: Floats
    roll_rad: Floats
    step_mm: Floats = field(default_factory=lambda: np.ones(STEPS))

    @property
    def observations(self) -> list[TipObservation]:
        """The steps after the start."""
        return list(map(TipObservation, self.positions_mm[1:], self.step_mm.tolist(), self.roll_rad.tolist()))


def settings(planar: bool, **changes: Any) -> EstimatorSettings:
    """Return the settings that fit the simulated world."""
    known = {"radius_mm": RADIUS_MM, "radius_sd_mm": 0.0, "cavity_every_mm": None, "slip_sd": 0.0}
    sds_deg = np.degrees((PROCESS_SD_RAD, START_SD_RAD)).tolist()
    noise = dict(zip(("process_sd_deg_per_root_mm", "start_sd_deg"), sds_deg, strict=True))
    return EstimatorSettings(**known | noise | {"planar": planar, "observation_sd_mm": SIGMA_MM} | changes)


def insert(seed: int, planar: bool, radius_mm: float = RADIUS_MM, noise: float = 1.0) -> SimulatedInsertion:
    """Simulate one insertion in closed form; `noise` scales every disturbance and the observations' noise."""
    rng = np.random.default_rng([seed, planar])
    rolls = np.zeros(STEPS)
    rolls[rng.choice(np.arange(10, STEPS - 10), 2, replace=False)] = (
        math.pi if planar else rng.uniform(-math.pi, math.pi, 2)
    )
    turns_about = np.array((1.0, 0.0, 0.0) if planar else (1.0, 1.0, 1.0))
    turns = noise * turns_about * rng.normal(0.0, PROCESS_SD_RAD, (STEPS, 3))
    angle = 1.0 / radius_mm
    arc = np.eye(4)
    arc[:3, :3] = Rotation.from_rotvec((angle, 0.0, 0.0)).as_matrix()
    arc[:3, 3] = radius_mm * np.array((0.0, math.cos(angle) - 1.0, math.sin(angle)))
    truth = [_turn(noise * turns_about * rng.normal(0.0, START_SD_RAD, 3))]
    for roll, turn in zip(_turn(np.outer(rolls, (0.0, 0.0, 1.0))), _turn(turns), strict=True):
        truth.append(truth[-1] @ roll @ arc @ turn)
    poses = np.stack(truth)
    seen_along = np.array((0.0, 1.0, 1.0) if planar else (1.0, 1.0, 1.0))
    seen = poses[:, :3, 3] + noise * seen_along * rng.normal(0.0, SIGMA_MM, (STEPS + 1, 3))
    return SimulatedInsertion(poses, 1.0 / radius_mm, seen, rolls)


def follow(insertion: SimulatedInsertion, chosen: EstimatorSettings) -> list[TipState]:
    """Return the states of a whole insertion, from a start along z at the first position."""
    pose = np.eye(4)
    pose[:3, 3] = insertion.positions_mm[0]
    states = [start_tip(pose, chosen)]
    for observation in insertion.observations:
        states.append(step_tip(states[-1], observation, chosen))
    return states


def heading_errors_rad(poses: Floats, truth: Floats) -> Floats:
    """Return the angles between estimated and true tangents, (T + 1,)."""
    crossed = np.linalg.norm(np.cross(poses[:, :3, 2], truth[:, :3, 2]), axis=1)
    return np.arctan2(crossed, np.sum(poses[:, :3, 2] * truth[:, :3, 2], axis=1))


def nees(states: list[TipState], truth: Floats, curvature: float, chosen: EstimatorSettings) -> Floats:
    """Return the normalised estimation errors squared of what is uncertain, (T + 1,)."""
    back = np.stack([state.rotation.T for state in states])
    turned = Rotation.from_matrix(back @ truth[:, :3, :3]).as_rotvec()
    moved = back @ (truth[:, :3, 3] - np.stack([state.position_mm for state in states]))[..., None]
    bent = curvature - np.array([[state.curvature] for state in states])
    errors = np.hstack((moved[..., 0], turned, bent))[:, list(chosen.errors), None]
    covariances = np.stack([state.covariance[np.ix_(chosen.errors, chosen.errors)] for state in states])
    return np.asarray((errors * np.linalg.solve(covariances, errors)).sum(axis=(1, 2)))


def share_in_band(values: Floats, degrees: int) -> float:
    """Return the share of steps at which the mean over the runs, values (N, T), lies in its 95 % band."""
    low, high = (chi2.ppf(share, len(values) * degrees) / len(values) for share in (0.025, 0.975))
    means = values.mean(axis=0)
    return float(np.mean((low <= means) & (means <= high)))


def mean_nees_in_band(runs: int, planar: bool, radius_sd_mm: float) -> tuple[float, float]:
    """Return the share of steps in the band, and the mean NEES per degree of freedom, over runs of fixed seeds."""
    chosen = settings(planar, radius_sd_mm=radius_sd_mm)
    values = np.empty((runs, STEPS + 1))
    for seed in range(runs):
        drawn = np.random.default_rng([seed, 7]).normal(1.0 / RADIUS_MM, radius_sd_mm / RADIUS_MM**2)
        insertion = insert(seed, planar, 1.0 / drawn)
        values[seed] = nees(follow(insertion, chosen), insertion.truth, insertion.curvature, chosen)
    return share_in_band(values, len(chosen.errors)), float(values.mean()) / len(chosen.errors)


def heading_rmse_deg(runs: int, chosen: EstimatorSettings) -> float:
    """Return the RMSE of the heading over runs of fixed seeds, half of them 2 % too tight and half too wide."""
    squares = []
    for seed in range(runs):
        insertion = insert(seed, chosen.planar, RADIUS_MM * (1.02 if seed % 2 else 0.98))
        poses = np.stack([state.pose for state in follow(insertion, chosen)])
        squares.append(np.mean(heading_errors_rad(poses, insertion.truth) ** 2))
    return math.degrees(math.sqrt(np.mean(squares)))


def _turn(vectors: Floats) -> Floats:
    poses = np.tile(np.eye(4), (*vectors.shape[:-1], 1, 1))
    poses[..., :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
    return poses


AWAY_MM = 10.0
STREAK = 6
# Within this length after the first false sighting of a streak its effect on the heading is over.
AFTERMATH = 20
WATCHFUL = settings(planar=True, radius_sd_mm=0.02 * RADIUS_MM, cavity_every_mm=50.0)
"""The settings of the example protocol, in the world of the figures."""


def scatter(insertion: SimulatedInsertion, share: float, seed: int) -> SimulatedInsertion:
    """Return the insertion with this share of its sightings anywhere in a square about the tip."""
    rng = np.random.default_rng([seed, 99])
    false = rng.random(STEPS) < share
    positions = insertion.positions_mm.copy()
    away = rng.uniform(-AWAY_MM, AWAY_MM, (STEPS, 2))
    positions[1:, 1:][false] = (insertion.truth[1:, 1:3, 3] + away)[false]
    return replace(insertion, positions_mm=positions)


def shift_in_a_row(insertion: SimulatedInsertion, seed: int) -> tuple[SimulatedInsertion, int]:
    """Return the insertion with six sightings in a row off by the same vector, and the number of the first."""
    rng = np.random.default_rng([seed, 98])
    first = int(rng.integers(30, 70))
    positions = insertion.positions_mm.copy()
    streak = slice(first, first + STREAK)
    positions[streak, 1:] = insertion.truth[streak, 1:3, 3] + rng.uniform(-AWAY_MM, AWAY_MM, 2)
    return replace(insertion, positions_mm=positions), first


def follow_heading_errors_rad(insertion: SimulatedInsertion, chosen: EstimatorSettings) -> Floats:
    """Return the error of the heading at each sighting, (T + 1,), with cavities expected."""
    pose = np.eye(4)
    pose[:3, 3] = insertion.positions_mm[0]
    belief = start_belief(pose, chosen)
    poses = [belief.tip.pose]
    for observation in insertion.observations:
        belief = step_belief(belief, observation, chosen)
        poses.append(belief.tip.pose)
    return heading_errors_rad(np.stack(poses), insertion.truth)


def scattered_rmse_deg(runs: int, share: float, chosen: EstimatorSettings = WATCHFUL) -> float:
    """Return the RMSE of the heading over runs of fixed seeds with this share of false sightings."""
    errors = [
        follow_heading_errors_rad(scatter(insert(seed, planar=True), share, seed), chosen)
        for seed in range(runs)
    ]
    return math.degrees(math.sqrt(np.mean(np.square(errors))))


def streak_rmse_deg(runs: int, chosen: EstimatorSettings = WATCHFUL) -> float:
    """Return the RMSE of the heading over 20 mm from the first of six false sightings in a row."""
    errors = []
    for seed in range(runs):
        insertion, first = shift_in_a_row(insert(seed, planar=True), seed)
        errors.append(follow_heading_errors_rad(insertion, chosen)[first : first + AFTERMATH])
    return math.degrees(math.sqrt(np.mean(np.square(errors))))
