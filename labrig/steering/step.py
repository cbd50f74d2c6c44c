"""The step that joins estimator and planner: (state, sighting) -> (state, command), pure.

A sighting is an insertion length and the tip's position seen there. The estimator takes it in. On an occasion the
path is replanned from where the tip will be once a turn can act. The command states how far the needle may advance,
where to take the next picture, and whether to turn the bevel or to stop.

There are two policies. The paper's (`PAPER_POLICY`) replans every 20 mm and lets a turn act at once. The
default policy also replans when the rest of the path would miss, and at every sighting near the target, and it allows
for the backlash. In the last millimetres it takes the path that comes nearest, and it stops where the tip passes the
target at its nearest.
"""

import math
from dataclasses import replace

import numpy as np

from labrig.needle.kinematics import FloatArray
from labrig.steering.policy import Halt, SteeringCommand, SteeringSettings, StopReason, TipSighting
from labrig.steering.replanning import plan_with_clearance, pose_problem_ahead, predict_miss_and_gap, replan
from labrig.steering.state import (
    HERE_MM,
    NO_TURN,
    Occasion,
    SteeringState,
    begin_steering,
    take_in_sighting,
    turn_bevel,
)

LEAD_MM = 0.2
"""A turn that is planned while the needle moves is made no sooner than after this length."""

# The needle stops when less than this is left of the path.
_ARRIVAL_MM = 0.05


def start_steering(
    settings: SteeringSettings, known: FloatArray | None = None
) -> tuple[SteeringState, SteeringCommand]:
    """Plan the path before the needle moves.

    `known` is a path (n, 2) to the same target from nearly there, columns (theta, delta), as in `plan_path`.

    Raises
    ------
    InputError
        For a problem that cannot be planned.
    """
    return _command_next(replan(begin_steering(settings), "start", settings, known), settings)


def step_steering(
    state: SteeringState, sighting: TipSighting, settings: SteeringSettings, halt: Halt | None = None
) -> tuple[SteeringState, SteeringCommand]:
    """Take in a sighting and return what to do next; that is to stop if something else than the tip calls for it."""
    state = take_in_sighting(state, sighting, settings)
    if halt is not None:
        return state, _stop(state, halt.reason, halt.detail)
    if (stop := _stop_if_lost(state, settings)) is not None:
        return state, stop
    if (occasion := _find_occasion(state, settings)) is not None:
        state = replan(state, occasion, settings)
    return _command_next(state, settings)


def _stop_if_lost(state: SteeringState, settings: SteeringSettings) -> SteeringCommand | None:
    """Return a stop if the tip is not seen, or does not move, otherwise None."""
    policy = settings.policy
    if state.tip.misses >= policy.most_misses:
        detail = f"the tip was not seen where it should be at {state.tip.misses} sightings in a row"
        return _stop(state, "needle_lost", detail)
    stood_mm = state.insertion_mm - state.moving_from[0]
    if state.tip.misses == 0 and stood_mm >= policy.stuck_mm:
        moved_mm = float(np.linalg.norm(state.tip.position_mm - state.moving_from[1]))
        detail = f"inserted by {stood_mm:.1f} mm, the tip moved by {moved_mm:.1f} mm"
        return _stop(state, "needle_stuck", detail)
    return None


def _find_occasion(state: SteeringState, settings: SteeringSettings) -> Occasion | None:
    """Return the occasion to replan here, or None."""
    policy = settings.policy
    if state.sought is not None:
        return state.sought
    if policy.final_mm > 0 and state.left_mm <= policy.final_mm:
        return "near"
    if state.insertion_mm - state.planned_at_mm >= policy.replan_every_mm - HERE_MM:
        return "schedule"
    return None if policy.deviation_mm is None else _find_deviation(state, settings, policy.deviation_mm)


def _find_deviation(state: SteeringState, settings: SteeringSettings, deviation_mm: float) -> Occasion | None:
    """Return the occasion to replan if the rest of the path would miss or come too close to an obstacle, or None."""
    policy, near = settings.policy, state.left_mm <= settings.policy.near_mm
    limit_mm = policy.NEAR_DEVIATION_MM if near else deviation_mm + policy.DEVIATION_SHARE * state.left_mm
    miss_mm, gap_mm = predict_miss_and_gap(state, settings)
    if miss_mm > limit_mm or gap_mm < settings.problem.clearance_mm:
        return "near" if near else "deviation"
    return None


def _command_next(state: SteeringState, settings: SteeringSettings) -> tuple[SteeringState, SteeringCommand]:
    """Return what to do next, and the state after it is done."""
    if state.refusal is not None:
        return state, _stop(state, _find_stop_reason(state, settings), str(state.refusal.reason))
    if state.left_mm <= _ARRIVAL_MM:
        return state, _stop_at_end(state, settings)
    if state.sought is not None:
        halt_mm = state.insertion_mm + LEAD_MM
        return replace(state, run_to_mm=halt_mm), SteeringCommand(0.0, halt_mm, halt_mm)
    turned, roll_rad = _make_due_turns(state, settings)
    run_to_mm = turned.end_mm
    if turned.ahead:
        soonest_mm = turned.insertion_mm + LEAD_MM
        run_to_mm = min(max(turned.ahead[0].at_mm, soonest_mm), run_to_mm)
    pictures = max(1, round((run_to_mm - turned.insertion_mm) / settings.observe_every_mm))
    observe_at_mm = turned.insertion_mm + (run_to_mm - turned.insertion_mm) / pictures
    return replace(turned, run_to_mm=run_to_mm), SteeringCommand(roll_rad, observe_at_mm, run_to_mm)


def _make_due_turns(state: SteeringState, settings: SteeringSettings) -> tuple[SteeringState, float]:
    """Return the state after the due turns, and their roll; the bevel turns only while the needle stands still."""
    stands = state.insertion_mm >= state.run_to_mm - HERE_MM
    due = [turn for turn in state.ahead if stands and turn.at_mm <= state.insertion_mm + HERE_MM]
    if not due:
        return state, 0.0
    roll_rad = math.remainder(sum(turn.roll_rad for turn in due), 2 * math.pi)
    state = replace(state, ahead=state.ahead[len(due) :])
    if abs(roll_rad) < NO_TURN:
        return state, 0.0
    return turn_bevel(state, roll_rad, settings), roll_rad


def _stop_at_end(state: SteeringState, settings: SteeringSettings) -> SteeringCommand:
    problem = settings.problem
    miss_mm = float(np.linalg.norm(state.tip.position_mm - problem.target_mm))
    seen = f"at the end of its path the tip was {miss_mm:.2f} mm from the target by the estimate"
    detail = f"{seen}, and {problem.tolerance_mm:g} mm are allowed"
    return _stop(state, "target_reached" if miss_mm <= problem.tolerance_mm else "target_missed", detail)


def _find_stop_reason(state: SteeringState, settings: SteeringSettings) -> StopReason:
    """Return "blocked" if there is a path without the obstacles, otherwise "target_missed"."""
    free = replace(settings, problem=replace(settings.problem, obstacles=(), obstacle_sds_mm=()))
    plan = plan_with_clearance(pose_problem_ahead(state, free), free, "closer")
    return "blocked" if plan.found else "target_missed"


def _stop(state: SteeringState, reason: StopReason, detail: str) -> SteeringCommand:
    return SteeringCommand(0.0, state.insertion_mm, state.insertion_mm, reason, detail)
