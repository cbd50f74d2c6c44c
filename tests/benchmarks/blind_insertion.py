"""One insertion in a drawn world without pictures: the step's commands move the world, and it sees what a camera would.

A sighting is where the tip appears in the steering plane, with its parallax, and noise. While a sighting is computed
the needle advances. The target is tracked if it moves: its place is told with noise, as that of the tip. A needle that
recovers is withdrawn as the rig does it. In the end the shaft is measured as in a last picture (`seen_shaft`), and the
functions of the insertion decide.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from labrig.experiments.insertion.ending import (
    EstimatedEnd,
    SeenEnd,
    TargetErrorBounds,
    TracedPath,
    bound_error,
    find_depth,
)
from labrig.experiments.insertion.events import BevelTurn
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.needle.kinematics import FloatArray
from labrig.simulation.parallax import see_points
from labrig.steering.out_of_plane import RolledStretch, budget_out_of_plane
from labrig.steering.parameters import SteeringPolicy
from labrig.steering.policy import SteeringSettings, TipSighting
from labrig.steering.problem import PlanProblem
from labrig.steering.state import SteeringState
from labrig.steering.step import retreat_steering, start_steering, step_steering
from labrig.steering.tip import EstimatorSettings
from labrig.steering.torsion import (
    BaseLimits,
    BaseTurn,
    TorsionalLag,
    plan_turn,
)
from tests.benchmarks.seen_shaft import draw_shaft, load_plane
from tests.benchmarks.worlds import DrawnWorld, read_protocol

Policy = Literal["default", "paper"]
Turning = Literal["compensated", "same_way", "back_and_forth"]

COMPUTED_MM = 0.03  # the needle advances at 1 mm/s, and a picture takes 30 ms to be computed
TARGET_SD_MM = 0.2  # of a tracked target
AXIS = BaseLimits(-13.0, 13.0)
MOST_STEPS = 1000


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
    retreats: int

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
class _Bevel:
    """The base of the needle as the rotation axis turns it [rad from the roll zero], and its turns."""

    lag: TorsionalLag
    turning: Turning
    base_rad: float = 0.0
    turns: list[BevelTurn] = field(default_factory=list)

    def turn(self, at_mm: float, roll_rad: float, state: SteeringState, radius_mm: float) -> BaseTurn:
        """Return how the base turns at an insertion length, and take note of it."""
        turn = self._choose(roll_rad, state, radius_mm)
        self.turns.append(
            BevelTurn(
                trial=0,
                depth_mm=at_mm,
                from_rad=self.base_rad,
                to_rad=turn.to_rad,
                overshoot_rad=turn.overshoot_rad,
            )
        )
        self.base_rad = turn.to_rad
        return turn

    def undo_last(self) -> float:
        """Take back the last turn, and return at which insertion length it was made."""
        turn = self.turns.pop()
        self.base_rad = turn.from_rad
        return turn.depth_mm

    def _choose(self, roll_rad: float, state: SteeringState, radius_mm: float) -> BaseTurn:
        if self.turning == "same_way":
            return BaseTurn(1, self.base_rad + abs(roll_rad), 0.0)
        rolled, turns = self._list_rolled(state.insertion_mm), state.list_turns(roll_rad)
        return plan_turn(
            rolled, self.base_rad, turns, self.lag, AXIS, turning=self.turning, radius_mm=radius_mm
        )

    def _list_rolled(self, to_mm: float) -> list[RolledStretch]:
        """Return the stretches between turns, the present one included."""
        at_mm = (0.0, *(turn.depth_mm for turn in self.turns), to_mm)
        rolls = [(0.0, 0), *((t.to_rad, 1 if t.to_rad > t.from_rad else -1) for t in self.turns)]
        return [
            RolledStretch(max(0.0, end - start), *roll)
            for roll, (start, end) in zip(rolls, pairwise(at_mm), strict=True)
        ]


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
    return replace(chosen, estimator=estimator, policy=SteeringPolicy.paper(), method="paper", recovery=None)


def insert(drawn: DrawnWorld, policy: Policy, turning: Turning | None = None) -> InsertionEnd:
    """Carry out an insertion; unless told, the paper's policy turns back and forth, and the default compensates."""
    settings = make_settings(drawn.problem, policy)
    return steer(drawn, settings, turning or ("back_and_forth" if policy == "paper" else "compensated"))


