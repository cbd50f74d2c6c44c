"""The displacement of a marker over pictures in which it is seen, not seen, or somewhere else."""

import math

import pytest

from labrig.steering.marker_tracking import TrackedMarker, follow_marker
from labrig.steering.moving import Displacement, Displacements, displace_problem
from labrig.steering.parameters import MarkerTrust
from labrig.steering.problem import Obstacle, PlanProblem, Surroundings

TRUST = MarkerTrust(sd_mm=0.1, lost_sd_mm_per_mm=0.05, most_lost_mm=10.0, jump_mm=1.0)
START = TrackedMarker(7, (-20.0, 30.0))


def follow(*seen: tuple[float, tuple[float, float] | None]) -> TrackedMarker:
    """Follow a marker over pictures, each an insertion length and where it was seen."""
    marker = START
    for inserted_mm, seen_mm in seen:
        marker = follow_marker(marker, seen_mm, inserted_mm, TRUST)
    return marker


def test_a_marker_that_is_not_seen_stays_and_becomes_less_certain() -> None:
    """Its displacement is held, and its uncertainty grows with the needle's way until it is seen again."""
    held = follow((1.0, (-19.8, 30.0)), (3.0, None), (5.0, None))
    assert held.moved_mm == pytest.approx((0.2, 0.0))
    assert held.sd_mm(TRUST) == pytest.approx(math.hypot(0.1, 0.05 * 4.0))
    again = follow((1.0, (-19.8, 30.0)), (3.0, None), (5.0, None), (6.0, (-19.5, 30.0)))
    assert again.moved_mm == pytest.approx((0.5, 0.0))
    assert again.sd_mm(TRUST) == pytest.approx(0.1)
    assert again.stop is None


def test_a_marker_that_is_not_seen_for_too_long_stops_the_needle() -> None:
    """The needle's way counts, back and forth, and the stop names marker and limit."""
    back = follow((8.0, (-20.0, 30.0)), (14.0, None), (9.0, None))
    assert back.stop == "marker_lost"
    assert "marker 7 was not seen while the needle moved by 11.0 mm, and 10 mm are allowed" in back.detail
    assert follow((8.0, (-20.0, 30.0)), (14.0, None), (10.0, None)).stop is None


def test_a_jump_that_stays_stops_the_needle_and_one_that_does_not_is_forgotten() -> None:
    """One picture with a marker elsewhere changes nothing; a second that agrees with it does."""
    once = follow((1.0, (-20.0, 30.0)), (2.0, (-18.0, 30.0)))
    assert (once.moved_mm, once.stop) == ((0.0, 0.0), None)
    back = follow((1.0, (-20.0, 30.0)), (2.0, (-18.0, 30.0)), (3.0, (-20.0, 30.1)), (4.0, (-18.0, 30.0)))
    assert (back.stop, back.moved_mm) == (None, pytest.approx((0.0, 0.1)))
    elsewhere = follow((1.0, (-20.0, 30.0)), (2.0, (-18.0, 30.0)), (3.0, (-20.0, 35.0)))
    assert elsewhere.stop is None
    stays = follow((1.0, (-20.0, 30.0)), (2.0, (-18.0, 30.0)), (3.0, (-17.9, 30.0)))
    assert stays.stop == "marker_jumped"
    assert "marker 7 has jumped by 2.1 mm and stays there" in stays.detail


def test_an_uncertain_obstacle_is_kept_off_further() -> None:
    """The margin of an obstacle holds the tip's uncertainty and its own; target and obstacle are where they moved."""
    problem = PlanProblem(
        (0.0, 0.0, 90.0), (Obstacle((0.0, 12.0, 40.0), 4.0), Obstacle((0.0, -12.0, 40.0), 4.0))
    )
    moved = Displacements(Displacement((1.0, 2.0), 0.3), (None, Displacement((0.5, 0.0), 0.2)))
    displaced = displace_problem(problem, moved)
    assert displaced.target_mm == (0.0, 1.0, 92.0)
    assert [ball.position_mm for ball in displaced.obstacles] == [(0.0, 12.0, 40.0), (0.0, -11.5, 40.0)]
    grown = Surroundings(displaced).keep_off_mm - Surroundings(problem).keep_off_mm
    assert grown == pytest.approx([0.0, 2.0 * 0.2])
