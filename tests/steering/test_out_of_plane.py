"""What leads the needle out of the plane, against paths in space that are integrated step by step."""

import math
from dataclasses import replace

import numpy as np
import pytest

from labrig.steering.out_of_plane import OutOfPlaneSettings, budget_out_of_plane, covary_out_of_plane
from labrig.steering.torsion import RolledStretch, TorsionalLag
from tests.steering.test_torsion import find_lag_sd_mm

RADIUS_MM = 27.7
STEP_MM = 0.5
DRAWS = 4000


def only(heading_noise=0.0, start_mm=0.0, lean_rad=0.0, roll_zero_rad=0.0, lag_rad=0.0):
    """Return settings in which nothing else is uncertain; a lag of nothing is known to so much at every depth."""
    lag = TorsionalLag(best_sd_rad=lag_rad, per_mm_sd_rad=0.0)
    return OutOfPlaneSettings(heading_noise, start_mm, lean_rad, roll_zero_rad, lag)


STRAIGHT_MM = 1e9
# Half turns back and forth, and onward. The heading stays within 22 degrees: the budget is of first order.
BACK_AND_FORTH = ((8.0, 0.0, 1), (18.0, math.pi, 1), (20.0, 0.0, -1), (14.0, math.pi, 1))
ONWARD = ((8.0, 0.0, 1), (18.0, math.pi, 1), (20.0, 2 * math.pi, 1), (14.0, 3 * math.pi, 1))
AHEAD = ((60.0, 0.0, 0),)


def stretches(path):
    """Return a path as the module takes it."""
    return [RolledStretch(length_mm, roll_rad, turned) for length_mm, roll_rad, turned in path]


def integrate(path, radius_mm=RADIUS_MM, *, roll_rad=0.0, lag_rad=0.0, wander=0.0, lean_rad=0.0, seed=1):
    """Return the tips' x (DRAWS,) of full rotations, small step by small step; arguments are (DRAWS,) or numbers.

    The bevel follows its drive with play: it is dragged when the drive is more than the lag away from it.
    """
    random = np.random.default_rng(seed)
    tangent = np.outer(np.ones(DRAWS), (0.0, 0.0, 1.0))
    tangent[:, 0], tangent[:, 2] = np.sin(lean_rad), np.cos(lean_rad)
    x_mm = np.zeros(DRAWS)
    bevel = np.full(DRAWS, -math.pi)  # from below, so that the first turn is a positive one
    for length_mm, base_rad, _ in path:
        bevel = np.clip(bevel, base_rad - lag_rad, base_rad + lag_rad)
        for _ in range(round(length_mm / STEP_MM)):
            angle = bevel + roll_rad
            # The needle's own axes: across the plane, and in it, both square to the tangent.
            across = np.cross(np.array((0.0, 1.0, 0.0)), tangent)
            across /= np.linalg.norm(across, axis=1)[:, None]
            side = np.cross(tangent, across)
            turn = (np.sin(angle)[:, None] * across - np.cos(angle)[:, None] * side) * STEP_MM / radius_mm
            turn = turn + across * (wander * math.sqrt(STEP_MM) * random.standard_normal(DRAWS))[:, None]
            middle = tangent + 0.5 * turn
            x_mm += STEP_MM * (middle / np.linalg.norm(middle, axis=1)[:, None])[:, 0]
            tangent = tangent + turn
            tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    return x_mm


def draw(sd: float, seed: int):
    """Return normal draws (DRAWS,) of a standard deviation."""
    return sd * np.random.default_rng(seed).standard_normal(DRAWS)


