"""The next path of a needle on its way: from where a turn of the bevel would act, with as much clearance as there is.

While the needle moves, the planner searches quickly only. If that finds nothing and the old path will not do, the
needle halts, and the planner searches thoroughly.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from labrig.errors import InputError
from labrig.needle.kinematics import FloatArray, path_frames
from labrig.steering.approach import find_nearest_approach
from labrig.steering.cavities import CAVITY_MM
from labrig.steering.clearance import path_distances
from labrig.steering.motion import Turn
from labrig.steering.planner import Effort, Plan, make_plan, plan_path
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import PlanProblem, Surroundings
from labrig.steering.state import HERE_MM, NO_TURN, Occasion, SteeringState

# An estimated radius counts within this factor of the given radius.
_RADIUS_FACTOR = 1.5
_PLACES = 16
# Share of the rest of a path that the needle can correct sideways later, with curvature to spare.
_CORRECTED_SHARE = 0.05
# The needle follows the old path for this length if that would miss and no new path is found.
_PATIENCE_MM = 15.0
# In the last millimetres: the cost of a millimetre of miss against that of the turns.
_FINAL_ERROR_PER_MM = 40.0
_BLOCKED = Plan(found=False, reason="blocked near the target", cause="blocked")


def replan(
    state: SteeringState, occasion: Occasion, settings: SteeringSettings, known: FloatArray | None = None
) -> SteeringState:
    """Return the state with a new path, with the old path if it will do, or with the reason why there is none.

    `known` is a path (n, 2) that may do at the start, in the place of the old one.
    """
    tried = replace(state, why=occasion, planned_at_mm=state.insertion_mm, sought=None)
    stands = occasion == "start" or state.sought is not None
    try:
        problem = pose_problem_ahead(state, settings)
    except InputError as error:
        refused = Plan(found=False, reason=error.message, cause="blocked")
        return replace(tried, refusal=refused) if stands else replace(tried, sought=occasion)
    present = _psi_ahead(state, settings) if state.plan.found else known
    thorough: Effort = "improving" if known is None else "thorough"
    plan = plan_with_clearance(problem, settings, thorough if stands else "quick", present)
    if plan.found:
        return _follow(tried, plan, problem, settings)
    if _is_still_good(state, settings):
        return tried
    return replace(tried, refusal=plan) if stands else replace(tried, sought=occasion)


def predict_miss_and_gap(state: SteeringState, settings: SteeringSettings) -> tuple[float, float]:
    """Return by how much the rest of the path would miss, and its smallest gap to an obstacle [mm]."""
    problem, radius_mm = settings.problem, _bounded_radius_mm(state, settings)
    start, psi = _predict_start(state, settings), _psi_ahead(state, settings)
    frames = path_frames(psi, radius_mm)
    obstacles_mm = [obstacle.position_mm for obstacle in problem.obstacles]
    places_mm = (np.array((problem.target_mm, *obstacles_mm)) - start[:3, 3]) @ start[:3, :3]
    miss_mm = math.dist(frames.positions_mm[-1], places_mm[0])
    apart_mm = path_distances(psi, radius_mm, places_mm[1:], frames)
    return miss_mm, float((apart_mm - Surroundings(problem).needle_and_obstacle_mm).min(initial=math.inf))


def _predict_start(state: SteeringState, settings: SteeringSettings) -> FloatArray:
    """Return the tip's pose (4, 4) where a turn of the bevel would act, with the turns that act there."""
    from_mm = settings.policy.find_acting_mm(state.insertion_mm)
    turned_rad = sum(turn.roll_rad for turn in state.turns if turn.at_mm == from_mm)
    return state.predict(from_mm, settings, turned_rad)


def pose_problem_ahead(state: SteeringState, settings: SteeringSettings) -> PlanProblem:
    """Return the rest of the problem, from where a turn of the bevel would act.

    Raises
    ------
    InputError
        When the tip or the target would be inside an obstacle.
    """
    from_mm = settings.policy.find_acting_mm(state.insertion_mm)
    along = np.asarray(settings.problem.start)[:3, 2]
    return replace(
        settings.problem,
        start=_predict_start(state, settings),
        radius_mm=_bounded_radius_mm(state, settings),
        radius_range_mm=settings.problem.radius_range_mm if state.insertion_mm == 0.0 else None,
        cavity_mm=0.0 if settings.estimator.cavity_every_mm is None else CAVITY_MM,
        axis=(float(along[0]), float(along[1]), float(along[2])),
        max_off_axis_rad=math.radians(settings.policy.max_off_axis_deg),
        max_length_mm=max((settings.problem.max_length_mm - from_mm) * (1.0 - state.tip.slip), HERE_MM),
        covariance=state.tip.covariance,
    )


