"""The step that joins estimator and planner: (state, sighting) -> (state, command), pure.

A sighting is an insertion length and where the tip was seen there. The estimator takes it in; where there is an
occasion the path is planned anew, from where the tip will be once a turn can act; the command says how far the needle
may run, where to look next, and whether to turn the bevel or to stop.

Two policies. The paper's (`SteeringPolicy.paper`) plans anew every 20 mm and takes a turn to act at once. The default
one plans anew also where the path that is left would miss, at every sighting near the target, and counts with the
backlash; in the last millimetres it takes what comes nearest, and it stops where the tip passes the target at its
nearest.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from labrig.errors import InputError
from labrig.needle.kinematics import path_frames
from labrig.steering.approach import nearest_approach
from labrig.steering.bending import Stretch, Turn, advanced, stretches
from labrig.steering.cavities import TipBelief, advance_belief, start_belief, step_belief
from labrig.steering.clearance import path_distances
from labrig.steering.planner import Plan, plan_of, plan_path
from labrig.steering.policy import SteeringCommand, SteeringSettings, StopReason, TipSighting
from labrig.steering.problem import PlanProblem, Surroundings
from labrig.steering.tip import FloatArray, TipObservation, TipState

Occasion = Literal["start", "schedule", "deviation", "near"]

# An estimated radius is believed within this factor of the one that was given.
_RADIUS_FACTOR = 1.5
_HERE_MM = 0.02
_NO_TURN = 1e-9
_PLACES = 16
# So much of what is left of a path can be mended aside later, with the needle's curvature to spare.
_MENDED_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class SteeringState:
    """What is known of the insertion.

    Attributes
    ----------
    belief : TipBelief
        Of the tip, at the last sighting.
    insertion_mm : float
        There.
    turns : tuple of Turn
        Turns of the bend that were made and may not have acted yet, where they act.
    plan, plan_start, plan_from_mm
        The path that is followed, the pose where it starts, and the insertion length there.
    ahead : tuple of Turn
        Turns of the bevel still to be made, where they are to be made.
    end_mm : float
        Insertion length at the end of the path.
    replans : int
        Paths that were found after the first.
    followed_mm, planned_at_mm : float
        Insertion lengths at which the path was found that is followed, and at which one was sought last.
    why : str or None
        On which occasion a path was sought at this sighting; None where none was.
    refusal : str or None
        Why none was found there; None where one was, or none was sought.
    run_to_mm : float
        The last command's.
    moving_from : (float, array)
        Insertion length and place at which the tip was last known to move.
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

    @property
    def tip(self) -> TipState:
        """The tip at the last sighting."""
        return self.belief.tip

    @property
    def left_mm(self) -> float:
        """How much of the path is left."""
        return self.end_mm - self.insertion_mm

    def predicted(self, insertion_mm: float, settings: SteeringSettings) -> FloatArray:
        """Return the tip's pose (4, 4) at an insertion length ahead, if no turn is made before it but those made."""
        straight_mm = settings.policy.closing_mm / 2
        along = stretches(self.insertion_mm, insertion_mm, self.turns, straight_mm)
        return advanced(self.tip.pose, along, self.tip.curvature)


def start_steering(settings: SteeringSettings) -> tuple[SteeringState, SteeringCommand]:
    """Plan the path before the needle moves.

    Raises
    ------
    InputError
        For a problem that is none.
    """
    belief = start_belief(settings.problem.start, settings.estimator)
    none = Plan(found=False, reason=None)
    state = SteeringState(
        belief=belief, insertion_mm=0.0, turns=(), plan=none, plan_start=belief.tip.pose, plan_from_mm=0.0,
        ahead=(), end_mm=0.0,
        replans=-1, followed_mm=0.0, planned_at_mm=0.0, why=None, refusal=None, run_to_mm=0.0,
        moving_from=(0.0, belief.tip.position_mm),
    )  # fmt: skip
    return _commanded(_replanned(state, "start", settings), settings)


