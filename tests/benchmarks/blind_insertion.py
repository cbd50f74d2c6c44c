"""One insertion in a drawn world without pictures: the product's loop, with a camera that sees with drawn noise.

A sighting is where the tip appears in the steering plane, with its parallax, and noise. The target is tracked if it
moves: its place is told with noise, as that of the tip.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Literal

import numpy as np

from labrig.devices.rig_file import RigDescription, load_rig
from labrig.experiments.insertion.bevel_path import BevelPath
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.experiments.insertion.virtual_axis import VirtualAxis
from labrig.experiments.insertion.virtual_insertion import VirtualInsertion, end_insertion
from labrig.experiments.insertion.virtual_shaft import SeenPath, draw_shaft
from labrig.needle.kinematics import FloatArray
from labrig.simulation.parallax import see_points
from labrig.simulation.world import World
from labrig.steering.out_of_plane import RolledStretch
from labrig.steering.parameters import SteeringPolicy
from labrig.steering.parameters import Turning as PlannedTurning
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import PlanProblem
from labrig.steering.state import SteeringState
from labrig.steering.step import start_steering
from labrig.steering.tip import EstimatorSettings
from labrig.steering.torsion import BaseLimits, BaseTurn
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import ShaftTip
from tests.benchmarks.seen_shaft import RIG, load_plane
from tests.benchmarks.worlds import DrawnWorld, read_protocol

Policy = Literal["default", "paper"]
Turning = Literal["compensated", "same_way", "back_and_forth"]

SPEED_MM_S = 1.0
TARGET_SD_MM = 0.2  # of a tracked target
AXIS = BaseLimits(-13.0, 13.0)


@dataclass(frozen=True)
class InsertionEnd:
    """The end of an insertion: why it stopped, the world's truth about it, and what the policy says of it.

    `off_mm` is the tip's true place (x, y, z) from the target; `interval_mm` is the policy's interval of its length;
    `left_plane` says that the picture contradicted what was known of the depth.
    """

    stop: str
    off_mm: tuple[float, float, float]
    clearance_mm: float
    replans: int
    turns: int
    outcome: str
    interval_mm: tuple[float, float]
    left_plane: bool

    @property
    def error_mm(self) -> float:
        """The distance from the target in space."""
        return math.hypot(*self.off_mm)

    @property
    def in_plane_mm(self) -> float:
        """The distance from the target in the plane."""
        return math.hypot(*self.off_mm[1:])

    @property
    def out_of_plane_mm(self) -> float:
        """The distance from the target across the plane."""
        return abs(self.off_mm[0])


@dataclass
class _DrawnCamera:
    """Sees the tip of a drawn world where perspective puts it, with its noise."""

    drawn: DrawnWorld
    plane: PlaneMap

    def see_tip(self, world: World, base_rad: float) -> FloatArray:
        """Return where the tip is seen, (3,)."""
        del base_rad
        return _see(self.drawn, world.tip_mm(), self.drawn.sighting_sd_mm)

    def see_shaft(self, path_mm: FloatArray, diameter_mm: float, since_turn_mm: float) -> ShaftTip:
        """Return the shaft of a needle with this path (N, 3)."""
        seen = SeenPath.of(*see_points(path_mm, self.drawn.world.description.lens))
        return draw_shaft(seen, self.plane, diameter_mm, since_turn_mm, self.drawn.noise)


class _SameWayBevel(BevelPath):
    """A bevel that is always turned in the same direction, which is compared with those of the product."""

    def choose(self, roll_rad: float, state: SteeringState, rolled: list[RolledStretch]) -> BaseTurn:
        """Return the turn of the base."""
        del state, rolled
        return BaseTurn(1, self.base_rad + abs(roll_rad), 0.0)


def make_settings(problem: PlanProblem, policy: Policy) -> SteeringSettings:
    """Return the settings of a policy, which are the same in every world: the protocol's, or the paper's.

    Only the longest path is the problem's: its targets are deeper than the protocol's.
    """
    chosen = make_insertion_settings(read_protocol(), problem.target_mm, problem.obstacles)
    chosen = replace(chosen, problem=replace(chosen.problem, max_length_mm=problem.max_length_mm))
    if policy == "default":
        return chosen
    assumed = chosen.estimator
    estimator = EstimatorSettings(
        assumed.radius_mm,
        assumed.observation_sd_mm,
        assumed.process_sd_rad_per_root_mm,
        "paper",
        planar=True,
    )
    return replace(chosen, estimator=estimator, policy=SteeringPolicy.paper(), method="paper")


def insert(drawn: DrawnWorld, policy: Policy, turning: Turning | None = None) -> InsertionEnd:
    """Carry out an insertion; unless told, the paper's policy turns back and forth, and the default compensates."""
    settings = make_settings(drawn.problem, policy)
    return steer(drawn, settings, turning or ("back_and_forth" if policy == "paper" else "compensated"))