def plan_with_clearance(
    problem: PlanProblem, settings: SteeringSettings, effort: Effort, present: FloatArray | None = None
) -> Plan:
    """Return a path with as much of the required clearance as possible, or the last reason why there is none.

    `present` is the path that the needle follows, as in `plan_path`.
    """
    for relaxed in _relax(problem, settings):
        plan = _plan(relaxed, settings, effort, present)
        if plan.found:
            break
    return plan


def _relax(problem: PlanProblem, settings: SteeringSettings) -> Iterator[PlanProblem]:
    """Yield the problem, and then with less and less clearance."""
    yield problem
    yield (without_margin := replace(problem, covariance=None, obstacle_sds_mm=()))
    least_mm = min(settings.policy.least_clearance_mm, problem.clearance_mm)
    yield replace(without_margin, clearance_mm=least_mm, axis=None)


def _psi_ahead(state: SteeringState, settings: SteeringSettings) -> FloatArray:
    """Return the rest of the path (n, 2) from where a turn would act."""
    from_mm = settings.policy.find_acting_mm(state.insertion_mm)
    per_mm = (1.0 - state.tip.slip) / _bounded_radius_mm(state, settings)
    acting_mm = [max(settings.policy.find_acting_mm(turn.at_mm), from_mm) for turn in state.ahead]
    stretches = pairwise((from_mm, *acting_mm, max(state.end_mm, from_mm)))
    arcs = zip(stretches, (0.0, *(turn.roll_rad for turn in state.ahead)), strict=True)
    return np.array([(max(end - start, 0.0) * per_mm, roll_rad) for (start, end), roll_rad in arcs])


def _plan(
    problem: PlanProblem, settings: SteeringSettings, effort: Effort, present: FloatArray | None
) -> Plan:
    around = Surroundings(problem)
    if np.linalg.norm(around.target_mm) <= settings.policy.final_mm:
        psi = find_nearest_approach(around, _FINAL_ERROR_PER_MM)
        return _BLOCKED if psi is None else make_plan(psi, around)
    return plan_path(problem, settings.method, effort, present)


def _follow(
    state: SteeringState, plan: Plan, problem: PlanProblem, settings: SteeringSettings
) -> SteeringState:
    """Return the state with a new path: where to turn the bevel, and where the path ends."""
    from_mm = settings.policy.find_acting_mm(state.insertion_mm)
    ends_mm = from_mm + np.cumsum([0.0, *(arc.length_mm for arc in plan.arcs)]) / (1.0 - state.tip.slip)
    turns = tuple(
        Turn(
            float(at_mm) - settings.policy.backlash_mm / 2 if at_mm > from_mm else state.insertion_mm,
            arc.roll_rad,
        )
        for at_mm, arc in zip(ends_mm[:-1], plan.arcs, strict=True)
        if abs(math.sin(arc.roll_rad / 2)) > NO_TURN
    )
    end_mm = float(ends_mm[-1]) if plan.arcs else _find_nearest_mm(state, from_mm, settings)
    return replace(
        state,
        plan=plan,
        plan_start=np.asarray(problem.start),
        plan_from_mm=from_mm,
        ahead=turns,
        end_mm=min(end_mm, settings.problem.max_length_mm),
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
    miss_mm, gap_mm = predict_miss_and_gap(state, settings)
    recent = state.insertion_mm - state.followed_mm <= _PATIENCE_MM
    can_correct = miss_mm <= settings.problem.tolerance_mm + _CORRECTED_SHARE * max(state.left_mm, 0.0)
    return (can_correct or recent) and gap_mm >= settings.policy.least_clearance_mm


def _bounded_radius_mm(state: SteeringState, settings: SteeringSettings) -> float:
    """Return the estimated radius, within bounds about the given radius."""
    given_mm = settings.problem.radius_mm
    least, most = 1 / (given_mm * _RADIUS_FACTOR), _RADIUS_FACTOR / given_mm
    return 1.0 / min(max(state.tip.curvature, least), most)
