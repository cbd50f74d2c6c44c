"""Paths of several arcs: their number, curvatures and flip points."""

import numpy as np
import pytest

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.arcs import fit_arcs


def path(curvatures, lengths, step=0.1, noise=0.0, seed=0):
    """Return points (N, 2), columns (y, z), along arcs that continue one another, by small steps."""
    turns = np.concatenate(
        [np.full(round(length / step), kappa) for kappa, length in zip(curvatures, lengths, strict=True)]
    )
    headings = 0.3 + np.concatenate(([0.0], np.cumsum(turns * step)))
    middles = 0.5 * (headings[1:] + headings[:-1])
    points = np.cumsum(step * np.column_stack((np.sin(middles), np.cos(middles))), axis=0)
    return points + np.random.default_rng(seed).normal(0.0, noise, points.shape)


@pytest.mark.parametrize(
    ("curvatures", "lengths"),
    [
        ((1 / 28,), (40.0,)),
        ((1 / 28, -1 / 28), (25.0, 30.0)),
        ((1 / 28, -1 / 28, 1 / 30), (20.0, 25.0, 20.0)),
        ((0.0,), (40.0,)),
    ],
)
def test_finds_the_arcs_that_were_drawn(curvatures, lengths):
    """The fit has the right number of arcs, curvatures within their uncertainty, and flips in the right places."""
    arcs = fit_arcs(path(curvatures, lengths, noise=0.02))
    assert len(arcs) == len(curvatures)
    for arc, kappa, length in zip(arcs, curvatures, lengths, strict=True):
        assert abs(arc.curvature - kappa) < 5.0 * arc.sigma_curvature
        assert arc.sigma_curvature < 2e-4
        assert arc.length == pytest.approx(length, abs=0.6)
    places = path(curvatures, lengths)
    wanted = places[np.cumsum(np.array(lengths[:-1]) / 0.1).astype(int)]
    flips = [arc.start for arc in arcs[1:]]
    assert np.array(flips).reshape(-1, 2) == pytest.approx(wanted, abs=0.6)


def test_tolerates_outliers():
    """One point in twenty far off changes neither the number of arcs nor their radii."""
    points = path((1 / 28, -1 / 28), (25.0, 30.0), noise=0.02)
    points[::20] += 1.0
    arcs = fit_arcs(points)
    assert len(arcs) == 2
    assert [arc.radius for arc in arcs] == pytest.approx([28.0, 28.0], rel=0.02)


def test_a_slow_wave_is_no_further_arc_when_none_is_allowed():
    """The fit has no more arcs than `most`."""
    assert len(fit_arcs(path((1 / 28, -1 / 28), (25.0, 30.0), noise=0.02), most=1)) == 1


def test_claimed_spread_is_the_observed_one():
    """Over noisy paths the curvatures vary as stated."""
    found = [fit_arcs(path((1 / 28, -1 / 28), (25.0, 30.0), 0.25, 0.05, n), most=2) for n in range(10)]
    observed = np.std([arcs[0].curvature for arcs in found], ddof=1)
    assert observed == pytest.approx(np.mean([arcs[0].sigma_curvature for arcs in found]), rel=0.7)


@pytest.mark.parametrize(
    ("points", "kind", "message"),
    [
        (np.zeros((5, 3)), InputError, "shape"),
        (np.zeros((5, 2)), MeasurementRefusedError, "5 points"),
        (np.column_stack((np.zeros(20), np.linspace(0.0, 2.0, 20))), MeasurementRefusedError, "2.00 long"),
    ],
)
def test_refuses_points_without_arcs(points, kind, message):
    """The message names shape, number or length."""
    with pytest.raises(kind, match=message):
        fit_arcs(points)
    with pytest.raises(InputError, match="0 arcs"):
        fit_arcs(path((0.0,), (20.0,)), most=0)
