"""Sightings of something else than the tip: a bubble, an old track, a reflection up to 10 mm away."""

import math
from dataclasses import replace

import numpy as np

from labrig.steering.cavities import start_belief, step_belief
from labrig.steering.tip import EstimatorSettings
from tests.steering.insertions import (
    RADIUS_MM,
    STEPS,
    Floats,
    SimulatedInsertion,
    heading_errors_rad,
    insert,
    settings,
)

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
