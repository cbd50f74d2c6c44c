"""The error budget of radius and tip: each source by itself, their sum, and how often the interval holds the truth."""

import json
from dataclasses import replace

import numpy as np
import pytest

from labrig.vision.circle import fit_circle
from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.error_budget import ErrorBudget, PlaceErrors, budget_place, propagate_map
from labrig.vision.out_of_plane import BendingPlane, combine_turns
from labrig.vision.plane import PlaneMap, Variation
from tests.vision.renderer import Camera, Gel, Light, Needle, Photo, draw_side_lit, flat_camera

SETTINGS = CurvatureSettings()
NEEDLE = Needle(28.0, 36.0, (12.0, 12.0), level=50.0, sheath_level=50.0, bevel=1.5, line=0.0)
# The camera is so far away that its rays are nearly parallel.
CAMERA = flat_camera(10.0, (870, 490))
PHOTO = Photo(0.05, fall=0.025, towards_rad=0.0, blur_px=0.9, halo=0.05, seed=1)
FAR = CAMERA.plane_map()
EXACT = PlaneMap.from_scale(10.0, (0.0, 0.0), "right")


def measure(needle=NEEDLE, settings=SETTINGS, plane=EXACT, **photo):
    """Return the measurement of a picture of `needle`."""
    gel = Gel(needle, CAMERA, replace(PHOTO, **photo), tracks_mm=(), bubbles=0)
    return measure_curvature(gel.draw(), plane, settings)


