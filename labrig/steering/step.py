"""The step that joins estimator and planner: (state, sighting) -> (state, command), pure.

A sighting is an insertion length and the tip's position seen there. The estimator takes it in. On an occasion the
path is replanned from where the tip will be once a turn can act. The command states how far the needle may advance,
where to take the next picture, and whether to turn the bevel or to stop.

There are two policies. The paper's (`SteeringPolicy.paper`) replans every 20 mm and lets a turn act at once. The
default policy also replans when the rest of the path would miss, and at every sighting near the target, and it allows
for the backlash. In the last millimetres it takes the path that comes nearest, and it stops where the tip passes the
target at its nearest.

While the needle moves, the planner searches quickly only. If that finds nothing and the old path will not do, the
needle halts, and the planner searches thoroughly.

If there is no path, or if the tip ended beside the target, the needle may recover: the command is then to withdraw it,
and `retreat_steering` goes on from a place that it has passed.
"""

import math
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from typing import Literal

import numpy as np

from labrig.errors import InputError
from labrig.needle.kinematics import FloatArray, cut_path, path_frames
from labrig.steering.approach import find_nearest_approach
from labrig.steering.bending import PathStretch, Turn, advance_pose, shorten, split_into_stretches
from labrig.steering.cavities import TipBelief, advance_belief, start_belief, step_belief
from labrig.steering.clearance import path_distances
from labrig.steering.planner import Effort, Plan, improve_plan, make_plan, plan_path
from labrig.steering.policy import SteeringCommand, SteeringSettings, StopReason, TipSighting
from labrig.steering.problem import PlanProblem, Surroundings
from labrig.steering.recovery import (
    PassedPlace,
    RecoverySettings,
    Stretch,
    find_cavities,
    list_places_back,
    widen_belief,
)
from labrig.steering.score import cost_path
from labrig.steering.tip import TipObservation, TipState
from labrig.steering.torsion import TurnAhead

Occasion = Literal["start", "schedule", "deviation", "near", "recovery"]

# An estimated radius counts within this factor of the given radius.
_RADIUS_FACTOR = 1.5
_HERE_MM = 0.02
_NO_TURN = 1e-9
_PLACES = 16
# Share of the rest of a path that the needle can correct sideways later, with curvature to spare.
_CORRECTED_SHARE = 0.05
# Rounds of a thorough search in which a better path is sought than the first.
_IMPROVING_ROUNDS = 6
# Shortest arcs by which a withdrawn needle leaves its old cut, each tried if the one before leads nowhere.
_LEAVES_MM = (4.0, 12.0, 20.0)

# The shortest arc by which the needle leaves its old cut, and the cavities that it will pass.
_Way = tuple[float, tuple[Stretch, ...]]


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
    refusal : str or None
        Why the planner found no path at this sighting; None if it found one or did not run.
    run_to_mm : float
        Of the last command.
    sought : str or None
        The occasion on which a quick search found no path: the needle halts, and the planner then searches thoroughly.
    moving_from : (float, array)
        Insertion length and position at which the tip was last known to move.
    passed : tuple of PassedPlace
        In order of depth, the start first; empty if the needle may not recover.
    turned_at_mm : tuple of float
        Insertion lengths at which the bevel was turned on the way to the present place.
    left_cut_mm : float
        Insertion length at which a withdrawn needle last left its old cut; infinite if it never was withdrawn.
    cavities : tuple of (float, float)
        Stretches, in insertion length, on which the tip did not bend before it was withdrawn.
    retreats : int
        How often the needle has recovered.
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
    refusal: str | None
    run_to_mm: float
    moving_from: tuple[float, FloatArray]
    sought: Occasion | None = None
    passed: tuple[PassedPlace, ...] = ()
    turned_at_mm: tuple[float, ...] = ()
    left_cut_mm: float = math.inf
    cavities: tuple[Stretch, ...] = ()
    retreats: int = 0

    @property
    def tip(self) -> TipState:
        """The tip at the last sighting."""
        return self.belief.tip

    @property
    def left_mm(self) -> float:
        """Length of the rest of the path."""
        return self.end_mm - self.insertion_mm

    def predict(self, insertion_mm: float, settings: SteeringSettings) -> FloatArray:
        """Return the tip's pose (4, 4) at an insertion length ahead if no further turn is made before it."""
        straight_mm = settings.policy.closing_mm / 2
        along = split_into_stretches(self.insertion_mm, insertion_mm, self.turns, straight_mm)
        return advance_pose(self.tip.pose, shorten(along, self.tip.slip), self.tip.curvature)

    def list_turns(self, roll_rad: float) -> list[TurnAhead]:
        """Return the turn that is made here and the planned ones, each with the length inserted until the next."""
        at_mm = [self.insertion_mm, *(turn.at_mm for turn in self.ahead), self.end_mm]
        rolls_rad = (roll_rad, *(turn.roll_rad for turn in self.ahead))
        return [
            TurnAhead(roll, max(0.0, to_mm - from_mm))
            for roll, (from_mm, to_mm) in zip(rolls_rad, pairwise(at_mm), strict=True)
        ]


