"""Circles through points: certified answers, laws, outliers, refusals, and the stated uncertainty."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.circle import fit_circle

# Published sets of six points, with centre and radius of their geometric fit by high-precision arithmetic.
CERTIFIED = {
    "Gander, Golub and Strebel 1994": (
        [(1, 7), (2, 6), (5, 8), (7, 7), (9, 5), (3, 7)],
        (4.73978241090607, 2.98353269929248, 4.71422603779211),
    ),
    "SciPy cookbook, circle": (
        [(9, 34), (35, 10), (-13, 6), (10, -14), (23, 27), (0, -10)],
        (10.5000862139444, 9.65994950583643, 23.3335276461829),
    ),
    "SciPy cookbook, arc": (
        [(36, 14), (36, 10), (19, 28), (18, 31), (33, 18), (26, 26)],
        (9.88756656747739, 3.68749730978412, 27.3504431681337),
    ),
}


def arc(count=500, radius=28.0, span_deg=82.0, noise=0.0, seed=0):
    """Return points (N, 2) along an arc about (3, -7)."""
    angles = np.linspace(0.0, np.deg2rad(span_deg), count)
    points = radius * np.column_stack((np.cos(angles), np.sin(angles))) + (3.0, -7.0)
    return points + np.random.default_rng(seed).normal(0.0, noise, points.shape)


def parameters(circle):
    """Return centre and radius in one array."""
    return np.array([*circle.centre, circle.radius])


@pytest.mark.processors
@pytest.mark.parametrize(("points", "known"), CERTIFIED.values(), ids=CERTIFIED)
def test_answers_the_certified_circles(points, known):
    """The geometric fit agrees with answers computed to sixty digits."""
    assert parameters(fit_circle(points, robust=False)) == pytest.approx(np.array(known), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("robust", [True, False])
@pytest.mark.parametrize("count", [3, 40])
def test_finds_an_exact_circle(robust, count):
    """Points without noise, as few as three, give the circle they were taken from, and no residual."""
    circle = fit_circle(arc(count), robust=robust)
    assert parameters(circle) == pytest.approx([3.0, -7.0, 28.0], abs=1e-8)
    assert circle.residuals([(3.0, -7.0)]) == pytest.approx([-28.0])
    assert circle.residual_rms < 1e-9
    assert circle.inliers.all()


@settings(max_examples=40, deadline=None)
@given(
    robust=st.booleans(),
    shift=st.tuples(*[st.floats(-1e4, 1e4)] * 2),
    scale=st.floats(1e-3, 1e3),
    turn=st.floats(-3.2, 3.2),
    seed=st.integers(0, 5),
)
def test_moves_turns_and_scales_with_its_points(robust, shift, scale, turn, seed):
    """A similarity of the points is the same similarity of the circle."""
    points = arc(60, noise=0.05, seed=seed)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    before = fit_circle(points, robust=robust)
    after = fit_circle(scale * points @ rotation.T + shift, robust=robust)
    tolerance = 1e-6 * (scale + 1e-6 * np.abs(shift).max())
    assert np.array(after.centre) == pytest.approx(scale * rotation @ before.centre + shift, abs=tolerance)
    assert after.radius == pytest.approx(scale * before.radius, abs=tolerance)


@pytest.mark.processors
@pytest.mark.parametrize("share", [0.05, 0.3])
def test_robust_fit_bears_outliers(share):
    """Outliers that ruin the geometric fit do not move the robust fit; a twentieth on a tangent moves it by 0.15 %."""
    points = arc(500, noise=0.025)
    sheath = np.column_stack((np.full(25, 31.0), np.linspace(-9.0, -7.0, 25)))
    sheath += np.random.default_rng(2).normal(0.0, 0.025, (25, 2))
    assert fit_circle(np.vstack((sheath, points[:475]))).radius == pytest.approx(28.0, rel=1.5e-3)
    generator = np.random.default_rng(1)
    wrong = generator.choice(500, int(share * 500), replace=False)
    points[wrong] = generator.uniform((-5.0, -10.0), (35.0, 25.0), (len(wrong), 2))
    circle = fit_circle(points)
    assert circle.radius == pytest.approx(28.0, abs=0.03)
    assert not circle.inliers[wrong].any() or circle.inliers[wrong].mean() < 0.05
    assert abs(fit_circle(points, robust=False).radius - 28.0) > 0.3


def test_influences_tell_the_scatter_of_the_radius():
    """Over 60 arcs with outliers the influences state the standard deviation of the radius within a quarter."""
    radii, stated = [], []
    for seed in range(60):
        points = arc(200, noise=0.025, seed=seed)
        points[20:40] += 0.5
        circle = fit_circle(points)
        offsets = points - circle.centre
        directions = offsets / np.hypot(*offsets.T)[:, None]
        weights = np.linalg.pinv(np.column_stack((directions, np.ones(200))))[2]
        assert not circle.influences[20:40].any()
        radii.append(circle.radius)
        stated.append(np.linalg.norm(weights * circle.influences))
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(np.std(radii), rel=0.25)


@pytest.mark.parametrize("robust", [True, False])
@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.empty((0, 2)), "0 points"),
        ([(0.0, 0.0), (1.0, 1.0)], "2 points"),
        ([(0.0, 0.0), (1.0, 1.0), (2.0, 2.0), (5.0, 5.0)], "straight line"),
        (np.column_stack((np.arange(50.0), 3.0 * np.arange(50.0) + 1e6)), "straight line"),
        (np.ones((10, 2)), "one place"),
        ([(0.0, 0.0), (1.0, np.nan), (2.0, 0.0)], "not finite"),
        ([(0.0, 0.0), (np.inf, 0.0), (2.0, 1.0)], "not finite"),
        *((points, "shape") for points in (np.zeros((5, 3)), np.zeros(6), 3.0)),
    ],
)
def test_refuses_points_without_a_circle(points, message, robust):
    """Too few, collinear, coincident and non-finite points are refused; an array of another shape is wrong input."""
    with pytest.raises(InputError if message == "shape" else MeasurementRefusedError, match=message):
        fit_circle(points, robust=robust)


@pytest.mark.processors
def test_robust_fit_settles_where_reweighting_creeps():
    """The robust fit converges on a drawn needle of 19.53 mm, a third of whose rows are nearly outliers."""
    points = np.loadtxt(Path(__file__).with_name("creeping_arc.csv"), delimiter=",", skiprows=1)
    circle = fit_circle(points)
    assert circle.radius == pytest.approx(19.53, abs=0.05)
    turned = np.array([[0.0, -1.0], [1.0, 0.0]])
    assert fit_circle(points @ turned.T).radius == pytest.approx(circle.radius, abs=1e-8)
    # It is where the loss is least: no shift and no radius has a slope.
    offsets = points - circle.centre
    slopes = np.column_stack((offsets / np.hypot(*offsets.T)[:, None], np.ones(len(points))))
    assert slopes.T @ circle.influences == pytest.approx(np.zeros(3), abs=1e-6)
