"""The settings of the steering step from an insertion protocol, for the live run and its reanalysis."""

import math
from dataclasses import replace

import numpy as np

from labrig.analysis.result import TrialOrigin
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.steering.out_of_plane import OutOfPlaneSettings
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import Obstacle, PlanProblem
from labrig.steering.tip import EstimatorSettings
from labrig.steering.torsion import TorsionalLag

SAME_MM = 0.005
"""Commanded insertion lengths that differ by less count as one."""


def make_insertion_settings(
    protocol: InsertionProtocol, target_mm: tuple[float, float, float], obstacles: tuple[Obstacle, ...]
) -> SteeringSettings:
    """Return problem, estimator and policy of an insertion from the origin of the steering plane along z.

    Raises
    ------
    InputError
        When the start or the target is inside an obstacle.
    """
    planner = protocol.planner
    return SteeringSettings(
        problem=PlanProblem(
            target_mm=target_mm,
            obstacles=obstacles,
            radius_mm=planner.radius_mm,
            diameter_mm=protocol.needle.diameter_mm,
            tolerance_mm=protocol.target.tolerance_mm,
            clearance_mm=planner.clearance_mm,
            max_arcs=planner.max_arcs,
            max_length_mm=protocol.insertion.max_length_mm,
            planar=True,
            weights=planner.weights,
        ),
        estimator=EstimatorSettings(
            **protocol.estimator.model_dump(), radius_mm=planner.radius_mm, planar=True
        ),
        policy=protocol.policy,
        method=planner.method,
        observe_every_mm=protocol.insertion.frame_every_mm,
    )


def make_out_of_plane(
    protocol: InsertionProtocol, roll_zero_sd_rad: float, torsion: TorsionalLag | None
) -> OutOfPlaneSettings:
    """Return what leads the needle out of the plane.

    `torsion` is the measured lag of the bevel, None if it was not measured; where the lag is compensated its standard
    deviation takes the place of the protocol's.
    """
    unseen = protocol.out_of_plane
    lag = TorsionalLag(best_sd_rad=math.radians(unseen.lag_sd_deg), per_mm_sd_rad=0.0)
    if torsion is not None and protocol.policy.turning == "compensated":
        lag = torsion
    heading_sd_deg = unseen.heading_sd_deg_per_root_mm
    if heading_sd_deg is None:
        heading_sd_deg = protocol.estimator.process_sd_deg_per_root_mm
    return OutOfPlaneSettings(
        heading_sd_rad_per_root_mm=math.radians(heading_sd_deg),
        start_sd_mm=unseen.start_sd_mm,
        start_sd_rad=math.radians(unseen.start_sd_deg),
        roll_zero_sd_rad=roll_zero_sd_rad,
        lag=lag,
    )


def start_at(settings: SteeringSettings, origin: TrialOrigin | None) -> SteeringSettings:
    """Return the settings with the start at the sheath's tip, in the sheath's direction, if it was found and accepted.

    Otherwise an insertion starts at the plane's origin.
    """
    if origin is None or not origin.accepted or origin.tip_mm is None or origin.heading_rad is None:
        return settings
    sine, cosine = math.sin(origin.heading_rad), math.cos(origin.heading_rad)
    start = np.eye(4)
    start[1:3, 1:3] = ((cosine, sine), (-sine, cosine))
    start[1:3, 3] = origin.tip_mm
    return replace(settings, problem=replace(settings.problem, start=start))
