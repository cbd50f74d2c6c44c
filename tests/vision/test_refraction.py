"""Refraction through gel, walls and air gaps: the laws of rays, and least time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from labrig.errors import InputError
from labrig.vision.refraction import MATERIALS, Gel, Layer

PINHOLE = np.array([-210.0, 12.0, -7.0, 1.0])
TELECENTRIC = np.array([-1.0, 0.0, 0.0, 0.0])

indices = st.floats(1.0, 1.9)
tilts = st.floats(-0.15, 0.15)
layers = st.lists(st.builds(Layer, indices, st.floats(0.0, 8.0)), max_size=3).map(tuple)
gels = st.builds(
    Gel,
    indices,
    st.floats(3.0, 20.0),
    st.sampled_from(("needle", "surface", "gel")),
    layers=layers,
    tilt_rad=st.tuples(tilts, tilts),
)
places = st.tuples(st.floats(-40.0, 40.0), st.floats(-40.0, 40.0)).map(lambda place: np.array([place]))
cameras = st.sampled_from((PINHOLE, TELECENTRIC))


def optical_path_mm(gel, start, points, end):
    """Return the optical length of a path by straight pieces from the camera through points to the end."""
    corners = np.vstack((start, points, end))
    indices = (1.0, *(layer.index for layer in gel.layers), gel.index)
    return sum(
        n * length
        for n, length in zip(indices, np.linalg.norm(np.diff(corners, axis=0), axis=1), strict=True)
    )


def surfaces(gel):
    """Return for each surface, from the camera on, its height over the needle's plane at (0, 0), and its slopes."""
    slopes = np.tan(gel.tilt_rad)
    steepness = np.sqrt(1.0 + slopes @ slopes)
    thicknesses = [layer.thickness_mm * steepness for layer in gel.layers]
    return [gel.depth_mm + sum(thicknesses[number:]) for number in range(len(thicknesses) + 1)], slopes


def find_quickest_path(gel, start, end):
    """Return the points (N, 3) where the quickest path crosses the surfaces: Fermat's principle, without any angle."""
    heights, slopes = surfaces(gel)

    def raise_to_surfaces(flat):
        lateral = flat.reshape(-1, 2)
        return np.column_stack((-(np.array(heights) + lateral @ slopes), lateral))

    first = np.linspace(start[1:], end[1:], len(heights) + 2)[1:-1]

    def measure(flat):
        return optical_path_mm(gel, start, raise_to_surfaces(flat), end)

    def slope(flat):
        steps = 1e-4 * np.eye(len(flat))
        return np.array([(measure(flat + step) - measure(flat - step)) / 2e-4 for step in steps])

    return raise_to_surfaces(minimize(measure, first.ravel(), jac=slope, options={"gtol": 1e-9}).x)


@pytest.mark.parametrize("seed", range(6))
def test_light_takes_the_quickest_way(seed):
    """The quickest way from the camera to a point of the needle begins along the ray to where the map says."""
    random = np.random.default_rng(seed)
    between = tuple(Layer(*random.uniform((1.0, 1.0), (1.8, 6.0))) for _ in range(seed % 3))
    tilt = random.uniform(-0.1, 0.1, 2) * (seed > 0)
    gel = Gel(
        random.uniform(1.3, 1.6), random.uniform(6.0, 20.0), layers=between, tilt_rad=(tilt[0], tilt[1])
    )
    start, place = PINHOLE[:3], random.uniform(-40.0, 40.0, 2)
    leg = find_quickest_path(gel, start, np.array([0.0, *place]))[0] - start
    straight = (start - leg * start[0] / leg[0])[1:]
    assert gel.straighten(place[None], PINHOLE)[0] == pytest.approx(straight, abs=1e-5)
    assert gel.bend(straight[None], PINHOLE)[0] == pytest.approx(place, abs=1e-5)


@settings(max_examples=60, deadline=None)
@given(gel=gels, place=places, camera=cameras)
def test_rays_are_reversible(gel, place, camera):
    """Through the surfaces and back again is the same place."""
    assert gel.straighten(gel.bend(place, camera), camera) == pytest.approx(place, abs=1e-8)


@settings(max_examples=40, deadline=None)
@given(gel=gels, place=places, camera=cameras)
def test_derivatives_are_those_of_the_map(gel, place, camera):
    """The derivatives are those of central differences."""
    step = 1e-4
    moves = [
        (gel.bend(place + step * way, camera) - gel.bend(place - step * way, camera))[0] for way in np.eye(2)
    ]
    assert gel._trace(place, camera, derive=True)[1][0] == pytest.approx(
        np.transpose(moves) / (2.0 * step), abs=1e-6
    )