def start_steering(settings: SteeringSettings) -> tuple[SteeringState, SteeringCommand]:
    """Plan the path before the needle moves.

    Raises
    ------
    InputError
        For a problem that cannot be planned.
    """
    return _command_next(_replan(begin_steering(settings), "start", settings), settings)


def begin_steering(settings: SteeringSettings) -> SteeringState:
    """Return the state at the start, without a plan."""
    belief = start_belief(settings.problem.start, settings.estimator)
    return SteeringState(
        belief=belief, insertion_mm=0.0, turns=(), plan=Plan(found=False, reason=None), plan_start=belief.tip.pose,
        plan_from_mm=0.0, ahead=(), end_mm=0.0, replans=-1, followed_mm=0.0, planned_at_mm=0.0, why=None, refusal=None,
        run_to_mm=0.0, moving_from=(0.0, belief.tip.position_mm), passed=(PassedPlace(0.0, belief, ()),),
    )  # fmt: skip


def step_steering(
    state: SteeringState, sighting: TipSighting, settings: SteeringSettings
) -> tuple[SteeringState, SteeringCommand]:
    """Take in a sighting and return what to do next.

    Raises
    ------
    InputError
        For a sighting at a smaller insertion length than the one before.
    """
    if sighting.insertion_mm < state.insertion_mm:
        raise InputError(
            f"insertion_mm is {sighting.insertion_mm:g} after {state.insertion_mm:g}: the needle was withdrawn",
            "start again from its present pose",
        )
    state = take_in_sighting(state, sighting, settings)
    stop = _stop_if_lost(state, settings)
    if stop is not None:
        return state, stop
    occasion = _find_occasion(state, settings)
    if occasion is not None:
        state = _replan(state, occasion, settings)
    return _command_next(state, settings)


def take_in_sighting(
    state: SteeringState, sighting: TipSighting, settings: SteeringSettings
) -> SteeringState:
    """Return the state with the tip advanced to a sighting, stretch by stretch, and updated with it.

    This is the estimating half of `step_steering`; reanalysis of a record uses it with the recorded turns.
    """
    straight_mm = settings.policy.closing_mm / 2
    along = split_into_stretches(state.insertion_mm, sighting.insertion_mm, state.turns, straight_mm)
    steps = [TipObservation(None, part.length_mm, part.roll_rad, part.bends) for part in along]
    last = steps.pop() if steps else TipObservation(None, 0.0)
    belief = state.belief
    for step in steps:
        belief = advance_belief(belief, step, settings.estimator)
    belief = step_belief(belief, replace(last, position_mm=sighting.position_mm), settings.estimator)
    moving_from, seen_mm = state.moving_from, sighting.position_mm
    if settings.estimator.robust and not belief.tip.accepted:
        seen_mm = None
    if seen_mm is not None and np.linalg.norm(seen_mm - moving_from[1]) >= settings.policy.stuck_mm / 2:
        moving_from = sighting.insertion_mm, seen_mm
    turns = tuple(turn for turn in state.turns if turn.at_mm >= sighting.insertion_mm)
    passed = state.passed
    if settings.recovery is not None and belief.tip.accepted:
        passed = (*passed, PassedPlace(sighting.insertion_mm, belief, turns))
    return replace(
        state,
        belief=belief,
        insertion_mm=sighting.insertion_mm,
        turns=turns,
        why=None,
        refusal=None,
        moving_from=moving_from,
        passed=passed,
    )


