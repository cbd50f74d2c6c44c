"""Refraction through gel, walls and air gaps: the laws of rays, and least time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.optimize import minimize

from labrig.vision.gel import Gel, Layer

CAMERA = np.array([12.0, -7.0, 210.0])

indices = st.floats(1.0, 1.9)
layers = st.lists(st.builds(Layer, index=indices, thickness_mm=st.floats(0.0, 8.0)), max_size=3).map(tuple)
gels = st.builds(
    Gel,
    index=indices,
    depth_mm=st.floats(3.0, 20.0),
    paper_at=st.sampled_from(("needle", "surface")),
    layers=layers,
)
places = st.tuples(st.floats(-40.0, 40.0), st.floats(-40.0, 40.0)).map(lambda place: np.array([place]))


def find_quickest_path(gel, start, end):
    """Return the points (N, 3) where the quickest path crosses the surfaces: Fermat's principle, without any angle."""
    thicknesses = [layer.thickness_mm for layer in gel.layers]
    heights = np.array([gel.depth_mm + sum(thicknesses[number:]) for number in range(len(thicknesses) + 1)])
    media = (1.0, *(layer.refractive_index for layer in gel.layers), gel.index)

    def cross(flat):
        return np.column_stack((-heights, flat.reshape(-1, 2)))

    def measure(flat):
        legs = np.linalg.norm(np.diff(np.vstack((start, cross(flat), end)), axis=0), axis=1)
        return float(np.dot(media, legs))

    def slope(flat):
        steps = 1e-4 * np.eye(len(flat))
        return np.array([(measure(flat + step) - measure(flat - step)) / 2e-4 for step in steps])

    first = np.linspace(start[1:], end[1:], len(heights) + 2)[1:-1]
    return cross(minimize(measure, first.ravel(), jac=slope, options={"gtol": 1e-9}).x)


@pytest.mark.parametrize("seed", range(6))
def test_light_takes_the_quickest_way(seed):
    """The quickest way from the camera to a point of the needle begins along the ray to where the map says."""
    random = np.random.default_rng(seed)
    between = tuple(
        Layer(index=index, thickness_mm=thickness)
        for index, thickness in random.uniform((1.0, 1.0), (1.8, 6.0), (seed % 3, 2)).tolist()
    )
    gel = Gel(index=random.uniform(1.3, 1.6), depth_mm=random.uniform(6.0, 20.0), layers=between)
    start, place = np.array([-CAMERA[2], *CAMERA[:2]]), random.uniform(-40.0, 40.0, 2)
    leg = find_quickest_path(gel, start, np.array([0.0, *place]))[0] - start
    straight = (start - leg * start[0] / leg[0])[1:]
    assert gel.straighten(place[None], CAMERA)[0] == pytest.approx(straight, abs=1e-5)
    assert gel.bend(straight[None], CAMERA)[0] == pytest.approx(place, abs=1e-5)


@settings(max_examples=60, deadline=None)
@given(gel=gels, place=places, number=st.integers(0, 3), index=indices)
def test_rays_are_reversible_and_a_layer_without_thickness_changes_nothing(gel, place, number, index):
    """Through the surfaces and back again is the same place, wherever such a layer lies and whatever it is made of."""
    assert gel.straighten(gel.bend(place, CAMERA), CAMERA) == pytest.approx(place, abs=1e-8)
    between = (*gel.layers[:number], Layer(index=index, thickness_mm=0.0), *gel.layers[number:])
    other = gel.model_copy(update={"layers": between})
    assert other.bend(place, CAMERA) == pytest.approx(gel.bend(place, CAMERA), abs=1e-9)
    air = Gel(index=1.0, depth_mm=12.0, layers=(Layer(index="air", thickness_mm=4.0),))
    assert air.bend(place, CAMERA) == pytest.approx(place, abs=1e-9)


def test_each_known_deviation_moves_one_quantity():
    """A gel is moved once for every standard deviation that is known and not zero, and names those that are not."""
    glass, air = (Layer(index=material, thickness_mm=3.0) for material in ("glass", "air"))
    gel = Gel(index=1.35, depth_mm=10.0, depth_sigma_mm=0.5, layers=(glass, air))
    moved = list(gel.vary())
    assert [other.depth_mm for other in moved] == [10.5, 10.0]
    assert [other.layers[0].refractive_index for other in moved] == [1.52, 1.525]
    assert gel.unknown_sigmas() == (
        "the gel's refractive index",
        "the thickness of layer 1",
        "the thickness of layer 2",
        "the tilt of the gel's surface",
    )
    with pytest.raises(ValidationError, match="frozen"):
        gel.index = 1.4  # type: ignore[misc]