def step_steering(
    state: SteeringState, sighting: TipSighting, settings: SteeringSettings
) -> tuple[SteeringState, SteeringCommand]:
    """Take in a sighting and say what to do next.

    Raises
    ------
    InputError
        For a sighting at a smaller insertion length than the one before.
    """
    if sighting.insertion_mm < state.insertion_mm:
        raise InputError(
            f"insertion_mm is {sighting.insertion_mm:g} after {state.insertion_mm:g}: the needle was withdrawn",
            "start again where it stands",
        )
    seen = sighted(state, sighting, settings)
    lost = _lost(seen, settings)
    if lost is not None:
        return seen, lost
    occasion = _occasion(seen, settings)
    if occasion is not None:
        seen = _replanned(seen, occasion, settings)
    return _commanded(seen, settings)


def sighted(state: SteeringState, sighting: TipSighting, settings: SteeringSettings) -> SteeringState:
    """Return the state with the tip brought to a sighting, stretch by stretch, and the sighting taken in.

    This is the estimating half of `step_steering`; a record is followed by it, with the turns that were made.
    """
    straight_mm = settings.policy.closing_mm / 2
    along = stretches(state.insertion_mm, sighting.insertion_mm, state.turns, straight_mm)
    steps = [TipObservation(None, one.length_mm, one.roll_rad, one.bends) for one in along]
    last = steps.pop() if steps else TipObservation(None, 0.0)
    belief = state.belief
    for step in steps:
        belief = advance_belief(belief, step, settings.estimator)
    belief = step_belief(belief, replace(last, position_mm=sighting.position_mm), settings.estimator)
    from_mm, place = state.moving_from
    if (
        sighting.position_mm is not None
        and np.linalg.norm(sighting.position_mm - place) >= settings.policy.stuck_mm / 2
    ):
        from_mm, place = sighting.insertion_mm, sighting.position_mm
    return replace(
        state,
        belief=belief,
        insertion_mm=sighting.insertion_mm,
        turns=tuple(turn for turn in state.turns if turn.at_mm >= sighting.insertion_mm),
        why=None,
        refusal=None,
        moving_from=(from_mm, place),
    )


def turned(state: SteeringState, roll_rad: float, settings: SteeringSettings) -> SteeringState:
    """Return the state after the bevel has been turned where the needle stands."""
    return replace(state, turns=(*state.turns, Turn(_acts_at(state.insertion_mm, settings), roll_rad)))


def _lost(state: SteeringState, settings: SteeringSettings) -> SteeringCommand | None:
    """Return the stop of a needle whose tip is not seen, or not seen to move."""
    policy = settings.policy
    if state.tip.misses >= policy.most_misses:
        detail = f"the tip was not seen where it should be at {state.tip.misses} sightings in a row"
        return _stopped(state, "needle_lost", detail)
    stood_mm = state.insertion_mm - state.moving_from[0]
    if state.tip.misses == 0 and stood_mm >= policy.stuck_mm:
        moved_mm = float(np.linalg.norm(state.tip.position_mm - state.moving_from[1]))
        detail = f"inserted by {stood_mm:.1f} mm, the tip moved by {moved_mm:.1f} mm"
        return _stopped(state, "needle_stuck", detail)
    return None


def _occasion(state: SteeringState, settings: SteeringSettings) -> Occasion | None:
    """Return why to plan anew here, or None."""
    policy = settings.policy
    if policy.final_mm > 0 and state.left_mm <= policy.final_mm:
        return "near"
    if state.insertion_mm - state.planned_at_mm >= policy.replan_every_mm - _HERE_MM:
        return "schedule"
    if math.isfinite(policy.deviation_mm):
        miss_mm, gap_mm = _outlook(state, settings)
        near = state.left_mm <= policy.near_mm
        limit_mm = (
            policy.near_deviation_mm if near else policy.deviation_mm + policy.deviation_share * state.left_mm
        )
        if miss_mm > limit_mm or gap_mm < settings.problem.clearance_mm:
            return "near" if near else "deviation"
    return None


def _outlook(state: SteeringState, settings: SteeringSettings) -> tuple[float, float]:
    """Return by how much the rest of the path would miss, and the smallest gap to an obstacle on it."""
    around = Surroundings(_problem_ahead(state, settings))
    psi = _psi_ahead(state, settings)
    miss = path_frames(psi, around.problem.radius_mm).positions_mm[-1] - around.target_mm
    if not len(around.centres_mm):
        return float(np.linalg.norm(miss)), math.inf
    apart = path_distances(psi, around.problem.radius_mm, around.centres_mm)
    return float(np.linalg.norm(miss)), float((apart - around.needle_and_obstacle_mm).min())


