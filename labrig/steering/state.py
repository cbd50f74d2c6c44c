"""The state of an insertion, and how sightings and turns of the bevel change it: the estimating half of the step."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

from labrig.needle.kinematics import FloatArray
from labrig.steering.cavities import TipBelief, advance_belief, start_belief, step_belief
from labrig.steering.motion import Turn, advance_pose, split_into_steps
from labrig.steering.planner import Plan
from labrig.steering.policy import SteeringSettings, TipSighting
from labrig.steering.tip import TipObservation, TipState
from labrig.steering.torsion import TurnAhead

Occasion = Literal["start", "schedule", "deviation", "near"]

HERE_MM = 0.02
"""Insertion lengths that differ by less count as one."""

NO_TURN = 1e-9
"""A turn of the bevel by less, or whose sine of half the angle is less, is none."""


@dataclass(frozen=True, eq=False)
class SteeringState:
    """The state of the insertion.

    Attributes
    ----------
    belief : TipBelief
        Of the tip, at the last sighting.
    insertion_mm : float
        At the last sighting.
    turns : tuple of Turn
        Turns that were made and may not have acted yet, at the lengths where they act.
    plan, plan_start, plan_from_mm
        The path that the needle follows, the pose where it starts, and the insertion length there.
    ahead : tuple of Turn
        Turns still to be made, at the lengths where they are to be made.
    end_mm : float
        Insertion length at the end of the path.
    replans : int
        Paths that were found after the first.
    followed_mm, planned_at_mm : float
        Insertion lengths at which the present path was found, and at which the planner last ran.
    why : str or None
        The occasion to replan at this sighting; None if there was none.
    refusal : Plan or None
        Why the planner found no path at this sighting; None if it found one or did not run.
    run_to_mm : float
        Of the last command.
    sought : str or None
        The occasion on which a quick search found no path: the needle halts, and the planner then searches thoroughly.
    moving_from : (float, array)
        Insertion length and position at which the tip was last known to move.
    seen : tuple of (float, float, float)
        Insertion length, y and z [mm] of each sighting that was believed.
    """

    belief: TipBelief
    insertion_mm: float
    turns: tuple[Turn, ...]
    plan: Plan
    plan_start: FloatArray
    plan_from_mm: float
    ahead: tuple[Turn, ...]
    end_mm: float
    replans: int
    followed_mm: float
    planned_at_mm: float
    why: Occasion | None
    refusal: Plan | None
    run_to_mm: float
    moving_from: tuple[float, FloatArray]
    sought: Occasion | None = None
    seen: tuple[tuple[float, float, float], ...] = ()

    @property
    def tip(self) -> TipState:
        """The tip at the last sighting."""
        return self.belief.tip

    @property
    def left_mm(self) -> float:
        """Length of the rest of the path."""
        return self.end_mm - self.insertion_mm

    def predict(self, insertion_mm: float, settings: SteeringSettings, turned_rad: float = 0.0) -> FloatArray:
        """Return the tip's pose (4, 4) at an insertion length ahead, and turned there; no further turn is before it."""
        steps = split_into_steps(self.insertion_mm, insertion_mm, self.turns, settings.policy.closing_mm / 2)
        if turned_rad:
            steps.append(TipObservation(None, 0.0, turned_rad))
        return advance_pose(self.tip, steps)

    def list_turns(self, roll_rad: float) -> list[TurnAhead]:
        """Return the turn that is made here and the planned ones, each with the length inserted until the next."""
        at_mm = [self.insertion_mm, *(turn.at_mm for turn in self.ahead), self.end_mm]
        rolls_rad = (roll_rad, *(turn.roll_rad for turn in self.ahead))
        return [
            TurnAhead(roll, max(0.0, to_mm - from_mm))
            for roll, (from_mm, to_mm) in zip(rolls_rad, pairwise(at_mm), strict=True)
        ]


def begin_steering(settings: SteeringSettings) -> SteeringState:
    """Return the state at the start, without a plan."""
    belief = start_belief(settings.problem.start, settings.estimator)
    return SteeringState(
        belief=belief, insertion_mm=0.0, turns=(), plan=Plan(found=False, reason=None), plan_start=belief.tip.pose,
        plan_from_mm=0.0, ahead=(), end_mm=0.0, replans=-1, followed_mm=0.0, planned_at_mm=0.0, why=None, refusal=None,
        run_to_mm=0.0, moving_from=(0.0, belief.tip.position_mm),
    )  # fmt: skip


def take_in_sighting(
    state: SteeringState, sighting: TipSighting, settings: SteeringSettings
) -> SteeringState:
    """Return the state with the tip advanced to a sighting, step by step, and updated with it.

    Reanalysis of a record uses it with the recorded turns.
    """
    straight_mm = settings.policy.closing_mm / 2
    steps = split_into_steps(state.insertion_mm, sighting.insertion_mm, state.turns, straight_mm)
    last = steps.pop() if steps else TipObservation(None, 0.0)
    belief = state.belief
    for step in steps:
        belief = advance_belief(belief, step, settings.estimator)
    belief = step_belief(belief, replace(last, position_mm=sighting.position_mm), settings.estimator)
    moving_from, seen, seen_mm = state.moving_from, state.seen, sighting.position_mm
    if seen_mm is not None and belief.tip.accepted:
        seen = (*seen, (sighting.insertion_mm, float(seen_mm[1]), float(seen_mm[2])))
        if math.dist(seen_mm, moving_from[1]) >= settings.policy.stuck_mm / 2:
            moving_from = sighting.insertion_mm, seen_mm
    return replace(
        state,
        belief=belief,
        insertion_mm=sighting.insertion_mm,
        turns=tuple(turn for turn in state.turns if turn.at_mm >= sighting.insertion_mm),
        why=None,
        refusal=None,
        moving_from=moving_from,
        seen=seen,
    )


def turn_bevel(state: SteeringState, roll_rad: float, settings: SteeringSettings) -> SteeringState:
    """Return the state after a turn of the bevel at the present insertion length."""
    turns = (*state.turns, Turn(settings.policy.find_acting_mm(state.insertion_mm), roll_rad))
    return replace(state, turns=turns)
