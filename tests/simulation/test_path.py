"""The needle's path against closed forms: hinges, bevel, torsion, and what disturbs it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from labrig.simulation.description import DisturbancesDescription, NeedleDescription
from labrig.simulation.track import (
    EVEN,
    NODE_MM,
    PathNode,
    Track,
    Unevenness,
    draw_unevenness,
    follow_with_play,
)
from tests.simulation.benches import SMALL_LENS, STILL_SHEATH, before_gel, one_radius

RADIUS_MM, CLOSING_MM, BACKLASH_MM = 28.0, 3.0, 1.5
NEEDLE = NeedleDescription(hinge_closing_mm=CLOSING_MM, backlash_mm=BACKLASH_MM)
PI, LAG_RAD = math.pi, math.radians(10.0)


def cut(*pieces: tuple[float, float], heading_rad: float = 0.0, unevenness: Unevenness = EVEN) -> Track:
    """Return a track cut to each arc length at each roll in turn."""
    track = Track(PathNode(0.0, 0.0, 0.0, heading_rad, 0.0), RADIUS_MM, NEEDLE, unevenness)
    for arc_mm, roll_rad in pieces:
        track.extend(arc_mm, roll_rad)
    return track


def heading_of_closing_hinges(arc_mm: float) -> float:
    """Return the heading when curvature grows linearly to -1/r over the closing length."""
    return -(min(arc_mm, CLOSING_MM) ** 2 / (2 * CLOSING_MM) + max(0.0, arc_mm - CLOSING_MM)) / RADIUS_MM


@pytest.mark.parametrize(("roll_rad", "side"), [(0.0, 1.0), (PI, -1.0)])
@pytest.mark.parametrize("heading_rad", [0.0, 0.3])
@pytest.mark.parametrize("arc_mm", [1.0, 17.33, 40.0])
def test_the_end_is_where_the_integral_of_the_heading_leads(
    arc_mm: float, heading_rad: float, roll_rad: float, side: float
) -> None:
    """Clothoid while the hinges close, circle of equation 5 behind it: the end agrees with quadrature to 0.1 µm."""

    def heads_rad(s: float) -> float:
        return heading_rad + side * heading_of_closing_hinges(s)

    end, kink = cut((arc_mm, roll_rad), heading_rad=heading_rad).node_at(arc_mm), [min(CLOSING_MM, arc_mm)]
    y, z = (
        quad(lambda s, way=way: way(heads_rad(s)), 0, arc_mm, points=kink)[0] for way in (math.sin, math.cos)
    )
    assert (end.y_mm, end.z_mm) == pytest.approx((y, z), abs=1e-4)
    assert end.heading_rad == pytest.approx(heads_rad(arc_mm), abs=1e-9)


@settings(max_examples=30)
@given(stops=st.lists(st.floats(0.001, 40.0), min_size=1, max_size=40))
def test_the_path_does_not_depend_on_how_often_it_was_extended(stops: list[float]) -> None:
    """Any stops on the way, also backwards ones, give the same nodes to the last bit."""
    track = cut(*((stop, 0.0) for stop in stops), (40.0, 0.0))
    np.testing.assert_array_equal(track.points_mm(), cut((40.0, 0.0)).points_mm())


def test_a_turned_bevel_takes_the_backlash_once_the_hinges_are_closed() -> None:
    """After a flip at 20 mm curvature crosses zero at 20.75 mm and is opposite from 21.5 mm on."""
    track = cut((20.0, 0.0), (40.0, PI))
    for arc_mm, turns in ((20.0, -1.0), (20.75, 0.0), (21.55, 1.0)):
        assert track.node_at(arc_mm).curvature_1_mm * RADIUS_MM == pytest.approx(turns, abs=0.1)


def test_points_between_nodes_and_before_the_start_continue_the_path() -> None:
    """Between two nodes the path is smooth; before its start it is the sheath's axis."""
    track = cut((10.0, 0.0), heading_rad=0.1)
    nodes = [track.node_at(arc) for arc in np.arange(-1.0, 9.9, NODE_MM / 7)]
    points = np.array([(node.y_mm, node.z_mm) for node in nodes])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps == pytest.approx(np.full(len(steps), NODE_MM / 7), rel=1e-5)
    assert points[0] == pytest.approx([-math.sin(0.1), -math.cos(0.1)])


def test_a_bevel_on_its_way_round_leads_out_of_the_plane() -> None:
    """A millimetre at a quarter turn leans the path by 1/r towards +x, as equation 5 says."""
    end = cut((20.0, PI / 2)).node_at(20.0)
    assert (end.lean_rad, end.heading_rad) == pytest.approx(((20.0 - 1.5) / RADIUS_MM, 0.0), abs=1e-9)
    assert end.x_mm > 0