def turn_bevel(state: SteeringState, roll_rad: float, settings: SteeringSettings) -> SteeringState:
    """Return the state after a turn of the bevel at the present insertion length."""
    turns = (*state.turns, Turn(_acting_mm(state.insertion_mm, settings), roll_rad))
    return replace(state, turns=turns, turned_at_mm=(*state.turned_at_mm, state.insertion_mm))


def retreat_steering(
    state: SteeringState, leave_mm: float, settings: SteeringSettings
) -> tuple[SteeringState, SteeringCommand]:
    """Return what a needle that was withdrawn does next; it leaves its old cut at the passed place nearest to a length.

    The state is then that of the tip at this place; the next sighting lies beyond it.
    """
    place = min(state.passed, key=lambda passed: abs(passed.insertion_mm - leave_mm))
    ways = (_go_on_with_cost(place, state, way, settings) for way in _list_ways(state))
    gone_on = next((there for there, cost in ways if math.isfinite(cost)), None)
    return _command_next(gone_on or _go_on_from(place, state, _LEAVES_MM[0], settings), settings)


def _list_ways(state: SteeringState) -> tuple[_Way, ...]:
    """Return the ways to go on, in the order in which they are tried; the last forgets the known cavities."""
    known = tuple(sorted((*state.cavities, *find_cavities(state.passed))))
    return (*((leaves_mm, known) for leaves_mm in _LEAVES_MM), (_LEAVES_MM[0], ()))


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
        cavities=tuple(sorted((*state.cavities, *find_cavities(state.passed)))),
        left_cut_mm=at_mm,
        retreats=state.retreats + 1,
    )
    return _replan(returned, "recovery", settings, leaves_mm)


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
    if 0.0 <= state.insertion_mm - state.left_cut_mm < _LEAVES_MM[0]:
        return None
    if policy.final_mm > 0 and state.left_mm <= policy.final_mm:
        return "near"
    if state.insertion_mm - state.planned_at_mm >= policy.replan_every_mm - _HERE_MM:
        return "schedule"
    if math.isfinite(policy.deviation_mm):
        miss_mm, gap_mm = _predict_miss_and_gap(state, settings)
        near = state.left_mm <= policy.near_mm
        limit_mm = (
            policy.near_deviation_mm if near else policy.deviation_mm + policy.deviation_share * state.left_mm
        )
        if miss_mm > limit_mm or gap_mm < settings.problem.clearance_mm:
            return "near" if near else "deviation"
    return None


def _predict_miss_and_gap(state: SteeringState, settings: SteeringSettings) -> tuple[float, float]:
    """Return by how much the rest of the path would miss, and its smallest gap to an obstacle [mm]."""
    around = Surroundings(_problem_ahead(state, settings))
    psi = _psi_ahead(state, settings)
    miss = path_frames(psi, around.problem.radius_mm).positions_mm[-1] - around.target_mm
    if not len(around.centres_mm):
        return float(np.linalg.norm(miss)), math.inf
    apart = path_distances(psi, around.problem.radius_mm, around.centres_mm)
    return float(np.linalg.norm(miss)), float((apart - around.needle_and_obstacle_mm).min())


def _psi_ahead(state: SteeringState, settings: SteeringSettings) -> FloatArray:
    """Return the rest of the path (n, 2) from where a turn would act."""
    from_mm = _acting_mm(state.insertion_mm, settings)
    acting_mm = [max(_acting_mm(turn.at_mm, settings), from_mm) for turn in state.ahead]
    lengths_mm = np.diff([from_mm, *acting_mm, max(state.end_mm, from_mm)])
    rolls_rad = [0.0, *(turn.roll_rad for turn in state.ahead)]
    arcs_mm = np.maximum(lengths_mm, 0.0) * (1.0 - state.tip.slip)
    return np.column_stack((arcs_mm / _bounded_radius_mm(state, settings), rolls_rad))


