"""Where a needle that is withdrawn part of the way goes on: at the passed place from which its path costs least."""

import math
from dataclasses import replace

from labrig.errors import InputError
from labrig.needle.kinematics import cut_path
from labrig.steering.bending import PathStretch, advance_pose
from labrig.steering.planner import Plan
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import Surroundings
from labrig.steering.recovery import PassedPlace, RecoverySettings, Stretch, list_places_back, widen_belief
from labrig.steering.replanning import plan_with_clearance, pose_problem_ahead, replan
from labrig.steering.score import cost_path
from labrig.steering.state import HERE_MM, SteeringState

LEAVES_MM = (4.0, 12.0, 20.0)
"""Shortest arcs by which a withdrawn needle leaves its old cut, each tried if the one before leads nowhere."""

# The shortest arc by which the needle leaves its old cut, and the cavities that it will pass.
_Way = tuple[float, tuple[Stretch, ...]]


def go_on_after_retreat(state: SteeringState, leave_mm: float, settings: SteeringSettings) -> SteeringState:
    """Return the state at the passed place nearest to a length, with a path from there if there is one.

    It depends on state and length alone, not on the search that chose the length: the analysis of a record goes on from
    the recorded length, whatever its settings would have chosen.
    """
    place = min(state.passed, key=lambda passed: abs(passed.insertion_mm - leave_mm))
    ways = (_go_on_with_cost(place, state, way, settings) for way in _list_ways(state))
    gone_on = next((there for there, cost in ways if math.isfinite(cost)), None)
    return gone_on or _go_on_from(place, state, LEAVES_MM[0], settings)


def find_place_back(
    state: SteeringState, recovery: RecoverySettings, settings: SteeringSettings
) -> float | None:
    """Return the passed place from which the path costs least, the length withdrawn counted in, or None."""
    if state.retreats >= recovery.most_attempts:
        return None
    # A turn on the way would make the bend another than the one that the place was passed with.
    low_mm, high_mm = settings.policy.backlash_mm / 2, recovery.leaves_track_mm
    turned = tuple((at_mm - low_mm, at_mm + high_mm) for at_mm in state.turned_at_mm)
    before_mm = min(state.insertion_mm, state.left_cut_mm)
    ways = _list_ways(state)
    unfit = (*ways[0][1], *turned)
    for way in ways:
        costs = [
            (_go_on_with_cost(place, state, way, settings)[1], place.insertion_mm)
            for place in list_places_back(state.passed, unfit, before_mm, recovery)
        ]
        cost, best_mm = min(costs, default=(math.inf, 0.0))
        if math.isfinite(cost):
            return best_mm
    return None


def _go_on_from(
    place: PassedPlace, state: SteeringState, leaves_mm: float, settings: SteeringSettings
) -> SteeringState:
    """Return the state at a passed place, with a path from there that leaves the old cut, or why there is none."""
    at_mm = place.insertion_mm
    belief = place.belief if settings.recovery is None else widen_belief(place.belief, settings.recovery)
    returned = replace(
        state,
        belief=belief,
        insertion_mm=at_mm,
        turns=place.turns,
        plan=Plan(found=False, reason=None),
        ahead=(),
        end_mm=at_mm,
        refusal=None,
        sought=None,
        run_to_mm=at_mm,
        moving_from=(at_mm, belief.tip.position_mm),
        passed=tuple(passed for passed in state.passed if passed.insertion_mm <= at_mm),
        turned_at_mm=tuple(turned_mm for turned_mm in state.turned_at_mm if turned_mm <= at_mm),
        cavities=state.known_cavities,
        left_cut_mm=at_mm,
        retreats=state.retreats + 1,
    )
    return replan(returned, "recovery", settings, leaves_mm)


def _list_ways(state: SteeringState) -> tuple[_Way, ...]:
    """Return the ways to go on, in the order in which they are tried; the last forgets the known cavities."""
    known = state.known_cavities
    return (*((leaves_mm, known) for leaves_mm in LEAVES_MM), (LEAVES_MM[0], ()))


def _go_on_with_cost(
    place: PassedPlace, state: SteeringState, way: _Way, settings: SteeringSettings
) -> tuple[SteeringState, float]:
    """Return the state at a passed place, and the cost of its path and of the withdrawal; infinite without a path."""
    leaves_mm, known = way
    there = _go_on_from(place, state, leaves_mm, settings)
    if not there.plan.arcs or math.cos(there.plan.arcs[0].roll_rad) > 0.0:
        return there, math.inf
    withdrawn_mm = state.insertion_mm - place.insertion_mm
    cost = _cost_with_cavities(there, known, settings)
    return there, cost + settings.problem.weights.length_per_mm * withdrawn_mm


def _cost_with_cavities(
    state: SteeringState, known: tuple[Stretch, ...], settings: SteeringSettings
) -> float:
    """Return the cost of the path ahead if the known cavities are passed again, infinite if it then leads nowhere."""
    problem, plan, at_mm = pose_problem_ahead(state, settings), state.plan, state.plan_from_mm
    passed_mm = 0.0
    for from_mm, to_mm in known:
        if to_mm <= at_mm or from_mm >= at_mm + (plan.length_mm or 0.0):
            continue
        enters_mm = max(from_mm - at_mm, 0.0)
        bent = cut_path(plan.psi, enters_mm / problem.radius_mm)
        along = tuple(PathStretch(problem.radius_mm * angle, roll, bends=True) for angle, roll in bent)
        straight = PathStretch(to_mm - at_mm - enters_mm, 0.0, bends=False)
        beyond = advance_pose(problem.start, (*along, straight), 1.0 / problem.radius_mm)
        left_mm = max(settings.problem.max_length_mm - to_mm, HERE_MM)
        try:
            problem = replace(problem, start=beyond, max_length_mm=left_mm)
        except InputError:
            return math.inf
        plan = plan_with_clearance(problem, settings, "quick")
        if not plan.found or not plan.arcs:
            return math.inf
        passed_mm, at_mm = passed_mm + to_mm - at_mm, to_mm
    return cost_path(plan.psi, Surroundings(problem)) + settings.problem.weights.length_per_mm * passed_mm