def _psi_ahead(state: SteeringState, settings: SteeringSettings) -> FloatArray:
    """Return the rest of the path (n, 2) from where a turn would act."""
    from_mm = _acts_at(state.insertion_mm, settings)
    acting_mm = [max(_acts_at(turn.at_mm, settings), from_mm) for turn in state.ahead]
    lengths_mm = np.diff([from_mm, *acting_mm, max(state.end_mm, from_mm)])
    rolls_rad = [0.0, *(turn.roll_rad for turn in state.ahead)]
    return np.column_stack((np.maximum(lengths_mm, 0.0) / _radius_mm(state, settings), rolls_rad))


def _replanned(state: SteeringState, occasion: Occasion, settings: SteeringSettings) -> SteeringState:
    """Return the state with a new path, or with the old one and, where that will not do, why there is no new one."""
    sought = replace(state, why=occasion, planned_at_mm=state.insertion_mm)
    try:
        problem = _problem_ahead(state, settings)
    except InputError as error:
        return replace(sought, refusal=error.message)
    plan = _planned(problem, settings, thorough=False)
    if not plan.found:
        if _still_good(state, settings):
            return sought
        plan = _planned(problem, settings, thorough=True)
    return _followed(sought, plan, problem, settings) if plan.found else replace(sought, refusal=plan.reason)


def _problem_ahead(state: SteeringState, settings: SteeringSettings) -> PlanProblem:
    """Return the problem that is left, from where a turn of the bevel would act.

    Raises
    ------
    InputError
        When that is no problem: the tip would be inside an obstacle.
    """
    from_mm = _acts_at(state.insertion_mm, settings)
    start = state.predicted(from_mm, settings)
    turned = sum(turn.roll_rad for turn in state.turns if turn.at_mm == from_mm)
    along = np.asarray(settings.problem.start)[:3, 2]
    return replace(
        settings.problem,
        start=advanced(start, (Stretch(0.0, turned, bends=True),), 0.0),
        radius_mm=_radius_mm(state, settings),
        radius_range_mm=settings.problem.radius_range_mm if state.insertion_mm == 0.0 else None,
        cavity_mm=settings.estimator.cavity_mm if math.isfinite(settings.estimator.cavity_every_mm) else 0.0,
        axis=(float(along[0]), float(along[1]), float(along[2])),
        max_off_axis_rad=settings.policy.max_off_axis_rad,
        max_length_mm=max(settings.problem.max_length_mm - from_mm, _HERE_MM),
        covariance=state.tip.covariance,
    )


def _planned(problem: PlanProblem, settings: SteeringSettings, *, thorough: bool) -> Plan:
    """Return the path that keeps most of the clearance that is wanted, or why there is none with the whole of it."""
    known = replace(problem, covariance=None)
    least_mm = min(settings.policy.least_clearance_mm, problem.clearance_mm)
    wide = replace(known, clearance_mm=least_mm, axis=None)
    plans = (_sought(one, settings, thorough=thorough) for one in (problem, known, wide))
    tried: list[Plan] = []
    for plan in plans:
        tried.append(plan)
        if plan.found:
            break
    return tried[-1]


def _sought(problem: PlanProblem, settings: SteeringSettings, *, thorough: bool) -> Plan:
    around = Surroundings(problem)
    if np.linalg.norm(around.target_mm) <= settings.policy.final_mm:
        weights = replace(problem.weights, target_error_per_mm=settings.policy.final_error_per_mm)
        psi = nearest_approach(Surroundings(replace(problem, weights=weights)))
        return Plan(found=False, reason="blocked near the target") if psi is None else plan_of(psi, around)
    return plan_path(problem, settings.method, thorough=thorough)


def _followed(
    state: SteeringState, plan: Plan, problem: PlanProblem, settings: SteeringSettings
) -> SteeringState:
    """Return the state with a path to follow: where to turn the bevel, and where the path ends."""
    from_mm = _acts_at(state.insertion_mm, settings)
    ends_mm = from_mm + np.cumsum([0.0, *(arc.length_mm for arc in plan.arcs)])
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
        end_mm=float(ends_mm[-1]) if plan.arcs else _nearest_mm(state, from_mm, settings),
        replans=state.replans + 1,
        followed_mm=state.insertion_mm,
    )


