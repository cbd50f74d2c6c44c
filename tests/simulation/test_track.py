"""The needle's path against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from labrig.simulation.track import NODE_MM, Bending, Track

RADIUS_MM = 28.0
CLOSING_MM = 3.0
BACKLASH_MM = 1.5


def cut(*pieces: tuple[float, float], radius_mm: float = RADIUS_MM, heading_rad: float = 0.0) -> Track:
    """Return a track cut to each arc length at each roll in turn."""
    track = Track((0.0, 0.0), heading_rad, Bending(radius_mm, CLOSING_MM, BACKLASH_MM))
    for arc_mm, roll_rad in pieces:
        track.extend(arc_mm, roll_rad)
    return track


def heading_of_closing_hinges(arc_mm: float) -> float:
    """Return the heading when curvature grows linearly to -1/r over the closing length."""
    closed = max(0.0, arc_mm - CLOSING_MM)
    return -(min(arc_mm, CLOSING_MM) ** 2 / (2 * CLOSING_MM) + closed) / RADIUS_MM


@pytest.mark.parametrize("arc_mm", [1.0, 3.0, 17.33, 40.0])
def test_the_end_is_where_the_integral_of_the_heading_leads(arc_mm: float) -> None:
    """Clothoid while the hinges close, circle behind it: the end agrees with quadrature to 0.1 µm."""
    end = cut((arc_mm, 0.0)).node_at(arc_mm)
    expected_y = quad(
        lambda s: math.sin(heading_of_closing_hinges(s)), 0, arc_mm, points=[min(CLOSING_MM, arc_mm)]
    )
    expected_z = quad(
        lambda s: math.cos(heading_of_closing_hinges(s)), 0, arc_mm, points=[min(CLOSING_MM, arc_mm)]
    )
    assert (end.y_mm, end.z_mm) == pytest.approx((expected_y[0], expected_z[0]), abs=1e-4)
    assert end.heading_rad == pytest.approx(heading_of_closing_hinges(arc_mm), abs=1e-9)


def test_behind_the_closed_hinges_the_path_is_the_circle_of_equation_5() -> None:
    """From the end of closing on, points lie on one circle of the radius, turned by arc over radius."""
    track = cut((40.0, 0.0))
    nodes = [track.node_at(arc) for arc in np.linspace(CLOSING_MM, 40.0, 50)]
    centres = np.array(
        [
            (n.y_mm - RADIUS_MM * math.cos(n.heading_rad), n.z_mm + RADIUS_MM * math.sin(n.heading_rad))
            for n in nodes
        ]
    )
    assert np.ptp(centres, axis=0) == pytest.approx([0, 0], abs=1e-9)
    assert nodes[0].heading_rad - nodes[-1].heading_rad == pytest.approx(37.0 / RADIUS_MM)


@settings(max_examples=25)
@given(radius_mm=st.floats(10, 200), heading_rad=st.floats(-0.3, 0.3), length_mm=st.floats(5, 60))
def test_turning_the_bevel_by_pi_mirrors_the_path(
    radius_mm: float, heading_rad: float, length_mm: float
) -> None:
    """Roll 0 from one heading is the mirror image of roll pi from the opposite heading."""
    down = cut((length_mm, 0.0), radius_mm=radius_mm, heading_rad=heading_rad)
    up = cut((length_mm, math.pi), radius_mm=radius_mm, heading_rad=-heading_rad)
    assert down.points_mm()[:, 2] == pytest.approx(-up.points_mm()[:, 2], abs=1e-9)
    assert down.points_mm()[:, 3] == pytest.approx(up.points_mm()[:, 3], abs=1e-9)
    assert down.node_at(length_mm).curvature_1_mm < 0


@settings(max_examples=30)
@given(stops=st.lists(st.floats(0.001, 40.0), min_size=1, max_size=40))
def test_the_path_does_not_depend_on_how_often_it_was_extended(stops: list[float]) -> None:
    """Any stops on the way, also backwards ones, give the same nodes to the last bit."""
    track = cut(*((stop, 0.0) for stop in stops), (40.0, 0.0))
    np.testing.assert_array_equal(track.points_mm(), cut((40.0, 0.0)).points_mm())


def test_a_turned_bevel_takes_the_backlash_once_the_hinges_are_closed() -> None:
    """After a flip at 20 mm curvature crosses zero at 20.75 mm and is opposite from 21.5 mm on."""
    track = cut((20.0, 0.0), (40.0, math.pi))
    assert track.node_at(20.0).curvature_1_mm == pytest.approx(-1 / RADIUS_MM)
    assert track.node_at(20.75).curvature_1_mm == pytest.approx(0.0, abs=0.1 / RADIUS_MM)
    assert track.node_at(21.55).curvature_1_mm == pytest.approx(1 / RADIUS_MM)


def test_points_between_nodes_and_before_the_start_continue_the_path() -> None:
    """Between two nodes the path is smooth; before its start it is the sheath's axis."""
    track = cut((10.0, 0.0), heading_rad=0.1)
    arcs = np.arange(-1.0, 9.9, NODE_MM / 7)
    points = np.array([(track.node_at(arc).y_mm, track.node_at(arc).z_mm) for arc in arcs])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps == pytest.approx(np.full(len(steps), NODE_MM / 7), rel=1e-5)
    assert points[0] == pytest.approx([-math.sin(0.1), -math.cos(0.1)])
