"""Turns of a bevel behind a play, against a simulated play operator, and the fit of its lag to deflections."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError, MeasurementRefusedError
from labrig.steering.torsion import (
    BaseLimits,
    BaseTurn,
    RolledStretch,
    TorsionalLag,
    TurnAhead,
    _displace_end,
    centre_bevel,
    choose_turn,
)
from labrig.steering.torsion_fit import BendLengths, TorsionBend, fit_torsion

RADIUS_MM = 28.0
WIDE = BaseLimits(-13.0, 13.0)

lengths_mm = st.lists(st.floats(2.0, 40.0), min_size=2, max_size=6)
lags = st.builds(TorsionalLag, *(st.floats(0.0, most) for most in (0.2, 0.004, 60.0, 0.05, 0.001)))


def find_lag_sd_mm(stretches, lag, radius_mm=RADIUS_MM):
    """Return by how much the error of a lag displaces the end; stretches before which no turn is known do not count."""
    turned = np.array([stretch.turned for stretch in stretches], dtype=np.float64)
    return np.hypot(*(turned @ _displace_end(stretches, lag, radius_mm)))


def turn_with(bevel_rad, turn, lag_rad):
    """Return where a play operator leaves the bevel after the base is driven as a turn says."""
    for base_rad in (turn.farthest_rad, turn.to_rad):
        bevel_rad = min(max(bevel_rad, base_rad - lag_rad), base_rad + lag_rad)
    return bevel_rad


def steer(arcs_mm, known, true, limits=WIDE):
    """Return turns, stretches and the bevel in each arc, with a half turn between two arcs."""
    path, bevels_rad, turns = [RolledStretch(arcs_mm[0], 0.0, 0)], [0.0], list[BaseTurn]()
    for number in range(1, len(arcs_mm)):
        ahead = [TurnAhead(math.pi, arc_mm) for arc_mm in arcs_mm[number:]]
        base_rad = turns[-1].to_rad if turns else 0.0
        turns.append(choose_turn(path, base_rad, ahead, known, limits, radius_mm=RADIUS_MM))
        bevels_rad.append(turn_with(bevels_rad[-1], turns[-1], true.at(sum(arcs_mm[:number]))))
        path.append(RolledStretch(arcs_mm[number], turns[-1].to_rad, turns[-1].direction))
    return turns, path, bevels_rad


def displacement_mm(arcs_mm, bevels_rad):
    """Return x at the end of a path, to first order in the lean."""
    left_mm, x_mm = sum(arcs_mm), 0.0
    for arc_mm, bevel_rad in zip(arcs_mm, bevels_rad, strict=True):
        x_mm += math.sin(bevel_rad) * arc_mm * (left_mm - arc_mm / 2) / RADIUS_MM
        left_mm -= arc_mm
    return x_mm


def left_by(arcs_mm, directions, lag):
    """Return the standard deviation that an error of the lag leaves after half turns in these directions [mm]."""
    rolls_rad = math.pi * np.cumsum((0, *directions))
    return find_lag_sd_mm(list(map(RolledStretch, arcs_mm, rolls_rad.tolist(), (0, *directions))), lag)


@pytest.mark.processors
@given(lengths_mm, lags)
def test_with_the_true_lag_the_bevel_ends_where_it_should_be(arcs_mm, lag):
    """After overshoot and return the bevel is at the base's angle, so that the play is free on both sides."""
    turns, _, bevels_rad = steer(arcs_mm, lag, lag)
    assert bevels_rad[1:] == pytest.approx([turn.to_rad for turn in turns], abs=1e-12)


@given(lengths_mm, st.floats(-0.02, 0.02), st.floats(-2e-4, 2e-4))
def test_the_spread_foretells_what_an_error_of_the_lag_does(arcs_mm, error_rad, per_mm_rad):
    """A small error of the lag, or of its growth, displaces the end as far as that is its standard deviation."""
    for known, true in (
        (TorsionalLag(0.2, 0.0, 0.0, abs(error_rad), 0.0), TorsionalLag(0.2 + error_rad)),
        (TorsionalLag(0.2, 0.0, 0.0, 0.0, abs(per_mm_rad)), TorsionalLag(0.2, per_mm_rad)),
    ):
        _, path, bevels_rad = steer(arcs_mm, known, true)
        expected_mm = find_lag_sd_mm(path, known)
        assert abs(displacement_mm(arcs_mm, bevels_rad)) == pytest.approx(expected_mm, abs=0.1)


@given(lengths_mm, lags)
def test_no_other_directions_leave_less(arcs_mm, lag):
    """The error of the lag displaces the end no more than turns back and forth, or all the same way, would let it."""
    turns = len(arcs_mm) - 1
    _, path, _ = steer(arcs_mm, lag, lag, BaseLimits(-math.pi * turns - 1.0, math.pi * turns + 1.0))
    others = ([1 if number % 2 == 0 else -1 for number in range(turns)], [1] * turns)
    least_mm = min(left_by(arcs_mm, directions, lag) for directions in others)
    assert find_lag_sd_mm(path, lag) <= least_mm + 0.02 * turns


@given(lengths_mm, lags, st.floats(4.0, 13.0))
def test_the_base_is_never_driven_beyond_its_limits(arcs_mm, lag, limit_rad):
    """Angles and overshoots are within the limits of the axis; the bevel still gets every turn."""
    turns, _, _ = steer(arcs_mm, lag, lag, BaseLimits(-limit_rad, limit_rad))
    before_rad = 0.0
    for turn in turns:
        assert abs(turn.to_rad) <= limit_rad
        assert abs(turn.farthest_rad) <= limit_rad
        assert abs(turn.to_rad - before_rad) == pytest.approx(math.pi)
        assert turn.overshoot_rad * turn.direction >= 0.0
        before_rad = turn.to_rad