def _replan(
    state: SteeringState, occasion: Occasion, settings: SteeringSettings, leaves_mm: float = 0.0
) -> SteeringState:
    """Return the state with a new path, with the old path if it will do, or with the reason why there is none.

    `leaves_mm` is the least length of an arc by which the needle leaves its old cut, 0 if it is not in one.
    """
    tried = replace(state, why=occasion, planned_at_mm=state.insertion_mm, sought=None)
    staged = settings.staging == "staged"
    stands = occasion in {"start", "recovery"} or state.sought is not None
    try:
        problem = _problem_ahead(state, settings)
    except InputError as error:
        return (
            replace(tried, sought=occasion)
            if staged and not stands
            else replace(tried, refusal=error.message)
        )
    problem = replace(problem, leaves_mm=leaves_mm)
    searches = staged and stands and occasion != "recovery"
    plan = _plan_with_clearance(problem, settings, "thorough" if searches else "quick")
    if not plan.found:
        if _is_still_good(state, settings):
            return tried
        if staged and not stands:
            return replace(tried, sought=occasion)
        if not staged:
            plan = _plan_with_clearance(problem, settings, "closer")
    return _follow(tried, plan, problem, settings) if plan.found else replace(tried, refusal=plan.reason)


def _problem_ahead(state: SteeringState, settings: SteeringSettings) -> PlanProblem:
    """Return the rest of the problem, from where a turn of the bevel would act.

    Raises
    ------
    InputError
        When the tip would be inside an obstacle.
    """
    from_mm = _acting_mm(state.insertion_mm, settings)
    start = state.predict(from_mm, settings)
    turned = sum(turn.roll_rad for turn in state.turns if turn.at_mm == from_mm)
    along = np.asarray(settings.problem.start)[:3, 2]
    return replace(
        settings.problem,
        start=advance_pose(start, (PathStretch(0.0, turned, bends=True),), 0.0),
        radius_mm=_bounded_radius_mm(state, settings),
        radius_range_mm=settings.problem.radius_range_mm if state.insertion_mm == 0.0 else None,
        cavity_mm=settings.estimator.cavity_mm if math.isfinite(settings.estimator.cavity_every_mm) else 0.0,
        axis=(float(along[0]), float(along[1]), float(along[2])),
        max_off_axis_rad=settings.policy.max_off_axis_rad,
        max_length_mm=max((settings.problem.max_length_mm - from_mm) * (1.0 - state.tip.slip), _HERE_MM),
        covariance=state.tip.covariance,
    )


def _plan_with_clearance(problem: PlanProblem, settings: SteeringSettings, effort: Effort) -> Plan:
    """Return a path with as much of the required clearance as possible, or the last reason why there is none."""
    least_mm = min(settings.policy.least_clearance_mm, problem.clearance_mm)
    without_margin = replace(problem, covariance=None)
    plan = _plan(problem, settings, effort)
    for relaxed in (without_margin, replace(without_margin, clearance_mm=least_mm, axis=None)):
        if plan.found:
            break
        plan = _plan(relaxed, settings, effort)
    return plan


def _plan(problem: PlanProblem, settings: SteeringSettings, effort: Effort) -> Plan:
    around = Surroundings(problem)
    if np.linalg.norm(around.target_mm) <= settings.policy.final_mm:
        weights = replace(problem.weights, target_error_per_mm=settings.policy.final_error_per_mm)
        psi = find_nearest_approach(Surroundings(replace(problem, weights=weights)))
        return Plan(found=False, reason="blocked near the target") if psi is None else make_plan(psi, around)
    plan = plan_path(problem, settings.method, effort)
    if effort == "thorough" and plan.found and settings.method == "best":
        plan = list(islice(improve_plan(problem, plan), _IMPROVING_ROUNDS))[-1]
    return plan


