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
from typing import Literal, Self

import numpy as np

from labrig.errors import InputError
from labrig.needle import path_frames
from labrig.steering.approach import nearest_approach
from labrig.steering.bending import Stretch, Turn, advanced, stretches
from labrig.steering.clearance import path_distances
from labrig.steering.estimator import advance_tip, start_tip, step_tip
from labrig.steering.planner import Plan, plan_of, plan_path
from labrig.steering.problem import PlanMethod, PlanProblem, Surroundings
from labrig.steering.tip import EstimatorSettings, FloatArray, TipObservation, TipState, frozen, numbers

Occasion = Literal["start", "schedule", "deviation", "near"]
StopReason = Literal["target_reached", "target_missed", "blocked", "needle_lost", "needle_stuck"]

# An estimated radius is believed within this factor of the one that was given.
_RADIUS_FACTOR = 1.5
_HERE_MM = 0.02
_NO_TURN = 1e-9
_PLACES = 16


@dataclass(frozen=True)
class SteeringPolicy:
    """When the path is planned anew, and what is known of the needle beyond its arcs.

    Parameters
    ----------
    replan_every_mm : float
    deviation_mm, deviation_share : float
        Plan anew where the path that is left would miss the target by more than the one and the other times what
        is left of it; infinite: never for that.
    near_mm : float
        Plan anew at every sighting where no more than this is left.
    final_mm : float
        Take what comes nearest to the target where no more than this is left.
    observe_every_mm : float
    backlash_mm : float
        Length along which the curvature swings over after a turn of the bevel.
    closing_mm : float
        Length along which the hinges close after the start.
    lead_mm : float
        A turn that is found while the needle moves is made no sooner than after this length.
    arrival_mm : float
        What is left of a path is no longer driven below this.
    most_misses : int
        So many sightings in a row without a tip, or with one that is not believed, and the needle is lost.
    stuck_mm : float
        The needle is stuck where it was inserted by this and its tip seen to move by less than half of it.
    least_clearance_mm : float
        Where no path keeps the clearance asked for, disturbances having used it up, one is taken that keeps this.
    """

    replan_every_mm: float = 20.0
    deviation_mm: float = 0.4
    deviation_share: float = 0.02
    near_mm: float = 30.0
    final_mm: float = 12.0
    observe_every_mm: float = 1.0
    backlash_mm: float = 1.5
    closing_mm: float = 3.0
    lead_mm: float = 0.2
    arrival_mm: float = 0.05
    most_misses: int = 8
    stuck_mm: float = 4.0
    least_clearance_mm: float = 0.2

    def __post_init__(self) -> None:
        """Refuse what is no length."""
        for name in ("replan_every_mm", "observe_every_mm", "arrival_mm", "most_misses", "stuck_mm"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} is {getattr(self, name):g}, it must be above 0")
        for name in (
            "deviation_mm",
            "deviation_share",
            "near_mm",
            "final_mm",
            "backlash_mm",
            "closing_mm",
            "lead_mm",
        ):
            if not getattr(self, name) >= 0:
                raise InputError(f"{name} is {getattr(self, name):g}, it must be 0 or more")

    @classmethod
    def paper(cls) -> Self:
        """Return the paper's: plan anew every 20 mm, as if a turn acted at once, and follow the plan to its end."""
        return cls(deviation_mm=math.inf, near_mm=0.0, final_mm=0.0, backlash_mm=0.0, closing_mm=0.0)


@dataclass(frozen=True)
class SteeringSettings:
    """What is to be reached and around what, how the tip is estimated, and the policy.

    Parameters
    ----------
    problem : PlanProblem
        As it stands before the insertion; `start` is the tip's pose, its roll the bevel's.
    estimator : EstimatorSettings
    policy : SteeringPolicy
    method : {"best", "paper"}
        The planner.
    """

    problem: PlanProblem
    estimator: EstimatorSettings
    policy: SteeringPolicy = SteeringPolicy()
    method: PlanMethod = "best"

    def __post_init__(self) -> None:
        """Refuse a planner and a filter that do not speak of the same needle."""
        if self.problem.planar != self.estimator.planar:
            raise InputError("planner and estimator differ about planar", "set both or none")


@dataclass(frozen=True, eq=False)
class TipSighting:
    """An insertion length, and where the tip was seen there.

    Parameters
    ----------
    insertion_mm : float
        How far the needle has been inserted beyond the start.
    position_mm : (3,) array or None
        In the world frame; None where the tip was not found.
    """

    insertion_mm: float
    position_mm: FloatArray | None

    def __post_init__(self) -> None:
        """Refuse what is no number."""
        if not math.isfinite(self.insertion_mm):
            raise InputError(f"insertion_mm is {self.insertion_mm:g}, it must be a number")
        if self.position_mm is not None:
            object.__setattr__(self, "position_mm", frozen(numbers("position_mm", self.position_mm, (3,))))