@given(st.floats(-13.0, 13.0), st.floats(0.0, 0.3), st.floats(-0.3, 0.3))
def test_a_bevel_in_the_sheath_is_centred(from_rad, lag_rad, off):
    """From any base angle, and wherever the bevel was in its play, it comes to the roll zero."""
    turn = centre_bevel(from_rad, TorsionalLag(lag_rad), WIDE)
    if abs(from_rad) > 2 * lag_rad:
        assert turn_with(from_rad + off * lag_rad / 0.3, turn, lag_rad) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("base_rad", "to_rad"), [(0.0, math.pi), (math.pi, 0.0), (-math.pi, 0.0)])
def test_back_and_forth_leads_away_from_the_roll_zero_and_back(base_rad, to_rad):
    """The first turn is a positive one; nothing is done about a lag."""
    path, ahead = [RolledStretch(30.0, base_rad, 0)], [TurnAhead(math.pi, 30.0)]
    turn = choose_turn(
        path, base_rad, ahead, TorsionalLag(0.1), WIDE, radius_mm=RADIUS_MM, turning="back_and_forth"
    )
    assert (turn.to_rad, turn.overshoot_rad) == (pytest.approx(to_rad), 0.0)


def test_a_turn_for_which_there_is_no_room_is_not_lengthened():
    """An axis of less than a half turn either way is told to make it all the same, without an overshoot."""
    path, ahead = [RolledStretch(30.0, 0.0, 0)], [TurnAhead(math.pi, 30.0)]
    turn = choose_turn(path, 0.0, ahead, TorsionalLag(0.1), BaseLimits(-3.0, 3.0), radius_mm=RADIUS_MM)
    assert (abs(turn.to_rad), abs(turn.direction), turn.overshoot_rad) == (math.pi, 1, 0.0)


def test_a_turn_is_chosen_with_the_room_that_the_next_one_needs():
    """The lag grows with the depth: the second turn one way would be driven beyond the limit, the other way not."""
    lag, limits = TorsionalLag(0.0, 0.004), BaseLimits(-2 * math.pi - 0.35, 2 * math.pi + 0.25)
    turns, _, _ = steer([30.0, 40.0, 30.0], lag, lag, limits)
    assert [turn.direction for turn in turns] == [-1, -1]


FITTED_RADIUS_MM = 27.7
LENGTHS = BendLengths(bent_mm=12.0, turned_mm=15.0, backlash_mm=1.5)
LAG_RAD, PER_MM = math.radians(2.0), math.radians(0.15)


def make_bends(noise_mm, seed, depths_mm=(30.0, 50.0, 70.0)):
    """Return the bends of a needle with a known lag, with a parallax that depends on the depth."""
    random, bends = np.random.default_rng(seed), []
    for depth_mm in depths_mm:
        for direction in (1, -1):
            turned_rad = math.pi / 2 - direction * (LAG_RAD + PER_MM * depth_mm)
            bent_rad = LAG_RAD + PER_MM * (depth_mm - 20.0)
            bent, turned = random.normal(0.0, noise_mm, 2)
            bent -= FITTED_RADIUS_MM * (1 - math.cos(12.0 / FITTED_RADIUS_MM)) * math.cos(bent_rad)
            turned -= (
                FITTED_RADIUS_MM * (1 - math.cos(14.25 / FITTED_RADIUS_MM)) * math.cos(turned_rad)
                + 0.01 * depth_mm
            )
            bends.append(TorsionBend(depth_mm, direction, depth_mm - 20.0, bent, turned))
    return bends


def fit(bends):
    """Return the fit, with an expected radius that is not the true one."""
    return fit_torsion(bends, LENGTHS, 30.0)


@pytest.mark.processors
def test_exact_deflections_give_the_lag_exactly():
    """The lag, its growth and the radius come out; a parallax that depends on the depth alone changes nothing."""
    found = fit(make_bends(0.0, 0))
    assert found.lag.lag_rad == pytest.approx(LAG_RAD, abs=1e-6)
    assert found.lag.lag_rad_per_mm == pytest.approx(PER_MM, abs=1e-8)
    assert found.radius_mm == pytest.approx(FITTED_RADIUS_MM, abs=1e-4)


def test_the_interval_covers_the_lag():
    """Of 200 fits of noisy deflections, 92.5 to 97.5 % of the 95 % intervals of lag and growth hold the true one."""
    fits = [fit(make_bends(0.05, seed)) for seed in range(200)]
    held = [abs(found.lag.lag_rad - LAG_RAD) <= 1.96 * found.lag.find_sd_rad(0.0) for found in fits]
    grown = [abs(found.lag.lag_rad_per_mm - PER_MM) <= 1.96 * found.lag.per_mm_sd_rad for found in fits]
    assert 0.925 <= np.mean(held) <= 0.975
    assert 0.925 <= np.mean(grown) <= 0.975


@pytest.mark.parametrize(
    ("bends", "radius_mm", "error", "words"),
    [
        (make_bends(0.0, 0, (30.0,)), 30.0, InputError, "1 depths"),
        (make_bends(0.0, 0)[:-1], 30.0, InputError, "each from both sides"),
        (make_bends(0.0, 0), 60.0, MeasurementRefusedError, r"radius of 27\.7 mm"),
    ],
)
def test_what_tells_no_lag_is_refused(bends, radius_mm, error, words):
    """One depth, one side only, and a needle that bends twice as much as one of this design."""
    with pytest.raises(error, match=words):
        fit_torsion(bends, LENGTHS, radius_mm)
