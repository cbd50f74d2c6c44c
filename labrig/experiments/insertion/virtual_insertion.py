"""The steering loop of an insertion against the simulated world: its commands move the world, a camera sees the tip.

The steps are those of the procedure: turn, advance, look, estimate and plan. Bevel, ending and steering
step are the procedure's own.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from labrig.experiments.insertion.bevel_path import BevelPath
from labrig.experiments.insertion.ending import (
    Ending,
    EstimatedEnd,
    SeenEnd,
    TargetErrorBounds,
    TracedPath,
    bound_error,
    decide_ending,
    find_depth,
)
from labrig.experiments.insertion.virtual_axis import VirtualAxis
from labrig.experiments.insertion.virtual_camera import VirtualCamera
from labrig.simulation.world import World
from labrig.steering.out_of_plane import OutOfPlaneSettings, budget_out_of_plane
from labrig.steering.policy import SteeringCommand, SteeringSettings, TipSighting
from labrig.steering.state import SteeringState
from labrig.steering.step import step_steering

Follow = Callable[[SteeringSettings], SteeringSettings]


def _stand_still(settings: SteeringSettings) -> SteeringSettings:
    return settings


@dataclass
class VirtualInsertion:
    """An insertion in progress.

    Attributes
    ----------
    world : World
        With a phantom, an aimed target, and the sheath introduced.
    camera : VirtualCamera
    axis : VirtualAxis
        The insertion axis.
    bevel : BevelPath
    settings : SteeringSettings
    speed_mm_s : float
        Of the advance.
    linear_mm : float
        Where the linear axis stands.
    follow : callable
        Returns the settings with the target where it is tracked.
    """

    world: World
    camera: VirtualCamera
    axis: VirtualAxis
    bevel: BevelPath
    settings: SteeringSettings
    speed_mm_s: float
    linear_mm: float
    follow: Follow = field(default=_stand_still)

    def steer(self, state: SteeringState, command: SteeringCommand) -> tuple[SteeringState, SteeringCommand]:
        """Run the closed loop until a stop, and return the last state and command."""
        while command.stop is None:
            if command.roll_rad != 0.0:
                self._turn(command.roll_rad, state)
            at_mm = self.axis.pass_depth(command.observe_at_mm, command.run_to_mm, self.speed_mm_s)
            self.move_world(at_mm, self.bevel.base_rad)
            sighting = TipSighting(
                max(at_mm, state.insertion_mm), self.camera.see_tip(self.world, self.bevel.base_rad)
            )
            self.settings = self.follow(self.settings)
            state, command = step_steering(state, sighting, self.settings)
        return state, command

    def move_world(self, insertion_mm: float, base_rad: float) -> None:
        """Bring the needle to an insertion length, and its base to an angle from the roll zero."""
        self.world.advance(insertion_mm, self.bevel.zero_rad + base_rad, self.linear_mm)

    def _turn(self, roll_rad: float, state: SteeringState) -> None:
        at_mm = self.axis.position_mm
        turn, _ = self.bevel.turn(roll_rad, state, at_mm)
        self.move_world(at_mm, turn.farthest_rad)
        self.move_world(at_mm, turn.to_rad)


@dataclass(frozen=True)
class VirtualEnd:
    """What is known of the end of an insertion: its last state, its distance from the target, and how it ended."""

    state: SteeringState
    bounds: TargetErrorBounds | None
    ending: Ending


def end_insertion(
    made: VirtualInsertion,
    state: SteeringState,
    command: SteeringCommand,
    unseen: OutOfPlaneSettings | None,
    target_sd_mm: float,
) -> VirtualEnd:
    """Return how an insertion ended, as a last picture would tell.

    Parameters
    ----------
    unseen : OutOfPlaneSettings or None
        What leads the needle out of the plane; None: the plane alone decides.
    target_sd_mm : float
        Standard deviation of the target's place along each axis.
    """
    bounds = None
    if unseen is not None:
        path = TracedPath(
            tuple(made.bevel.turns), made.bevel.zero_rad, state.insertion_mm, made.bevel.centred
        )
        seen = _see_end(made, state, path, unseen)
        problem = made.settings.problem
        budget = budget_out_of_plane(path.split(made.settings), problem.radius_mm, unseen)
        bounds = bound_error(seen, budget, problem.target_mm, target_sd_mm)
    ending = decide_ending(
        str(command.stop),
        command.detail,
        bounds if command.stop == "target_reached" else None,
        made.settings.problem.tolerance_mm,
    )
    return VirtualEnd(state, bounds, ending)


def _see_end(
    made: VirtualInsertion,
    state: SteeringState,
    path: TracedPath,
    unseen: OutOfPlaneSettings,
) -> SeenEnd:
    """Return the end as a last picture shows it, or as the estimator has it."""
    truth: Any = made.world.truth()
    plane = made.camera.plane
    estimate = EstimatedEnd(state.tip.position_mm[1:], state.tip.position_sd_mm)
    diameter_mm = made.world.description.needle.diameter_mm
    end = made.camera.see_shaft(np.array(truth["path_mm"]), diameter_mm, path.since_turn_mm)
    if end is None:
        return SeenEnd.of_estimate(estimate, plane)
    depth = find_depth(end, plane, path, made.settings, unseen)
    return SeenEnd.of_shaft(end, estimate, path, plane, depth=depth)