def _follow(
    state: SteeringState, plan: Plan, problem: PlanProblem, settings: SteeringSettings
) -> SteeringState:
    """Return the state with a new path: where to turn the bevel, and where the path ends."""
    from_mm = _acting_mm(state.insertion_mm, settings)
    ends_mm = from_mm + np.cumsum([0.0, *(arc.length_mm for arc in plan.arcs)]) / (1.0 - state.tip.slip)
    turns = tuple(
        Turn(
            float(at_mm) - settings.policy.backlash_mm / 2 if at_mm > from_mm else state.insertion_mm,
            arc.roll_rad,
        )
        for at_mm, arc in zip(ends_mm[:-1], plan.arcs, strict=True)
        if abs(math.sin(arc.roll_rad / 2)) > _NO_TURN
    )
    return replace(
        state,
        plan=plan,
        plan_start=np.asarray(problem.start),
        plan_from_mm=from_mm,
        ahead=turns,
        end_mm=float(ends_mm[-1]) if plan.arcs else _find_nearest_mm(state, from_mm, settings),
        replans=state.replans + 1,
        followed_mm=state.insertion_mm,
    )


def _find_nearest_mm(state: SteeringState, to_mm: float, settings: SteeringSettings) -> float:
    """Return the insertion length, before a turn made now would act, at which the tip is nearest to the target."""
    places_mm = np.linspace(state.insertion_mm, to_mm, _PLACES)
    tips = np.array([state.predict(float(at_mm), settings)[:3, 3] for at_mm in places_mm])
    return float(places_mm[np.argmin(np.linalg.norm(tips - settings.problem.target_mm, axis=1))])


def _is_still_good(state: SteeringState, settings: SteeringSettings) -> bool:
    """Return whether the rest of the old path will do: it touches nothing, and its miss can be corrected later."""
    if not state.plan.found:
        return False
    miss_mm, gap_mm = _predict_miss_and_gap(state, settings)
    recent = state.insertion_mm - state.followed_mm <= settings.policy.patience_mm
    can_correct = miss_mm <= settings.problem.tolerance_mm + _CORRECTED_SHARE * max(state.left_mm, 0.0)
    return (can_correct or recent) and gap_mm >= settings.policy.least_clearance_mm


def _command_next(state: SteeringState, settings: SteeringSettings) -> tuple[SteeringState, SteeringCommand]:
    """Return what to do next, and the state after it is done."""
    if state.refusal is not None:
        return state, _withdraw_or_stop(state, _find_stop_reason(state, settings), state.refusal, settings)
    if state.left_mm <= settings.policy.arrival_mm:
        return state, _stop_at_end(state, settings)
    if state.sought is not None:
        halt_mm = state.insertion_mm + settings.policy.lead_mm
        return replace(state, run_to_mm=halt_mm), SteeringCommand(0.0, halt_mm, halt_mm)
    turned, roll_rad = _make_due_turns(state, settings)
    run_to_mm = turned.end_mm
    if turned.ahead:
        soonest_mm = turned.insertion_mm + settings.policy.lead_mm
        run_to_mm = min(max(turned.ahead[0].at_mm, soonest_mm), run_to_mm)
    pictures = max(1, round((run_to_mm - turned.insertion_mm) / settings.policy.observe_every_mm))
    observe_at_mm = turned.insertion_mm + (run_to_mm - turned.insertion_mm) / pictures
    return replace(turned, run_to_mm=run_to_mm), SteeringCommand(roll_rad, observe_at_mm, run_to_mm)


def _make_due_turns(state: SteeringState, settings: SteeringSettings) -> tuple[SteeringState, float]:
    """Return the state after the due turns, and their roll; the bevel turns only while the needle stands still."""
    stands = state.insertion_mm >= state.run_to_mm - _HERE_MM
    due = [turn for turn in state.ahead if stands and turn.at_mm <= state.insertion_mm + _HERE_MM]
    roll_rad = math.remainder(sum(turn.roll_rad for turn in due), 2 * math.pi)
    state = replace(state, ahead=state.ahead[len(due) :])
    if abs(roll_rad) < _NO_TURN:
        return state, 0.0
    return turn_bevel(state, roll_rad, settings), roll_rad


