"""The last millimetres: which of the few manoeuvres that are left brings the tip nearest to the target."""

import math

import numpy as np
import pytest

from labrig.steering.approach import find_nearest_approach
from labrig.steering.problem import Obstacle, PlanProblem, Surroundings
from tests.benchmarks.oracle import integrate_path

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


@pytest.mark.parametrize(("beside_mm", "free"), [(3.19, False), (3.21, True)])
def test_what_comes_too_near_to_an_obstacle_does_not_count(beside_mm, free):
    """Beside half the needle's 1.2 mm and a sphere of 2 mm it keeps its clearance off."""
    sphere = Obstacle((beside_mm, 0.0, 0.0), 2.0)
    problem = PlanProblem((0.0, 0.0, 6.0), (sphere,), radius_mm=RADIUS_MM, clearance_mm=0.6, planar=False)
    assert (find_nearest_approach(Surroundings(problem), 10.0) is not None) == free
