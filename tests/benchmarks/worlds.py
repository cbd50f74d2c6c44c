"""Worlds for insertions without pictures: none has the numbers that the policy assumes.

A world is read from its rig file. What protocols/insertion.yaml assumes a value for is drawn for each world about that
value: radius, backlash, closing length, spacing of cavities, noise of the sightings. The rig file's disturbances and
torsion are drawn too. The spreads stand in `Spreads`.
"""

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.protocol.load import load_protocol
from labrig.simulation.description import GelDescription, WorldDescription
from labrig.simulation.gel import Ball
from labrig.simulation.world import World
from labrig.steering.out_of_plane import OutOfPlaneSettings
from labrig.steering.problem import PlanProblem
from labrig.steering.torsion import TorsionalLag
from tests.benchmarks.planning_problems import draw_planar_problem

ROOT = Path(__file__).parents[2]
GELATIN_PERCENT = 16.0
REACH_MM = 100.0
_SMALL_PX = 64  # pictures are not taken; only the place of the lens counts


@dataclass(frozen=True)
class Spreads:
    """Standard deviations of the logarithm of each value about the assumed one.

    The last two are those of the measured roll zero and of the measured lag of torsion [rad].
    """

    radius: float = 0.02
    backlash: float = 0.3
    closing: float = 0.3
    cavity_spacing: float = 0.5
    sighting: float = 0.3
    wander: float = 0.2
    torsion: float = 0.3
    roll_zero_rad: float = math.radians(0.5)
    lag_rad: float = math.radians(1.0)


SPREADS = Spreads()


@dataclass(frozen=True)
class DrawnWorld:
    """A world with a phantom, an aimed target and the sheath introduced.

    problem : target and obstacles as the policy is told; sighting_sd_mm : noise of a sighting in y and z;
    roll_zero_rad : by how much the bevel is off where the policy takes it to be; measured_lag, told : what it knows of
    torsion and of other ways out of the plane; noise : draws the sightings.
    """

    world: World
    problem: PlanProblem
    sighting_sd_mm: float
    roll_zero_rad: float
    measured_lag: TorsionalLag
    told: OutOfPlaneSettings
    noise: np.random.Generator

    @property
    def linear_mm(self) -> float:
        """Where the linear axis stands during the insertion."""
        return self.world.description.sheath_tip_at_origin_linear_mm


@cache
def read_protocol() -> InsertionProtocol:
    """Return the protocol of the default policy, with leave to withdraw and re-enter."""
    protocol: Any = load_protocol(ROOT / "protocols" / "insertion.yaml", PROTOCOL_MODELS, [])
    assert isinstance(protocol, InsertionProtocol)
    return protocol


@cache
def read_world(name: str) -> WorldDescription:
    """Return the world of `calibration/rig-NAME.yaml`."""
    world = load_rig(ROOT / "calibration" / f"rig-{name}.yaml").world
    assert world is not None
    return world


def draw_world(described: WorldDescription, seed: int) -> DrawnWorld:
    """Return the world of a seed, drawn about what the policy assumes."""
    random = np.random.default_rng([seed, 5])
    assumed = read_protocol()
    problem = draw_planar_problem(np.random.default_rng([2, seed]), 2)
    description = _draw_description(described, random)
    world = World(description, seed)
    world.mount_needle("N1")
    world.place_phantom(
        "phantom", GELATIN_PERCENT, [Ball(o.position_mm, o.radius_mm) for o in problem.obstacles]
    )
    world.aim_at(problem.target_mm)
    sighting_sd_mm = _draw_about(assumed.estimator.observation_sd_mm, SPREADS.sighting, random)
    roll_zero_rad = SPREADS.roll_zero_rad * random.standard_normal()
    lag, told = _measure_lag(description, random), _tell_ways_out_of_plane(described)
    return DrawnWorld(
        world, problem, sighting_sd_mm, roll_zero_rad, lag, told, np.random.default_rng([seed, 3])
    )


def _measure_lag(description: WorldDescription, random: np.random.Generator) -> TorsionalLag:
    """Return the lag as it was measured: off by as much at every depth; none in a world without torsion."""
    needle = description.needle
    error_rad = SPREADS.lag_rad * random.standard_normal()
    if not _has_torsion(description):
        return TorsionalLag()
    return TorsionalLag(
        math.radians(needle.torsion_lag_deg) + error_rad, math.radians(needle.torsion_lag_deg_per_mm)
    )


def _tell_ways_out_of_plane(described: WorldDescription) -> OutOfPlaneSettings:
    """Return what the policy is told: the values of the rig file, not those drawn about them."""
    return OutOfPlaneSettings(
        heading_sd_rad_per_root_mm=math.radians(described.disturbances.out_of_plane_deg_per_root_mm),
        start_sd_mm=described.sheath.x_play_sd_mm,
        start_sd_rad=math.radians(described.sheath.lean_play_sd_deg),
        roll_zero_sd_rad=SPREADS.roll_zero_rad,
        lag=TorsionalLag(best_sd_rad=SPREADS.lag_rad if _has_torsion(described) else 0.0, per_mm_sd_rad=0.0),
    )


def _has_torsion(description: WorldDescription) -> bool:
    return description.needle.torsion_lag_deg + description.needle.torsion_lag_deg_per_mm > 0.0


def _draw_description(described: WorldDescription, random: np.random.Generator) -> WorldDescription:
    assumed = read_protocol()
    torsion = _draw_about(1.0, SPREADS.torsion, random)
    needle = described.needle.model_copy(
        update={
            "torsion_lag_deg": torsion * described.needle.torsion_lag_deg,
            "torsion_lag_deg_per_mm": torsion * described.needle.torsion_lag_deg_per_mm,
            "backlash_mm": _draw_about(assumed.policy.backlash_mm, SPREADS.backlash, random),
            "hinge_closing_mm": _draw_about(assumed.policy.closing_mm, SPREADS.closing, random),
        }
    )
    radius_mm = _draw_about(assumed.planner.radius_mm, SPREADS.radius, random)
    gel = GelDescription(gelatin_percent=GELATIN_PERCENT, radius_mean_mm=radius_mm, radius_sd_mm=0.0)
    disturbances = described.disturbances
    every_mm = _draw_about(assumed.estimator.cavity_every_mm or math.inf, SPREADS.cavity_spacing, random)
    cavities = min(int(random.poisson(REACH_MM / every_mm)), 20) if disturbances.cavities else 0
    wander = _draw_about(1.0, SPREADS.wander, random)
    return described.model_copy(
        update={
            "gels": (gel,),
            "needle": needle,
            "disturbances": disturbances.model_copy(
                update={
                    "cavities": cavities,
                    "heading_deg_per_root_mm": wander * disturbances.heading_deg_per_root_mm,
                    "out_of_plane_deg_per_root_mm": wander * disturbances.out_of_plane_deg_per_root_mm,
                    "curvature_fraction": wander * disturbances.curvature_fraction,
                }
            ),
            "lens": described.lens.model_copy(update={"width_px": _SMALL_PX, "height_px": _SMALL_PX}),
            "bubbles_per_specimen": 0,
        }
    )


def _draw_about(value: float, spread: float, random: np.random.Generator) -> float:
    return float(value * math.exp(spread * random.standard_normal()))