def _stop_at_end(state: SteeringState, settings: SteeringSettings) -> SteeringCommand:
    problem = settings.problem
    miss_mm = float(np.linalg.norm(state.tip.position_mm - problem.target_mm))
    reached = miss_mm <= problem.tolerance_mm
    detail = f"the tip is {miss_mm:.2f} mm from the target, and {problem.tolerance_mm:g} mm are allowed"
    if reached:
        return _stop(state, "target_reached", detail)
    return _withdraw_or_stop(state, "target_missed", detail, settings)


def _withdraw_or_stop(
    state: SteeringState, reason: StopReason, detail: str, settings: SteeringSettings
) -> SteeringCommand:
    """Return a withdrawal to where the needle can go on, if it may and there is such a place, otherwise a stop."""
    recovery = settings.recovery
    leave_mm = None if recovery is None else _find_place_back(state, recovery, settings)
    if recovery is None or leave_mm is None:
        return _stop(state, reason, detail)
    back_mm = leave_mm - recovery.leaves_track_mm
    return replace(_stop(state, reason, detail), stop=None, withdraw_to_mm=back_mm, leave_mm=leave_mm)


def _find_place_back(
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


def _cost_with_cavities(
    state: SteeringState, known: tuple[Stretch, ...], settings: SteeringSettings
) -> float:
    """Return the cost of the path ahead if the known cavities are passed again, infinite if it then leads nowhere."""
    problem, plan, at_mm = _problem_ahead(state, settings), state.plan, state.plan_from_mm
    passed_mm = 0.0
    for from_mm, to_mm in known:
        if to_mm <= at_mm or from_mm >= at_mm + (plan.length_mm or 0.0):
            continue
        enters_mm = max(from_mm - at_mm, 0.0)
        bent = cut_path(plan.psi, enters_mm / problem.radius_mm)
        along = tuple(PathStretch(problem.radius_mm * angle, roll, bends=True) for angle, roll in bent)
        straight = PathStretch(to_mm - at_mm - enters_mm, 0.0, bends=False)
        beyond = advance_pose(problem.start, (*along, straight), 1.0 / problem.radius_mm)
        left_mm = max(settings.problem.max_length_mm - to_mm, _HERE_MM)
        try:
            problem = replace(problem, start=beyond, max_length_mm=left_mm)
        except InputError:
            return math.inf
        plan = _plan_with_clearance(problem, settings, "quick")
        if not plan.found or not plan.arcs:
            return math.inf
        passed_mm, at_mm = passed_mm + to_mm - at_mm, to_mm
    return cost_path(plan.psi, Surroundings(problem)) + settings.problem.weights.length_per_mm * passed_mm


def _find_stop_reason(state: SteeringState, settings: SteeringSettings) -> StopReason:
    """Return "blocked" if there is a path without the obstacles, otherwise "target_missed"."""
    free = replace(settings, problem=replace(settings.problem, obstacles=()))
    plan = _plan_with_clearance(_problem_ahead(state, free), free, "closer")
    return "blocked" if plan.found else "target_missed"


def _stop(state: SteeringState, reason: StopReason, detail: str) -> SteeringCommand:
    return SteeringCommand(0.0, state.insertion_mm, state.insertion_mm, reason, detail)


def _acting_mm(made_at_mm: float, settings: SteeringSettings) -> float:
    """Return the insertion length at which a turn of the bevel made at a length acts."""
    policy = settings.policy
    return max(made_at_mm + policy.backlash_mm / 2, policy.closing_mm / 2)


def _bounded_radius_mm(state: SteeringState, settings: SteeringSettings) -> float:
    """Return the estimated radius, within bounds about the given radius."""
    given_mm = settings.problem.radius_mm
    least, most = 1 / (given_mm * _RADIUS_FACTOR), _RADIUS_FACTOR / given_mm
    return 1.0 / min(max(state.tip.curvature, least), most)