def test_interval_holds_the_truth_with_light_from_one_side():
    """At least 86 % of the 95 % intervals contain the true radius (two sigma of the count), in a lamp's light."""
    lights: tuple[Light, ...] = ("lamp inside the bend", "lamp outside the bend")
    bands_mm = ((30.0, 40.0), (40.0, 60.0))
    held = []
    for seed in range(16):
        gel = draw_side_lit(seed // 2, bands_mm[seed % 2], lights[seed // 2 % 2])
        scale = PlaneMap.from_scale(gel.camera.px_per_mm, (0.0, 0.0), "right")
        found = measure_curvature(gel.draw(), scale, SETTINGS)
        if found.accepted:
            low_mm, high_mm = found.radius_ci95_mm
            held.append(low_mm <= gel.needle.radius_mm <= high_mm)
    assert len(held) >= 14
    assert np.mean(held) > 0.86


@pytest.mark.processors
def test_sources_add_up_to_the_error_bar():
    """The squares of the known sources add up to the radius' variance, and unknown ones are null in JSON."""
    found = measure()
    document = json.loads(json.dumps(found.model_dump()))
    sources = document["radius_budget_mm"]
    assert [name for name, sigma in sources.items() if sigma is None] == ["lens", "plane", "surface", "roll"]
    assert found.radius_budget_mm.missing == ("lens", "plane", "surface", "roll")
    assert sum(sigma**2 for sigma in sources.values() if sigma) == pytest.approx(found.sigma_radius_mm**2)
    assert document["tip_budget_mm"].keys() == sources.keys()
    assert found.sigma_calibration_mm == 0.0


@pytest.mark.processors
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_lamp_beside_the_needle_shows_in_radius_and_tip(side):
    """A lamp shifts the centre line by more than what is stated in even light, and about what is stated in its own.

    In even light the radius is as uncertain as the scatter of the edges makes it.
    """
    even = measure(noise=1.0)
    lit = measure(replace(NEEDLE, lamp=40.0, lamp_rad=np.pi / 4 + side * np.pi / 2), noise=1.0)
    first, end = lit.line.window
    away = np.hypot(*(CAMERA.to_mm(lit.line.px[first:end]) - NEEDLE.centre_mm).T)
    shift_mm = abs(float(away.mean()) - NEEDLE.radius_mm)
    assert even.radius_budget_mm.lighting < 0.5 * even.radius_budget_mm.fit
    assert lit.radius_budget_mm.lighting > 2.0 * lit.radius_budget_mm.fit
    assert even.tip_budget_mm.lighting < 0.5 * shift_mm
    assert lit.tip_budget_mm.lighting > 0.2 * shift_mm


@pytest.mark.processors
def test_tip_that_fades_out_is_less_certain():
    """A blurred tip has a larger error bar than a sharp one, and both hold the true tip."""
    sharp, blurred = (measure(blur_px=blur_px) for blur_px in (0.6, 2.0))
    assert blurred.tip_budget_mm.fit > 1.5 * sharp.tip_budget_mm.fit
    for found in (sharp, blurred):
        off_mm = np.hypot(*(CAMERA.to_mm([found.tip_px])[0] - NEEDLE.tip_mm))
        assert off_mm < 1.96 * found.tip_budget_mm.total


def test_variations_of_the_map_are_listed_by_group():
    """Only the group that has variations is known, and a scale off by 0.1 % is 0.1 % of the radius."""
    larger = np.diag([1.001, 1.001, 1.0]) @ EXACT.matrix
    budget = measure(
        NEEDLE, plane=EXACT.change(variations=(Variation(homography=larger, group="surface"),))
    ).radius_budget_mm
    assert budget.surface == pytest.approx(0.028, rel=1e-3)
    assert (budget.lens, budget.plane) == (None, None)
    assert budget.largest == "surface"
    assert budget.calibration == budget.surface


def test_several_variations_of_a_group_add_their_squares():
    """Two variations of 3 and 4 are one of 5."""
    shifts = [np.array([[1.0, 0.0, y], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ EXACT.matrix for y in (3.0, -4.0)]
    plane = EXACT.change(variations=tuple(Variation(homography=shift, group="plane") for shift in shifts))
    here = EXACT.to_mm([(50.0, 60.0)])[0]
    assert propagate_map(plane, [(50.0, 60.0)], lambda places: places[0] - here) == {
        "lens": None, "plane": pytest.approx(5.0), "surface": None,
    }  # fmt: skip


def test_a_distance_has_the_part_of_a_shift_along_it_and_drift_is_a_part_of_the_plane():
    """A shift across the direction to the target does not move the distance; drift adds to the plane's part, if any."""
    errors = PlaceErrors(np.array([0.3, 0.0]), np.array([0.0, 0.2]), 0.1)
    budget = budget_place(EXACT, (50.0, 60.0), errors, np.array([0.0, 1.0]))
    assert budget.lighting == pytest.approx(0.001)
    assert (budget.roll, budget.fit) == (pytest.approx(0.2), 0.1)
    assert ErrorBudget(plane=0.03).with_drift(0.04).plane == pytest.approx(0.05)
    assert ErrorBudget().with_drift(0.04).plane == pytest.approx(0.04)
    assert ErrorBudget().with_drift(0.0).plane is None


def test_roll_out_of_the_plane_is_added_where_it_is_known():
    """A stated roll has a part in the radius, and a roll of zero has none; no part makes the interval shorter.

    Where the camera stands is not known without intrinsics: the roll's part is not known either.
    """
    none, stated = (SETTINGS.model_copy(update={"roll_sd_deg": roll}) for roll in (0.0, 4.0))
    without, known, unknown = (
        measure(NEEDLE, none, FAR), measure(NEEDLE, stated, FAR), measure(NEEDLE, stated),
    )  # fmt: skip
    assert known.radius_budget_mm.roll > without.radius_budget_mm.roll == 0.0
    assert known.tip_budget_mm.roll < 0.001
    assert unknown.radius_budget_mm.roll is None
    assert known.sigma_radius_mm > without.sigma_radius_mm
    assert np.diff(known.radius_ci95_mm) >= np.diff(without.radius_ci95_mm)
    with pytest.raises(ValueError, match="roll_sd_deg"):
        CurvatureSettings(roll_sd_deg=31.0)


def test_roll_before_a_camera_is_the_scatter_of_rolled_arcs():
    """The stated part of the roll is the rms error of radii of arcs in space, rolled at random and projected."""
    camera, random = Camera(origin_px=(320.0, 200.0), distortion=(0.0,) * 5), np.random.default_rng(3)
    plane = camera.plane_map()
    turn = np.linspace(0.0, 1.2, 60)
    flat = 28.0 * np.column_stack((np.cos(turn) - 1.0, np.sin(turn)))
    sd_rad = np.deg2rad(3.0)

    def see(roll_rad):
        places = np.column_stack((flat[:, 1], -flat[:, 0] * np.cos(roll_rad)))
        return plane.to_mm(camera.to_px(places, -flat[:, 0] * np.sin(roll_rad)))

    errors = [fit_circle(see(roll), robust=False).radius - 28.0 for roll in random.normal(0.0, sd_rad, 200)]
    bending = BendingPlane(np.zeros(2), np.array([0.0, 1.0]), plane.camera_mm())
    changes = [
        fit_circle(bending.unroll(flat, turned), robust=False).radius - 28.0 for turned in (sd_rad, -sd_rad)
    ]
    assert combine_turns(*changes) == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=0.15)
