"""Plans reach their target, avoid obstacles and are the best ones found; refusals give the reason."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from labrig.errors import InputError
from labrig.needle.kinematics import path_frames, path_points, rotation_x
from labrig.steering.approach import find_nearest_approach
from labrig.steering.clearance import arc_distances, find_nearest_places, path_distances
from labrig.steering.mending import mend_paths
from labrig.steering.parameters import PlanWeights
from labrig.steering.planar import Tips, thin_tips
from labrig.steering.planner import plan_path, sample_path
from labrig.steering.problem import Obstacle, PlanProblem, Surroundings
from labrig.steering.score import find_least_rooms, pick_best_feasible
from tests.benchmarks.oracle import integrate_path, oracle_solves
from tests.benchmarks.planning_problems import (
    draw_planar_problem,
    draw_spatial_problems,
    draw_tunnel,
    find_faults,
)

TARGET = (0.0, 5.0, 100.0)
OBSTACLES = (Obstacle((0.0, -2.0, 35.0), 8.0), Obstacle((0.0, 6.0, 68.0), 8.0))


def _pose(rotation, position):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


@pytest.mark.parametrize("count", [2, 5, 9, 14])
def test_what_the_oracle_solves_is_solved(count):
    """Every problem that a stepwise search over a grid of angles solves is solved, with a path that passes a check."""
    rng = np.random.default_rng([count, 7])
    for problem in [draw_planar_problem(rng, count) for _ in range(8)]:
        if plan_path(problem).found:
            assert find_faults(problem) == []
        else:
            assert not oracle_solves(problem)


def test_blocked_free_plans_are_replaced_in_space():
    """In 3-D what has a witness path is solved, although its obstacle-free plan would collide, and is planned alike."""
    problems = draw_spatial_problems(10, seed=11)
    assert [find_faults(problem) for problem in problems] == [[]] * 10
    assert plan_path(problems[0]) == plan_path(problems[0])


@pytest.mark.parametrize(
    ("method", "planar", "target"),
    [
        ("best", True, TARGET),
        ("best", True, (1.9, 5.0, 100.0)),  # just within the tolerance of the plane
        ("paper", True, TARGET),
        ("paper", False, (8.0, 5.0, 95.0)),
    ],
)
def test_either_planner_keeps_to_all_limits(method, planar, target):
    """A path around two obstacles; in the plane delta_1 is 0 or pi and every later roll is pi."""
    problem = PlanProblem(target, OBSTACLES, planar=planar)
    plan = plan_path(problem, method)
    assert plan.found
    assert plan.target_error_mm <= problem.tolerance_mm
    assert plan.clearance_mm >= problem.clearance_mm - 1e-9
    assert plan.length_mm <= problem.max_length_mm
    first, *others = (arc.roll_rad for arc in plan.arcs)
    assert not planar or (first in (0.0, math.pi) and set(others) == {math.pi})


@pytest.mark.processors
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_distances_are_exact(seed):
    """The closed form is the least distance of densely sampled points, and never more."""
    rng = np.random.default_rng(seed)
    psi = np.column_stack((rng.uniform(0, 3, 3), rng.uniform(-np.pi, np.pi, 3)))
    centres = rng.uniform(-60, 60, (5, 3))
    points = path_points(psi, 27.6, np.linspace(0, 1, 4001))
    sampled = np.linalg.norm(points[:, :, None, :] - centres, axis=-1).min(axis=1)
    exact = arc_distances(psi, 27.6, centres)
    assert np.all(exact <= sampled + 1e-9)
    np.testing.assert_allclose(exact, sampled, atol=1e-2)
    np.testing.assert_allclose(path_distances(psi, 27.6, centres), exact.min(axis=0))
    np.testing.assert_allclose(arc_distances(psi[:1], 27.6, np.array([[0.0, -27.6, 0.0]])), 27.6)
    near = find_nearest_places(psi[None], 27.6, centres, path_frames(psi[None], 27.6))
    np.testing.assert_allclose(
        np.linalg.norm(near.places_mm[0] - centres, axis=-1), exact.min(axis=0), atol=1e-9
    )


@pytest.mark.processors
def test_a_plan_moves_with_its_frame():
    """Turning and moving the start, the target and the obstacles together changes no arc."""
    still = plan_path(PlanProblem(TARGET, OBSTACLES, planar=True))
    rotation, shift = Rotation.from_rotvec((0.7, -1.9, 2.1)).as_matrix(), np.array([10.0, -20.0, 5.0])
    spheres = (Obstacle(tuple(rotation @ o.position_mm + shift), o.radius_mm) for o in OBSTACLES)
    target, start = tuple(rotation @ TARGET + shift), _pose(rotation, shift)
    moved = PlanProblem(target, tuple(spheres), start=start, planar=True)
    plan = plan_path(moved)
    np.testing.assert_allclose(plan.psi, still.psi, atol=1e-6)
    np.testing.assert_allclose(plan.tip_mm, moved.target_mm, atol=1e-6)
    np.testing.assert_allclose(sample_path(moved, plan)[-1], plan.tip_mm, atol=1e-9)


@pytest.mark.processors
@pytest.mark.parametrize("method", ["best", "paper"])
@pytest.mark.parametrize("ahead_mm", [30.0, 60.0, 85.0, 90.0, 100.0])
def test_of_two_mirrored_paths_the_same_is_always_taken(method, ahead_mm):
    """A target straight ahead has paths that cost the same; rounding does not choose between them."""
    plans = [plan_path(PlanProblem((0.0, y_mm, ahead_mm), planar=True), method) for y_mm in (1e-13, -1e-13)]
    np.testing.assert_allclose(plans[0].psi, plans[1].psi, atol=1e-9)


@pytest.mark.parametrize(
    ("target", "spheres", "how", "reason"),
    [
        ((0.0, 0.0, -2.1), (), {}, "behind"),
        ((0.0, 25.0, 10.0), (), {}, "inside the turning circle"),
        ((0.0, 70.0, 10.0), (), {}, "90 degrees"),
        ((0.0, 0.0, 200.0), (), {"planar": False}, "too long: the target is 200"),
        ((2.1, 0.0, 100.0), (), {}, "outside of the steering plane"),
        (TARGET, (Obstacle((0.0, 9.0, 0.0), 8.0),), {}, "start is blocked by obstacle 1"),
        (TARGET, (OBSTACLES[0], Obstacle((0.0, 13.5, 100.0), 8.4)), {"tolerance_mm": 0.5},
         "target is blocked by obstacle 2"),
        (TARGET, (OBSTACLES[0], Obstacle((0.0, 0.0, 50.0), 45.0)), {}, "no path found with up to 6 arcs"),
        # It would be too long a way round.
        ((0.0, 0.0, 100.0), (), {"max_length_mm": 100.2, "tolerance_mm": 0.1, "max_arcs": 4},
         "no path found with up to 4 arcs and 100.2 mm"),
        (TARGET, (), {"max_arcs": 1}, "no path found with up to 1 arc and"),
    ],
)  # fmt: skip
def test_a_refusal_gives_its_reason(target, spheres, how, reason):
    """An unreachable target is refused with the cause, which names no impossibility but what was found."""
    plan = plan_path(PlanProblem(target, spheres, **{"planar": True, **how}))
    assert not plan.found
    assert reason in plan.reason
    assert plan.arcs == ()
    assert plan.length_mm is None


@pytest.mark.parametrize("roll_rad", [0.0, math.pi])
def test_what_one_arc_reaches_is_reached_by_it(roll_rad):
    """Also on the turning circle itself, as far as the tolerance from what is out of reach."""
    plan = plan_path(PlanProblem(tuple(integrate_path([(roll_rad, 1.0)], 27.6)[-1]), planar=True, max_arcs=1))
    np.testing.assert_allclose(plan.psi, [(1.0, roll_rad)], atol=1e-6)


@pytest.mark.parametrize(("y_mm", "z_mm"), [(0.0, 8.2), (8.2, 0.0), (-8.2, 0.0)])
def test_beside_an_obstacle_another_end_within_the_tolerance_will_do(y_mm, z_mm):
    """The target is a millimetre too near to it, and is not reached itself."""
    obstacle = Obstacle((0.0, TARGET[1] + y_mm, TARGET[2] + z_mm), 8.0)
    plan = plan_path(PlanProblem(TARGET, (obstacle,), planar=True), effort="closer")
    assert 1.0 < plan.target_error_mm <= 2.0


@pytest.mark.parametrize(
    "change",
    [
        {"target_mm": (0.0, math.nan, 100.0)},
        {"max_length_mm": math.inf},
        {"radius_mm": 0.0},
        {"radius_mm": 0.5},  # thicker than its arc
        {"diameter_mm": -1.2},
        {"tolerance_mm": -1.0},
        {"clearance_mm": -0.1},
        {"max_arcs": 0},
        {"obstacles": (Obstacle((0.0, 0.0, 50.0), 0.0),)},
        {"obstacles": (Obstacle((0.0, 1.0, 1.0), 3.0),)},  # the start is inside
        {"obstacles": (Obstacle((0.0, 5.0, 99.0), 3.0),)},  # the target is
        {"start": np.diag([1.0, 1.0, -1.0, 1.0])},
        {"radius_range_mm": (28.0, 30.0)},
    ],
)
def test_a_bad_problem_is_refused(change):
    """Before planning."""
    with pytest.raises(InputError):
        PlanProblem(**{"target_mm": TARGET, "planar": True, **change})


def test_the_margin_grows_with_the_covariance():
    """An uncertain pose keeps farther off, by two standard deviations of where the tip will be."""
    covariance = np.diag([0.09, 0.09, 0.09, 0.0004, 0.0004, 0.0004])
    problem = PlanProblem(TARGET, OBSTACLES, planar=True, covariance=covariance)
    assert problem.margin_mm == pytest.approx(2 * math.sqrt(0.09 + 0.04))
    assert plan_path(problem).clearance_mm >= problem.clearance_mm + problem.margin_mm - 1e-9


def test_a_target_at_the_tip_needs_no_arc():
    """Where the tip is within the tolerance and no path leads much nearer, the plan is to stay."""
    plan = plan_path(PlanProblem((0.0, 0.0, -1.0), OBSTACLES, planar=True))
    assert plan.found
    assert plan.arcs == ()
    assert plan.target_error_mm == pytest.approx(1.0)


def test_obstacles_off_the_plane_count_by_their_cut():
    """A sphere beside the plane narrows it by its cut with the plane, and one far away not at all."""
    free = plan_path(PlanProblem(TARGET, planar=True))
    middle = sample_path(PlanProblem(TARGET, planar=True), free)[60]
    near, far = (
        PlanProblem(TARGET, (Obstacle((out, float(middle[1]), float(middle[2])), 8.0),), planar=True)
        for out in (5.0, 30.0)
    )
    assert find_faults(near) == []
    assert not np.array_equal(plan_path(near).psi, free.psi)
    assert np.array_equal(plan_path(far).psi, free.psi)


@pytest.mark.parametrize(
    ("roll_rad", "y_mm", "z_mm", "away_rad"),
    [(0.0, 2.0, 33.0, 0.0), (math.pi, 2.0, 33.0, math.pi), (math.pi, 20.0, 16.0, 0.0)],
)
def test_the_room_is_the_clearance_of_the_tightest_bend(roll_rad, y_mm, z_mm, away_rad):
    """Of one arc that bends away from an obstacle, to where the path passes it; behind and off the plane is none."""
    behind, beside = Obstacle((0.0, 9.0, -2.0), 6.0), Obstacle((8.0, 0.0, 30.0), 6.0)
    spheres = (Obstacle((1.0, y_mm, z_mm), 6.0), behind, beside)
    around = Surroundings(PlanProblem((0.0, 0.0, 90.0), spheres, planar=True))
    psi = np.array([[(1.2, roll_rad)]])
    in_plane = integrate_path([(away_rad, 1.2)], around.problem.radius_mm) - (0.0, y_mm, z_mm)
    room_mm = np.linalg.norm(in_plane, axis=1).min() - math.sqrt(6.6**2 - 1.0)
    radius_mm = around.problem.radius_mm
    near = find_nearest_places(psi, radius_mm, around.centres_mm, path_frames(psi, radius_mm))
    assert find_least_rooms(near, around) == pytest.approx(room_mm, abs=1e-3)


@pytest.mark.parametrize(
    ("limit", "least"),
    [
        ("max_length_mm", 30.0),
        ("max_off_axis_rad", 30.0 / 27.6),
        ("tolerance_mm", 0.5),
        ("clearance_mm", 1.4),
    ],
)
def test_a_path_is_feasible_just_within_each_limit_and_not_beyond(limit, least):
    """An arc of 30 mm ends half a millimetre out of the plane of its target; it passes an obstacle 1.4 mm away."""
    psi = np.array([[(30.0 / 27.6, np.pi)]])
    half, end = (integrate_path([(np.pi, length / 27.6)], 27.6)[-1] for length in (15.0, 30.0))
    problem = PlanProblem((0.5, *end[1:]), (Obstacle((half[0] + 8.0, *half[1:]), 6.0),), axis=(0.0, 0.0, 1.0))
    for change, found in ((1e-3, True), (-1e-3, False)):
        value = least - change if limit == "clearance_mm" else least + change
        around = Surroundings(replace(problem, **{limit: value}))
        assert (pick_best_feasible([psi], around) is not None) == found


def test_the_side_with_room_is_taken():
    """A path that would bend away from the first obstacle all the way there gives way to one on its other side."""
    spheres = (Obstacle((0.0, 1.8, 28.1), 8.0), Obstacle((0.0, -4.4, 63.1), 8.0))
    problem = PlanProblem((0.0, -0.4, 96.4), spheres, radius_mm=27.7, cavity_mm=8.0, planar=True)
    careless = replace(problem, weights=PlanWeights(room_per_mm=0.0))
    careless_first, first = (plan_path(case, effort="quick").arcs[0] for case in (careless, problem))
    assert abs(careless_first.roll_rad) == pytest.approx(math.pi)
    assert first.roll_rad == pytest.approx(0.0)


def test_further_rounds_find_a_cheaper_path() -> None:
    """Between two obstacles, for a needle that may lean by 50 degrees."""
    obstacles, lean_rad = (Obstacle((0.0, 1.2, 29.2), 8.0), Obstacle((0.0, 10.9, 68.7), 8.0)), np.radians(50)
    problem = PlanProblem(
        (0.0, 13.5, 96.7),
        obstacles,
        planar=True,
        cavity_mm=8.0,
        axis=(0.0, 0.0, 1.0),
        max_off_axis_rad=lean_rad,
    )
    first, better = (plan_path(problem, effort=effort).psi for effort in ("thorough", "improving"))
    assert not np.array_equal(first, better)
    cheaper = pick_best_feasible([first[None], better[None]], Surroundings(problem))
    np.testing.assert_array_equal(cheaper, better)


def test_the_present_path_is_mended_and_compared():
    """A needle that strayed in a narrow tunnel gets a path by a quick search that knows its present path."""
    tunnel = draw_tunnel(np.random.default_rng(1), spare_mm=0.15)
    present = plan_path(tunnel).psi
    strayed = replace(tunnel, start=_pose(rotation_x(0.002), (0.0, 0.02, 0.0)))
    assert not plan_path(strayed, effort="quick").found
    kept = plan_path(strayed, effort="quick", present=present)
    assert kept.target_error_mm < strayed.tolerance_mm
    assert kept.clearance_mm >= strayed.clearance_mm - 1e-6


@pytest.mark.parametrize(
    ("arcs", "target", "spheres", "off_rad"), [(2, (0.0, 8.0, 60.0), (), 0.1), (4, TARGET, OBSTACLES, -0.08)]
)
def test_mending_reaches_the_target_off_the_obstacles_in_four_steps(arcs, target, spheres, off_rad):
    """By two arcs, which both have to change, and by four that touch two obstacles: the slopes are exact."""
    around = Surroundings(PlanProblem(target, spheres, planar=True, max_arcs=arcs))
    psi = plan_path(around.problem).psi[None].copy()
    psi[..., 0] += np.linspace(off_rad, -off_rad, arcs)
    mended, radius_mm = mend_paths(psi, around, 4), around.problem.radius_mm
    assert path_frames(mended, radius_mm).positions_mm[0, -1] == pytest.approx(target, abs=1e-6)
    assert np.all(path_distances(mended, radius_mm, around.centres_mm) > around.keep_off_mm)


def test_of_the_tips_in_a_cell_one_is_kept():
    """Whichever of place, heading and sign differs makes another cell."""
    random, count = np.random.default_rng(4), 4000
    places, headings = random.uniform(-3.0, 3.0, (2, count)), random.uniform(-0.3, 0.3, count)
    signs, keys = random.choice((-1.0, 1.0), count), np.arange(count, dtype=np.uint64)
    tips = Tips(places[0] + 1j * places[1], headings, signs, np.zeros((count, 1)), keys)
    cells = np.unique(np.round(np.vstack((places / 1.2, headings / 0.06, signs))), axis=1)
    assert len(thin_tips(tips, 1.2, 0.06, count).places) == cells.shape[1] < count


@pytest.mark.parametrize("planar", [True, False], ids=["planar", "spatial"])
def test_a_tolerance_of_the_radius_buys_robustness(planar):
    """With its tolerance in the plan the worst radius misses by less, and the stated worst miss is the true one."""
    known = PlanProblem(TARGET, OBSTACLES, radius_mm=30.0, planar=planar)
    robust = plan_path(replace(known, radius_range_mm=(27.6, 32.9)))

    def miss_mm(psi: np.ndarray, radius_mm: float) -> float:
        path = integrate_path([(roll, angle * 30.0 / radius_mm) for angle, roll in psi], radius_mm)
        return float(np.linalg.norm(path[-1] - TARGET))

    worst_mm = max(miss_mm(robust.psi, end_mm) for end_mm in (27.6, 32.9))
    assert robust.worst_target_error_mm == pytest.approx(worst_mm, abs=1e-3)
    assert worst_mm <= max(miss_mm(plan_path(known).psi, end_mm) for end_mm in (27.6, 32.9))


def test_a_narrow_tunnel_takes_a_thorough_search():
    """A tunnel with 0.05 mm to spare on each side is not passed quickly, and is passed without a fault thoroughly."""
    problem = draw_tunnel(np.random.default_rng([7, 0, 0]), 0.05)
    assert not plan_path(problem, effort="quick").found
    assert find_faults(problem) == []


RADIUS_MM = 27.6


@pytest.mark.parametrize(
    ("planar", "target", "expected", "miss_mm"),
    [
        (True, [(0.0, 6.0)], [(6.0, 0.0)], 0.0),
        (True, [(math.pi, 6.0)], [(6.0, math.pi)], 0.0),
        (False, [(3 * math.pi / 8, 6.0)], [(6.0, 3 * math.pi / 8)], 0.0),
        # a turn costs as much as 0.4 mm beside the target
        (True, [(math.pi, 3.1)], [(3.06, 0.0)], 0.346),
        (True, [(math.pi, 3.5)], [(3.5, math.pi)], 0.0),
        (True, [(0.0, 4.0), (math.pi, 8.0)], [(3.82, 0.0), (8.16, math.pi)], 0.104),
        # a first arc as short as the finest that is tried
        (
            False,
            [(math.pi / 2, 1.334), (math.pi / 2, 40.0)],
            [(1.334, math.pi / 2), (40.0, math.pi / 2)],
            0.0,
        ),
        # to go on and then turn comes nearly there with a turn less
        (False, [(math.pi, 4.0), (math.pi, 8.0)], [(2.97, 0.0), (9.03, math.pi)], 0.056),
    ],
)
def test_the_tip_comes_as_near_as_a_turn_is_worth(planar, target, expected, miss_mm):
    """Targets at the ends of paths of arcs (roll, length) are reached by arcs (length, roll), or nearly reached."""
    end_mm = integrate_path([(roll, length / RADIUS_MM) for roll, length in target], RADIUS_MM)[-1]
    problem = PlanProblem(tuple(end_mm), radius_mm=RADIUS_MM, planar=planar)
    path = find_nearest_approach(Surroundings(problem), 10.0)
    np.testing.assert_allclose(path * (RADIUS_MM, 1.0), expected, atol=0.01)
    reached_mm = integrate_path([(roll, angle) for angle, roll in path], RADIUS_MM)[-1]
    assert np.linalg.norm(reached_mm - end_mm) == pytest.approx(miss_mm, abs=0.002)


def test_no_approach_is_longer_than_the_needle_may_go():
    """The target lies 8 mm ahead, and 6 mm are left: the needle stops there."""
    around = Surroundings(PlanProblem((0.0, 0.0, 8.0), planar=True, max_length_mm=6.0))
    assert 27.6 * find_nearest_approach(around, 40.0)[:, 0].sum() == pytest.approx(6.0)


@pytest.mark.parametrize(("beside_mm", "free"), [(3.19, False), (3.21, True)])
def test_what_comes_too_near_to_an_obstacle_does_not_count(beside_mm, free):
    """Beside half the needle's 1.2 mm and a sphere of 2 mm it keeps its clearance off."""
    sphere = Obstacle((beside_mm, 0.0, 0.0), 2.0)
    problem = PlanProblem((0.0, 0.0, 6.0), (sphere,), radius_mm=RADIUS_MM, clearance_mm=0.6, planar=False)
    assert (find_nearest_approach(Surroundings(problem), 10.0) is not None) == free