@given(
    bases=st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=30),
    lag_rad=st.floats(0.0, 1.0),
    parts=st.integers(1, 20),
)
def test_the_bevel_follows_the_base_with_play(bases: list[float], lag_rad: float, parts: int) -> None:
    """Within the lag, only when it must, and however finely a turn is sampled; without play it is where the base is."""
    bevel = base = 0.0
    for to in bases:
        finely = bevel
        for part in range(1, parts + 1):
            finely = follow_with_play(finely, base + (to - base) * part / parts, lag_rad)
        before, bevel, base = bevel, follow_with_play(bevel, to, lag_rad), to
        assert abs(bevel - to) <= lag_rad + 1e-12
        assert bevel == before or abs(bevel - to) == pytest.approx(lag_rad, abs=1e-12)
        assert bevel == pytest.approx(finely, abs=1e-12)
        assert follow_with_play(before, to, 0.0) == to


LAGS = {"torsion_lag_deg": 10}
BEHIND = math.sin(LAG_RAD) * 30**2 / 2


@pytest.mark.parametrize(
    ("lag", "pieces", "bends"),
    [
        (LAGS, [(10, 0), (20, PI), (30, 0), (40, PI)], BEHIND),
        (LAGS, [(10, 0), (20, PI), (30, 2 * PI), (40, 3 * PI)], BEHIND / 3),
        ({"torsion_lag_deg_per_mm": 0.5}, [(20, 0), *[(20, PI)] * 50, (50, PI)], BEHIND),
        (LAGS, [(10, 0), (10, PI + LAG_RAD), (40, PI + LAG_RAD)], 0.0),
        (LAGS, [(10, 0), (10, PI + LAG_RAD), (40, PI)], 0.0),
    ],
    ids=["to and fro", "on the same way", "waiting", "overshot", "overshot and back"],
)
def test_a_bevel_that_lags_leads_out_of_the_plane(
    lag: dict[str, float], pieces: list[tuple[float, float]], bends: float
) -> None:
    """Behind at both sides it leans on; turned on the same way the sides cancel.

    The wind-up stays while the needle waits and advances; turned on by the lag, the bevel is on its side.
    """
    needle = {"hinge_closing_mm": 0.01, "backlash_mm": 0.01, **lag}
    world = before_gel(gels=one_radius(RADIUS_MM), sheath=STILL_SHEATH, needle=needle, lens=SMALL_LENS)
    at_mm = 0.0
    for to_mm, roll_rad in pieces:
        world.advance(at_mm, roll_rad, 15.0)
        world.advance(to_mm, roll_rad, 15.0)
        at_mm = to_mm
    assert world.tip_mm()[0] == pytest.approx(bends / RADIUS_MM, rel=0.02, abs=1e-9)


def draw_paths(**changes: object) -> list[Unevenness]:
    """Return what disturbances of one kind only do to a hundred paths."""
    none = {"heading_deg_per_root_mm": 0.0, "curvature_fraction": 0.0}
    description = DisturbancesDescription.model_validate({**none, **changes})
    return [draw_unevenness(description, np.random.default_rng(seed)) for seed in range(100)]


def test_heading_and_curvature_wander_as_described() -> None:
    """Over a hundred paths: 0.3 degrees of heading after 1 mm and 3 degrees after 100 mm.

    The curvature's share has the given spread about its mean, and a correlation of 1/e after the given length.
    """
    turns = np.array([path.turn_rad for path in draw_paths(heading_deg_per_root_mm=0.3)])
    for length_mm, expected_deg in ((1.0, 0.3), (100.0, 3.0)):
        spread = np.degrees(turns[:, : round(length_mm / NODE_MM)].sum(axis=1)).std()
        assert spread == pytest.approx(expected_deg, rel=0.2)
    paths = draw_paths(curvature_fraction=0.05, curvature_length_mm=10.0)
    off = np.array([path.curvature_share for path in paths]) - 1.0
    assert off.std() == pytest.approx(0.05, rel=0.1)
    later = off[:, round(10.0 / NODE_MM) :]
    assert np.mean(off[:, : later.shape[1]] * later) / off.var() == pytest.approx(math.exp(-1.0), abs=0.05)


def test_a_needle_does_not_steer_in_a_cavity() -> None:
    """Once the hinges have given way the path is straight, and behind the cavity it bends again."""
    share = np.ones_like(EVEN.curvature_share)
    share[round(10.0 / NODE_MM) : round(18.0 / NODE_MM)] = 0.0
    track = cut((30.0, 0.0), unevenness=EVEN._replace(curvature_share=share.tolist()))
    headings = [track.node_at(arc).heading_rad for arc in (11.0, 18.0, 20.0, 25.0)]
    assert headings[0] == pytest.approx(headings[1], abs=1e-12)
    assert headings[2] - headings[3] == pytest.approx(5.0 / RADIUS_MM)