@pytest.mark.parametrize(
    ("source", "path", "radius_mm", "settings", "drawn"),
    [
        ("roll_zero", BACK_AND_FORTH, RADIUS_MM, only(roll_zero_rad=0.035), {"roll_rad": draw(0.035, 3)}),
        ("torsion", BACK_AND_FORTH, RADIUS_MM, only(lag_rad=0.07), {"lag_rad": np.abs(draw(0.07, 4))}),
        ("torsion", ONWARD, RADIUS_MM, only(lag_rad=0.07), {"lag_rad": np.abs(draw(0.07, 4))}),
        ("heading_noise", AHEAD, STRAIGHT_MM, only(heading_noise=0.005), {"wander": 0.005}),
        ("start", AHEAD, STRAIGHT_MM, only(start_mm=0.3, lean_rad=0.01), {"lean_rad": draw(0.01, 5)}),
    ],
)
def test_each_source_spreads_the_tip_as_it_does_integrated_paths(source, path, radius_mm, settings, drawn):
    """Within 5 %; torsion as a bevel with play does, whichever way it turns."""
    x_mm = integrate(path, radius_mm, **drawn) + draw(settings.start_sd_mm, 6)
    budget = budget_out_of_plane(stretches(path), radius_mm, settings)
    spread_mm = math.sqrt(float(np.mean(x_mm**2)))
    assert budget.total_mm == getattr(budget, source) == pytest.approx(spread_mm, rel=0.05)


@pytest.mark.parametrize("path", [BACK_AND_FORTH, ONWARD])
def test_the_budget_knows_the_lag_by_depth_as_the_choice_of_turns_does(path):
    """What a measured lag leaves is the same for the budget as for the turns that are chosen by it."""
    lag = TorsionalLag(best_mm=50.0, best_sd_rad=0.02, per_mm_sd_rad=0.0005)
    known = replace(only(), lag=lag)
    left_mm = find_lag_sd_mm(stretches(path), lag, RADIUS_MM)
    assert budget_out_of_plane(stretches(path), RADIUS_MM, known).torsion == pytest.approx(left_mm)


def test_sources_add_up_as_squares():
    """Before the needle moves only the start is uncertain, and where nothing is, nothing adds up."""
    settings = only(0.002, 0.3, 0.01, 0.02, 0.03)
    budget = budget_out_of_plane(stretches(BACK_AND_FORTH), RADIUS_MM, settings)
    parts = (budget.roll_zero, budget.torsion, budget.heading_noise, budget.start)
    assert min(parts) > 0
    assert budget.total_mm == pytest.approx(math.sqrt(sum(part**2 for part in parts)))
    assert budget_out_of_plane([], RADIUS_MM, settings).total_mm == 0.3
    assert budget_out_of_plane(stretches(ONWARD), RADIUS_MM, only()).total_mm == 0.0


@pytest.mark.parametrize(
    ("turned", "lever_mm2"),
    [((0,), 30 * 15), ((1,), 30 * 15), ((0, 1), math.hypot(30 * 45, 30 * 15)), ((1, 1), 30 * 45 + 30 * 15)],
)
def test_a_lag_of_unknown_direction_counts_too(turned, lever_mm2):
    """Where the direction of the last turn is not known, the lag has its part, apart from that of the known ones."""
    path = [RolledStretch(30.0, 0.0, direction) for direction in turned]
    found_mm = budget_out_of_plane(path, RADIUS_MM, only(lag_rad=0.05)).torsion
    assert found_mm == pytest.approx(0.05 / RADIUS_MM * lever_mm2)


def test_places_along_the_needle_vary_as_integrated_paths_do():
    """The covariance along the needle is that of integrated paths that wander, within 6 %, and ends with the budget."""
    settings = only(0.003, 0.3, 0.01, 0.02, 0.03)
    at_mm = np.array([20.0, 60.0])
    covariance = covary_out_of_plane(stretches(BACK_AND_FORTH), RADIUS_MM, settings, at_mm)
    assert math.sqrt(covariance[1, 1]) == pytest.approx(
        budget_out_of_plane(stretches(BACK_AND_FORTH), RADIUS_MM, settings).total_mm
    )
    so_far = stretches((BACK_AND_FORTH[0], (12.0, *BACK_AND_FORTH[1][1:])))
    assert math.sqrt(covariance[0, 0]) == pytest.approx(
        budget_out_of_plane(so_far, RADIUS_MM, settings).total_mm
    )
    turns = np.random.default_rng(8).standard_normal((DRAWS, 120)) * 0.003 * math.sqrt(STEP_MM)
    x_mm = STEP_MM * np.cumsum(np.cumsum(turns, axis=1), axis=1)[:, [39, 119]]
    assert covary_out_of_plane([], STRAIGHT_MM, only(0.003), at_mm) == pytest.approx(np.cov(x_mm.T), rel=0.06)
