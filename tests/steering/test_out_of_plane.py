"""What leads the needle out of the plane, against paths in space that are integrated step by step."""

import math

import numpy as np
import pytest

from labrig.steering.out_of_plane import OutOfPlaneSettings, budget_out_of_plane, covary_out_of_plane
from labrig.steering.torsion import RolledStretch, TorsionalLag
from tests.steering.test_torsion import find_lag_sd_mm

RADIUS_MM = 27.7
STEP_MM = 0.5
DRAWS = 4000


def known_to(sd_rad: float) -> TorsionalLag:
    """Return a lag of nothing, known to so much at every depth."""
    return TorsionalLag(best_sd_rad=sd_rad, per_mm_sd_rad=0.0)


NOTHING = OutOfPlaneSettings(0.0, 0.0, 0.0, 0.0, known_to(0.0))
STRAIGHT_MM = 1e9
# Half turns back and forth, and onward. The heading stays within 22 degrees: the budget is of first order.
BACK_AND_FORTH = ((8.0, 0.0, 1), (18.0, math.pi, 1), (20.0, 0.0, -1), (14.0, math.pi, 1))
ONWARD = ((8.0, 0.0, 1), (18.0, math.pi, 1), (20.0, 2 * math.pi, 1), (14.0, 3 * math.pi, 1))


def stretches(path):
    """Return a path as the module takes it."""
    return [RolledStretch(length_mm, roll_rad, turned) for length_mm, roll_rad, turned in path]


def integrate(path, radius_mm=RADIUS_MM, *, roll_rad=0.0, lag_rad=0.0, wander=0.0, lean_rad=0.0, seed=1):
    """Return the tips' x (DRAWS,) of full rotations, small step by small step; arguments are (DRAWS,) or numbers.

    The bevel follows its drive with play: it is dragged when the drive is more than the lag away from it.
    """
    random = np.random.default_rng(seed)
    tangent = np.stack(
        [np.sin(lean_rad) * np.ones(DRAWS), np.zeros(DRAWS), np.cos(lean_rad) * np.ones(DRAWS)], 1
    )
    x_mm = np.zeros(DRAWS)
    bevel = np.full(DRAWS, -math.pi)  # from below, so that the first turn is a positive one
    for length_mm, base_rad, _ in path:
        bevel = np.clip(bevel, base_rad - lag_rad, base_rad + lag_rad)
        steps = round(length_mm / STEP_MM)
        for _ in range(steps):
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


def test_an_error_of_the_roll_zero_turns_the_path_about_its_start() -> None:
    """The spread by the roll zero is that of integrated paths, within 5 %."""
    sd_rad = math.radians(2)
    x_mm = integrate(BACK_AND_FORTH, roll_rad=sd_rad * np.random.default_rng(3).standard_normal(DRAWS))
    budget = budget_out_of_plane(
        stretches(BACK_AND_FORTH), RADIUS_MM, OutOfPlaneSettings(0.0, 0.0, 0.0, sd_rad, known_to(0.0))
    )
    assert budget.total_mm == budget.roll_zero == pytest.approx(x_mm.std(), rel=0.05)


@pytest.mark.parametrize("path", [BACK_AND_FORTH, ONWARD])
def test_the_lag_adds_up_when_the_bevel_turns_back_and_forth(path) -> None:
    """The spread by torsion is that of a bevel with play, whichever way it turns, within 5 %."""
    lag_rad = np.abs(math.radians(4) * np.random.default_rng(4).standard_normal(DRAWS))
    x_mm = integrate(path, lag_rad=lag_rad)
    budget = budget_out_of_plane(
        stretches(path), RADIUS_MM, OutOfPlaneSettings(0.0, 0.0, 0.0, 0.0, known_to(math.radians(4)))
    )
    spread_mm = math.sqrt(float(np.mean(x_mm**2)))
    assert budget.total_mm == budget.torsion == pytest.approx(spread_mm, rel=0.05)


@pytest.mark.parametrize("path", [BACK_AND_FORTH, ONWARD])
def test_the_budget_knows_the_lag_by_depth_as_the_choice_of_turns_does(path) -> None:
    """What a measured lag leaves is the same for the budget as for the turns that are chosen by it."""
    lag = TorsionalLag(best_mm=50.0, best_sd_rad=0.02, per_mm_sd_rad=0.0005)
    known = OutOfPlaneSettings(0.0, 0.0, 0.0, 0.0, lag)
    left_mm = find_lag_sd_mm(stretches(path), lag, RADIUS_MM)
    assert budget_out_of_plane(stretches(path), RADIUS_MM, known).torsion == pytest.approx(left_mm)