@settings(max_examples=40, deadline=None)
@given(gel=gels, place=places, number=st.integers(0, 3), index=indices, camera=cameras)
def test_a_layer_without_thickness_changes_nothing(gel, place, number, index, camera):
    """Wherever it lies and whatever it is made of."""
    between = (*gel.layers[:number], Layer(index, 0.0), *gel.layers[number:])
    assert replace(gel, layers=between).bend(place, camera) == pytest.approx(
        gel.bend(place, camera), abs=1e-9
    )


@settings(max_examples=40, deadline=None)
@given(gel=gels, place=places)
def test_a_gel_as_thin_as_air_is_no_gel(gel, place):
    """With the index of air everywhere, a ray to the needle's plane stays straight."""
    air = replace(
        gel, index=1.0, layers=tuple(replace(layer, index=1.0) for layer in gel.layers), paper="needle"
    )
    assert air.bend(place, PINHOLE) == pytest.approx(place, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(gel=gels, place=places)
def test_a_level_surface_is_a_tilted_one_without_tilt(gel, place):
    """The two computations, about the camera's foot and in three dimensions, agree where both hold."""
    level = replace(gel, tilt_rad=(0.0, 0.0))
    hardly = replace(gel, tilt_rad=(1e-11, 0.0))
    assert level.bend(place, PINHOLE) == pytest.approx(hardly.bend(place, PINHOLE), abs=1e-7)
    assert level.straighten(place, PINHOLE) == pytest.approx(hardly.straighten(place, PINHOLE), abs=1e-7)


def test_snell_holds_at_every_surface():
    """The quickest way through glass, air gap and tilted gel obeys n sin a = n' sin a' at all three surfaces."""
    gel = Gel(1.35, 9.0, layers=(Layer(1.52, 5.0), Layer(1.0, 2.0)), tilt_rad=(0.05, -0.03))
    start, end = PINHOLE[:3], np.array([0.0, 25.0, -14.0])
    corners = np.vstack((start, find_quickest_path(gel, start, end), end))
    normal = np.array([1.0, *np.tan(gel.tilt_rad)])
    legs = np.diff(corners, axis=0)
    sines = (
        np.linalg.norm(np.cross(legs, normal), axis=1) / np.linalg.norm(legs, axis=1) / np.linalg.norm(normal)
    )
    assert np.array([1.0, 1.52, 1.0, 1.35]) * sines == pytest.approx(np.full(4, sines[0]), rel=1e-4)


def test_parallel_rays_only_shift():
    """Through a level surface parallel rays keep their places; a tilt moves them, nearly all alike."""
    points = np.random.default_rng(2).uniform(-30.0, 30.0, (20, 2))
    gel = Gel(1.35, 10.0, layers=(Layer(1.49, 4.0),))
    assert gel.bend(points, TELECENTRIC) == pytest.approx(points, abs=1e-12)
    moved = replace(gel, tilt_rad=(0.05, 0.0)).bend(points, TELECENTRIC) - points
    assert np.abs(moved).max() > 0.1
    assert np.ptp(moved, axis=0).max() < 0.05


def test_each_known_deviation_moves_one_quantity():
    """A gel is moved once for every standard deviation that is known and not zero, and names those that are not."""
    glass, air = (
        Layer(index, 3.0, index_sigma=sigma) for index, sigma in (MATERIALS["glass"], MATERIALS["air"])
    )
    gel = Gel(1.35, 10.0, depth_sigma_mm=0.5, layers=(glass, air), tilt_sigma_rad=0.01)
    moved = list(gel.vary())
    assert [other.depth_mm for other in moved] == [10.5, 10.0, *(10.0,) * 4]
    assert [other.layers[0].index for other in moved] == [1.52, 1.525, *(1.52,) * 4]
    corner = 0.01 * np.sqrt(0.5)
    assert [other.tilt_rad for other in moved[2:]] == pytest.approx(
        np.array([(-corner, -corner), (-corner, corner), (corner, -corner), (corner, corner)])
    )
    assert gel.unknown_sigmas() == (
        "the gel's refractive index",
        "the thickness of layer 1",
        "the thickness of layer 2",
    )


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: Layer(0.9, 1.0), "a layer's index is 0.9"),
        (lambda: Layer(1.5, -1.0), "a layer's thickness is -1.0 mm"),
        (lambda: Layer(1.5, 1.0, thickness_sigma_mm=-1.0), "deviation of a layer's thickness is -1.0 mm"),
        (lambda: Gel(1.35, 10.0, index_sigma=0.7), "deviation of the gel's index is 0.7"),
        (lambda: Gel(1.35, 10.0, tilt_rad=(0.0, -0.4)), "surface's tilt is 22.9 degrees"),
        (lambda: Gel(1.35, 10.0, tilt_sigma_rad=0.4), "tilt's standard deviation is 22.9 degrees"),
    ],
)
def test_refuses_impossible_layers(made, message):
    """Index, thickness, tilt and their deviations are named with their limits."""
    with pytest.raises(InputError, match=message):
        made()