def steer(drawn: DrawnWorld, settings: SteeringSettings, turning: Turning) -> InsertionEnd:
    """Carry out an insertion with these settings."""
    bevel = _Bevel(drawn.measured_lag, turning)
    _move(drawn, 0.0, bevel.base_rad)
    state, command = start_steering(settings)
    at_mm = 0.0
    for _ in range(MOST_STEPS):
        if command.stop is not None:
            break
        if command.withdraw_to_mm is not None and command.leave_mm is not None:
            at_mm = _withdraw(drawn, bevel, command.withdraw_to_mm)
            state, command = retreat_steering(state, command.leave_mm, settings)
            continue
        if command.roll_rad != 0.0:
            turn = bevel.turn(at_mm, command.roll_rad, state, settings.problem.radius_mm)
            _move(drawn, at_mm, turn.farthest_rad)
            _move(drawn, at_mm, turn.to_rad)
        seen_at_mm, run_to_mm = max(command.observe_at_mm, at_mm), command.run_to_mm
        _move(drawn, seen_at_mm, bevel.base_rad)
        sighting = TipSighting(seen_at_mm, _see(drawn, drawn.world.tip_mm(), drawn.sighting_sd_mm))
        settings = _follow_target(drawn, settings)
        state, command = step_steering(state, sighting, settings)
        at_mm = max(seen_at_mm, min(run_to_mm, seen_at_mm + COMPUTED_MM))
        _move(drawn, at_mm, bevel.base_rad)
    path = TracedPath(tuple(bevel.turns), 0.0, at_mm)
    return _describe_end(drawn, settings, state, command.stop or "never", path)


def _withdraw(drawn: DrawnWorld, bevel: _Bevel, to_mm: float) -> float:
    """Withdraw the needle along its path, turning back where it was turned, and return the insertion length there."""
    while bevel.turns and bevel.turns[-1].depth_mm > to_mm:
        _move(drawn, bevel.turns[-1].depth_mm, bevel.base_rad)
        _move(drawn, bevel.undo_last(), bevel.base_rad)
    _move(drawn, to_mm, bevel.base_rad)
    return to_mm


def _move(drawn: DrawnWorld, insertion_mm: float, base_rad: float) -> None:
    drawn.world.advance(insertion_mm, drawn.roll_zero_rad + base_rad, drawn.linear_mm)


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


def _describe_end(
    drawn: DrawnWorld, settings: SteeringSettings, state: SteeringState, stop: str, path: TracedPath
) -> InsertionEnd:
    truth: Any = drawn.world.truth()
    bounds = _bound_error(drawn, settings, state, path)
    steered = stop == "target_reached"
    return InsertionEnd(
        stop=stop,
        off_mm=tuple((np.array((truth["tip_x_mm"], *truth["tip_mm"])) - truth["target_mm"]).tolist()),
        clearance_mm=truth["true_min_clearance_mm"],
        replans=state.replans,
        turns=len(path.turns),
        outcome=bounds.decide(settings.problem.tolerance_mm).outcome if steered else "missed",
        interval_mm=bounds.interval_mm,
        left_plane=bounds.depth is not None and bounds.depth.contradicts,
        retreats=state.retreats,
    )


def _bound_error(
    drawn: DrawnWorld, settings: SteeringSettings, state: SteeringState, path: TracedPath
) -> TargetErrorBounds:
    """Return the distance from the target as the policy knows it at the end."""
    seen = _see_end(drawn, settings, state, path)
    budget = budget_out_of_plane(path.split(settings), settings.problem.radius_mm, drawn.told)
    target_sd_mm = TARGET_SD_MM if drawn.world.description.target_moves_mm else 0.0
    return bound_error(seen, budget, settings.problem.target_mm, target_sd_mm)


def _see_end(
    drawn: DrawnWorld, settings: SteeringSettings, state: SteeringState, path: TracedPath
) -> SeenEnd:
    """Return the end as a last picture shows it."""
    truth: Any = drawn.world.truth()
    description, plane = drawn.world.description, load_plane()
    end = draw_shaft(truth["path_mm"], description.lens, description.needle.diameter_mm, drawn.noise)
    estimate = EstimatedEnd(state.tip.position_mm[1:], state.tip.position_sd_mm)
    depth = find_depth(end, plane, path, settings, drawn.told)
    return SeenEnd.of_shaft(end, estimate, path, plane, depth=depth)
