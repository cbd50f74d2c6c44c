"""OMPL's control RRT on the needle's model: in the plane, curvature plus or minus one over the radius."""

import math

from ompl import base, control, util

from labrig.steering.problem import PlanProblem

STEP_MM = 1.0
SHORTEST, LONGEST = 2, 40

util.setLogLevel(util.LOG_ERROR)


def rrt_solves(problem: PlanProblem, limit_s: float) -> bool:
    """Return whether the RRT finds a path within the tolerance in time."""
    space = base.SE2StateSpace()
    bounds = base.RealVectorBounds(2)
    for axis, (low, high) in enumerate(((-30.0, 30.0), (0.0, 106.0))):
        bounds.setLow(axis, low)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    steering = control.RealVectorControlSpace(space, 1)
    sides = base.RealVectorBounds(1)
    sides.setLow(-1.0)
    sides.setHigh(1.0)
    steering.setBounds(sides)
    setup = control.SimpleSetup(steering)
    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(lambda state: _clear(problem, state.getX(), state.getY()))
    setup.setStatePropagator(
        lambda state, sign, duration, result: _move(problem.radius_mm, state, sign[0], duration, result)
    )
    information.setPropagationStepSize(STEP_MM)
    information.setMinMaxControlDuration(SHORTEST, LONGEST)
    start, goal = space.allocState(), space.allocState()
    start.setX(0.0), start.setY(0.0), start.setYaw(0.0)
    goal.setX(problem.target_mm[1]), goal.setY(problem.target_mm[2]), goal.setYaw(0.0)
    setup.setStartState(start)
    setup.setGoal(_Target(information, problem))
    setup.setPlanner(control.RRT(information))
    return setup.solve(limit_s).asString() == "Exact solution"


class _Target(base.GoalRegion):  # type: ignore[misc] # OMPL is untyped
    def __init__(self, information: control.SpaceInformation, problem: PlanProblem) -> None:
        super().__init__(information)
        self._y, self._z = problem.target_mm[1:]
        self.setThreshold(problem.tolerance_mm)

    def distanceGoal(self, state: base.State) -> float:  # noqa: N802 - OMPL's name
        return math.hypot(state.getX() - self._y, state.getY() - self._z)


def _clear(problem: PlanProblem, y: float, z: float) -> bool:
    gap = problem.diameter_mm / 2 + problem.clearance_mm
    return all(
        math.hypot(y - o.position_mm[1], z - o.position_mm[2]) >= o.radius_mm + gap for o in problem.obstacles
    )


def _move(radius: float, state: base.State, sign: float, length: float, result: base.State) -> None:
    side = math.copysign(1.0, sign)
    heading = state.getYaw()
    turned = heading + side * length / radius
    result.setX(state.getX() + side * radius * (math.cos(heading) - math.cos(turned)))
    result.setY(state.getY() + side * radius * (math.sin(turned) - math.sin(heading)))
    result.setYaw(turned)