@dataclass(frozen=True)
class SteeringCommand:
    """What to do next: stop, or turn the bevel, then run on and look.

    Attributes
    ----------
    roll_rad : float
        Turn the bevel by this first, the needle standing; 0: do not.
    observe_at_mm : float
        Insertion length at which to look next.
    run_to_mm : float
        Insertion length up to which the needle may run; there it stands, as a turn or the end of the path follows.
    stop : str or None
        Why the needle stops here; None while it goes on.
    detail : str
        A sentence about it; empty while the needle goes on.
    """

    roll_rad: float
    observe_at_mm: float
    run_to_mm: float
    stop: StopReason | None = None
    detail: str = ""


@dataclass(frozen=True, eq=False)
class SteeringState:
    """What is known of the insertion.

    Attributes
    ----------
    tip : TipState
        At the last sighting.
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
    planned_at_mm : float
        Insertion length at which a path was sought last.
    why : str or None
        On which occasion a path was sought at this sighting; None where none was.
    refusal : str or None
        Why none was found there; None where one was, or none was sought.
    run_to_mm : float
        The last command's.
    moving_from : (float, array)
        Insertion length and place at which the tip was last known to move.
    """

    tip: TipState
    insertion_mm: float
    turns: tuple[Turn, ...]
    plan: Plan
    plan_start: FloatArray
    plan_from_mm: float
    ahead: tuple[Turn, ...]
    end_mm: float
    replans: int
    planned_at_mm: float
    why: Occasion | None
    refusal: str | None
    run_to_mm: float
    moving_from: tuple[float, FloatArray]

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
    tip = start_tip(settings.problem.start, settings.estimator)
    none = Plan(found=False, reason=None)
    state = SteeringState(
        tip=tip, insertion_mm=0.0, turns=(), plan=none, plan_start=tip.pose, plan_from_mm=0.0, ahead=(), end_mm=0.0,
        replans=-1, planned_at_mm=0.0, why=None, refusal=None, run_to_mm=0.0,
        moving_from=(0.0, tip.position_mm),
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
    tip = state.tip
    for step in steps:
        tip = advance_tip(tip, step, settings.estimator)
    tip = step_tip(tip, replace(last, position_mm=sighting.position_mm), settings.estimator)
    from_mm, place = state.moving_from
    if (
        sighting.position_mm is not None
        and np.linalg.norm(sighting.position_mm - place) >= settings.policy.stuck_mm / 2
    ):
        from_mm, place = sighting.insertion_mm, sighting.position_mm
    return replace(
        state,
        tip=tip,
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
    if policy.near_mm > 0 and state.left_mm <= policy.near_mm:
        return "near"
    if state.insertion_mm - state.planned_at_mm >= policy.replan_every_mm - _HERE_MM:
        return "schedule"
    if math.isfinite(policy.deviation_mm):
        miss_mm, gap_mm = _outlook(state, settings)
        limit_mm = policy.deviation_mm + policy.deviation_share * state.left_mm
        if miss_mm > limit_mm or gap_mm < settings.problem.clearance_mm:
            return "deviation"
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
    plan = _planned(problem, settings)
    if plan.found:
        return _followed(sought, plan, problem, settings)
    return sought if _still_good(state, settings) else replace(sought, refusal=plan.reason)


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
    return replace(
        settings.problem,
        start=advanced(start, (Stretch(0.0, turned, bends=True),), 0.0),
        radius_mm=_radius_mm(state, settings),
        max_length_mm=max(settings.problem.max_length_mm - from_mm, _HERE_MM),
        covariance=state.tip.covariance,
    )


def _planned(problem: PlanProblem, settings: SteeringSettings) -> Plan:
    """Return the path that keeps most of the clearance that is wanted, or why there is none with the whole of it."""
    known = replace(problem, covariance=None)
    least_mm = min(settings.policy.least_clearance_mm, problem.clearance_mm)
    plans = (_sought(one, settings) for one in (problem, known, replace(known, clearance_mm=least_mm)))
    first = next(plans)
    return first if first.found else next((plan for plan in plans if plan.found), first)


def _sought(problem: PlanProblem, settings: SteeringSettings) -> Plan:
    around = Surroundings(problem)
    if np.linalg.norm(around.target_mm) <= settings.policy.final_mm:
        psi = nearest_approach(around)
        return Plan(found=False, reason="blocked near the target") if psi is None else plan_of(psi, around)
    return plan_path(problem, settings.method)


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
    )


def _nearest_mm(state: SteeringState, to_mm: float, settings: SteeringSettings) -> float:
    """Return where the tip passes the target at its nearest, before a turn made now would act."""
    places_mm = np.linspace(state.insertion_mm, to_mm, _PLACES)
    tips = np.array([state.predicted(float(at_mm), settings)[:3, 3] for at_mm in places_mm])
    return float(places_mm[np.argmin(np.linalg.norm(tips - settings.problem.target_mm, axis=1))])


def _still_good(state: SteeringState, settings: SteeringSettings) -> bool:
    """Return whether the rest of the old path still reaches the target and touches nothing."""
    if not state.plan.found:
        return False
    miss_mm, gap_mm = _outlook(state, settings)
    return miss_mm <= settings.problem.tolerance_mm and gap_mm >= settings.policy.least_clearance_mm


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
    return "blocked" if _planned(_problem_ahead(state, free), free).found else "target_missed"


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