def test_back_and_forth_is_the_worst_way_to_turn() -> None:
    """With the same lag, turning back and forth leads out of the plane several times further than turning on."""
    settings = OutOfPlaneSettings(0.0, 0.0, 0.0, 0.0, known_to(math.radians(5)))
    there, onward = (
        budget_out_of_plane(stretches(path), RADIUS_MM, settings) for path in (BACK_AND_FORTH, ONWARD)
    )
    assert there.torsion > 3 * onward.torsion


def test_wandering_out_of_the_plane_spreads_with_the_length_to_the_power_of_three_halves() -> None:
    """The spread by the heading's noise is that of integrated paths, within 5 %."""
    noise = math.radians(0.3)
    budget = budget_out_of_plane(
        [RolledStretch(60.0, 0.0, 0)], STRAIGHT_MM, OutOfPlaneSettings(noise, 0.0, 0.0, 0.0, known_to(0.0))
    )
    x_mm = integrate(((60.0, 0.0, 0),), STRAIGHT_MM, wander=noise)
    assert budget.total_mm == budget.heading_noise == pytest.approx(x_mm.std(), rel=0.05)


def test_a_start_that_leans_displaces_the_tip_by_its_length() -> None:
    """The spread by the start is its own, and its lean's over the length, within 5 %; sources add up as squares."""
    random = np.random.default_rng(5)
    leans_rad, starts_mm = 0.01 * random.standard_normal(DRAWS), 0.3 * random.standard_normal(DRAWS)
    x_mm = starts_mm + integrate(((60.0, 0.0, 0),), STRAIGHT_MM, lean_rad=leans_rad)
    settings = OutOfPlaneSettings(0.002, 0.3, 0.01, 0.02, known_to(0.03))
    budget = budget_out_of_plane(stretches(BACK_AND_FORTH), RADIUS_MM, settings)
    assert budget.start == pytest.approx(x_mm.std(), rel=0.05)
    parts = (budget.roll_zero, budget.torsion, budget.heading_noise, budget.start)
    assert min(parts) > 0
    assert budget.total_mm == pytest.approx(math.sqrt(sum(part**2 for part in parts)))


def test_a_lag_of_unknown_direction_counts_too() -> None:
    """Where the direction of the last turn is not known, the lag has its part, apart from that of the known ones."""
    settings = OutOfPlaneSettings(0.0, 0.0, 0.0, 0.0, known_to(0.05))
    unknown = [RolledStretch(30.0, 0.0, 0)]
    known = [RolledStretch(30.0, 0.0, 1)]
    assert budget_out_of_plane(unknown, RADIUS_MM, settings) == budget_out_of_plane(
        known, RADIUS_MM, settings
    )
    both = budget_out_of_plane([*unknown, *known], RADIUS_MM, settings).torsion
    assert both == pytest.approx(0.05 / RADIUS_MM * math.hypot(30 * 45, 30 * 15))


def test_nothing_inserted_is_where_it_started() -> None:
    """Before the needle moves only the start is uncertain."""
    budget = budget_out_of_plane([], RADIUS_MM, OutOfPlaneSettings(0.01, 0.2, 0.02, 0.01, known_to(0.1)))
    assert budget.total_mm == 0.2
    assert budget_out_of_plane(stretches(ONWARD), RADIUS_MM, NOTHING).total_mm == 0.0


def test_places_along_the_needle_vary_as_integrated_paths_do() -> None:
    """The covariance along the needle is that of integrated paths that wander, within 6 %, and ends with the budget."""
    settings = OutOfPlaneSettings(0.003, 0.3, 0.01, 0.02, known_to(0.03))
    at_mm = np.array([20.0, 60.0])
    covariance = covary_out_of_plane(stretches(BACK_AND_FORTH), RADIUS_MM, settings, at_mm)
    assert math.sqrt(covariance[1, 1]) == pytest.approx(
        budget_out_of_plane(stretches(BACK_AND_FORTH), RADIUS_MM, settings).total_mm
    )
    turns = np.random.default_rng(8).standard_normal((DRAWS, 120)) * 0.003 * math.sqrt(STEP_MM)
    x_mm = STEP_MM * np.cumsum(np.cumsum(turns, axis=1), axis=1)[:, [39, 119]]
    wandering = covary_out_of_plane([], STRAIGHT_MM, OutOfPlaneSettings(0.003, 0, 0, 0, known_to(0)), at_mm)
    assert wandering == pytest.approx(np.cov(x_mm.T), rel=0.06)