def steer(drawn: DrawnWorld, settings: SteeringSettings, turning: Turning) -> InsertionEnd:
    """Carry out an insertion with these settings."""
    made = _make_insertion(drawn, settings, turning)
    made.move_world(0.0, made.bevel.base_rad)
    state, command = made.steer(*start_steering(settings))
    target_sd_mm = TARGET_SD_MM if drawn.world.description.target_moves_mm else 0.0
    end = end_insertion(made, state, command, drawn.told, target_sd_mm)
    truth, bounds = drawn.world.truth(), end.bounds
    assert bounds is not None
    return InsertionEnd(
        stop=str(command.stop),
        off_mm=_find_off(truth),
        clearance_mm=_find_clearance(truth),
        replans=state.replans,
        turns=len(made.bevel.turns),
        outcome=end.ending.outcome,
        interval_mm=bounds.interval_mm,
        left_plane=bounds.depth is not None and bounds.depth.contradicts,
    )


def _find_off(truth: Any) -> tuple[float, float, float]:
    x, y, z = (np.array((truth["tip_x_mm"], *truth["tip_mm"])) - truth["target_mm"]).tolist()
    return x, y, z


def _find_clearance(truth: Any) -> float:
    return float(truth["true_min_clearance_mm"])


def _make_insertion(drawn: DrawnWorld, settings: SteeringSettings, turning: Turning) -> VirtualInsertion:
    """Return the insertion before it begins, with the axis of the simulated rig."""
    rig = _read_rig()
    planned: PlannedTurning = "back_and_forth" if turning == "back_and_forth" else "compensated"
    kind = _SameWayBevel if turning == "same_way" else BevelPath
    bevel = kind(0, drawn.roll_zero_rad, drawn.measured_lag, AXIS, planned, settings.problem.radius_mm)
    return VirtualInsertion(
        world=drawn.world,
        camera=_DrawnCamera(drawn, load_plane()),
        axis=VirtualAxis(rig.axes.insertion, 1.0 / rig.recording.state_rate_hz),
        bevel=bevel,
        settings=settings,
        speed_mm_s=SPEED_MM_S,
        linear_mm=drawn.linear_mm,
        follow=partial(_follow_target, drawn),
    )


@cache
def _read_rig() -> RigDescription:
    return load_rig(RIG)


def _see(drawn: DrawnWorld, place_mm: Sequence[float], sd_mm: float) -> FloatArray:
    """Return where a place appears in the plane, with noise, (3,)."""
    seen, _ = see_points(np.array([place_mm]), drawn.world.description.lens)
    return np.array((0.0, *(seen[0] + drawn.noise.normal(0.0, sd_mm, 2))))


def _follow_target(drawn: DrawnWorld, settings: SteeringSettings) -> SteeringSettings:
    """Return the settings with the target where it is tracked, if it moves."""
    target_mm = drawn.world.locate_target_mm()
    if drawn.world.description.target_moves_mm == 0.0 or target_mm is None:
        return settings
    x, y, z = _see(drawn, target_mm, TARGET_SD_MM).tolist()
    return replace(settings, problem=replace(settings.problem, target_mm=(x, y, z)))