def _nearest_mm(state: SteeringState, to_mm: float, settings: SteeringSettings) -> float:
    """Return where the tip passes the target at its nearest, before a turn made now would act."""
    places_mm = np.linspace(state.insertion_mm, to_mm, _PLACES)
    tips = np.array([state.predicted(float(at_mm), settings)[:3, 3] for at_mm in places_mm])
    return float(places_mm[np.argmin(np.linalg.norm(tips - settings.problem.target_mm, axis=1))])


def _still_good(state: SteeringState, settings: SteeringSettings) -> bool:
    """Return whether the rest of the old path will do: it touches nothing, and what it misses by can be mended."""
    if not state.plan.found:
        return False
    miss_mm, gap_mm = _outlook(state, settings)
    recent = state.insertion_mm - state.followed_mm <= settings.policy.patience_mm
    mends = miss_mm <= settings.problem.tolerance_mm + _MENDED_SHARE * max(state.left_mm, 0.0)
    return (mends or recent) and gap_mm >= settings.policy.least_clearance_mm


def _commanded(state: SteeringState, settings: SteeringSettings) -> tuple[SteeringState, SteeringCommand]:
    """Return what to do next, and the state after it is done."""
    if state.refusal is not None:
        return state, _stopped(state, _refused_for(state, settings), state.refusal)
    if state.left_mm <= settings.policy.arrival_mm:
        return state, _arrived(state, settings)
    turned, roll_rad = _turned(state, settings)
    run_to_mm = turned.end_mm
    if turned.ahead:
        soonest_mm = turned.insertion_mm + settings.policy.lead_mm
        run_to_mm = min(max(turned.ahead[0].at_mm, soonest_mm), run_to_mm)
    looks = max(1, round((run_to_mm - turned.insertion_mm) / settings.policy.observe_every_mm))
    observe_at_mm = turned.insertion_mm + (run_to_mm - turned.insertion_mm) / looks
    return replace(turned, run_to_mm=run_to_mm), SteeringCommand(roll_rad, observe_at_mm, run_to_mm)


def _turned(state: SteeringState, settings: SteeringSettings) -> tuple[SteeringState, float]:
    """Return the state after the turns that are due, and their roll; the bevel is turned where the needle stands."""
    stands = state.insertion_mm >= state.run_to_mm - _HERE_MM
    due = [turn for turn in state.ahead if stands and turn.at_mm <= state.insertion_mm + _HERE_MM]
    roll_rad = math.remainder(sum(turn.roll_rad for turn in due), 2 * math.pi)
    if not due or abs(roll_rad) < _NO_TURN:
        return replace(state, ahead=state.ahead[len(due) :]), 0.0
    return replace(turned(state, roll_rad, settings), ahead=state.ahead[len(due) :]), roll_rad


def _arrived(state: SteeringState, settings: SteeringSettings) -> SteeringCommand:
    problem = settings.problem
    miss_mm = float(np.linalg.norm(state.tip.position_mm - problem.target_mm))
    reached = miss_mm <= problem.tolerance_mm
    detail = f"the tip is {miss_mm:.2f} mm from the target, and {problem.tolerance_mm:g} mm are allowed"
    return _stopped(state, "target_reached" if reached else "target_missed", detail)


def _refused_for(state: SteeringState, settings: SteeringSettings) -> StopReason:
    """Return whether it is the obstacles that leave no path."""
    free = replace(settings, problem=replace(settings.problem, obstacles=()))
    return "blocked" if _planned(_problem_ahead(state, free), free, thorough=True).found else "target_missed"


def _stopped(state: SteeringState, reason: StopReason, detail: str) -> SteeringCommand:
    return SteeringCommand(0.0, state.insertion_mm, state.insertion_mm, reason, detail)


def _acts_at(made_at_mm: float, settings: SteeringSettings) -> float:
    """Return the insertion length at which a turn of the bevel acts."""
    policy = settings.policy
    return max(made_at_mm + policy.backlash_mm / 2, policy.closing_mm / 2)


def _radius_mm(state: SteeringState, settings: SteeringSettings) -> float:
    """Return the estimated radius, as far as it can be believed."""
    given_mm = settings.problem.radius_mm
    least, most = 1 / (given_mm * _RADIUS_FACTOR), _RADIUS_FACTOR / given_mm
    return 1.0 / min(max(state.tip.curvature, least), most)
