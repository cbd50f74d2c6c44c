"""The error budget of radius and tip: each source by itself, their sum, and how often the interval holds the truth."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from labrig.vision.circle import fit_circle
from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.error_budget import ErrorBudget, PlaceErrors, budget_place, propagate_map
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.out_of_plane import BendingPlane, combine_turns
from labrig.vision.plane import PlaneMap, Variation
from tests.vision.rendering import RenderedLens
from tests.vision.side_lit_needle import Light, SideLitNeedle, draw_random_needle

SETTINGS = CurvatureSettings()
PICTURES = 24
NEEDLE = SideLitNeedle(28.0, 36.0, entry_mm=(12.0, 12.0))
# A camera so far away that its rays are nearly parallel.
_FAR_PX = 1e6
FAR = PlaneMap.from_scale(NEEDLE.px_per_mm, (0.0, 0.0), "right").change(
    intrinsics=Intrinsics(
        (1280, 720), _FAR_PX, _FAR_PX, 640.0, 360.0, (0.0,) * 5, {}, 0.1, 0.1, (), accepted=True, reasons=()
    )
)


def measure(needle, settings=SETTINGS, plane=None):
    """Return the measurement of a picture of `needle`."""
    exact = PlaneMap.from_scale(needle.px_per_mm, (0.0, 0.0), "right")
    return measure_curvature(needle.draw(), plane or exact, settings)


@cache
def measure_side_lit():
    """Return pairs (measurement, true radius) of needles with a lamp inside or outside their bend."""
    lights: tuple[Light, ...] = ("lamp inside the bend", "lamp outside the bend")
    bands_mm = ((30.0, 40.0), (40.0, 60.0))
    needles = [
        draw_random_needle(seed // 2, bands_mm[seed % 2], lights[seed // 2 % 2]) for seed in range(PICTURES)
    ]
    return [(measure(needle), needle.radius_mm) for needle in needles]


def test_interval_holds_the_truth_with_light_from_one_side():
    """At least 86 % of the 95 % intervals contain the true radius (two sigma of the count), in a lamp's light."""
    pairs = [(found, truth) for found, truth in measure_side_lit() if found.accepted]
    assert len(pairs) >= PICTURES - 2
    assert np.mean([m.radius_ci95_mm[0] <= truth <= m.radius_ci95_mm[1] for m, truth in pairs]) > 0.86


@pytest.mark.processors
def test_sources_add_up_to_the_error_bar():
    """The squares of the known sources add up to the radius' variance, and unknown ones are null in JSON."""
    found = measure(NEEDLE)
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
    even = measure(replace(NEEDLE, noise=1.0))
    lit = measure(replace(NEEDLE, noise=1.0, lamp=40.0, lamp_rad=np.pi / 4 + side * np.pi / 2))
    first, end = lit.line.window
    away = np.hypot(*(lit.line.px[first:end] - NEEDLE.centre_px).T) / NEEDLE.px_per_mm
    shift_mm = abs(float(away.mean()) - NEEDLE.radius_mm)
    assert even.radius_budget_mm.lighting < 0.5 * even.radius_budget_mm.fit
    assert lit.radius_budget_mm.lighting > 2.0 * lit.radius_budget_mm.fit
    assert even.tip_budget_mm.lighting < 0.5 * shift_mm
    assert lit.tip_budget_mm.lighting > 0.2 * shift_mm


@pytest.mark.processors
def test_tip_that_fades_out_is_less_certain():
    """A blurred tip has a larger error bar than a sharp one, and both hold the true tip."""
    sharp, blurred = (measure(replace(NEEDLE, blur_px=blur_px)) for blur_px in (0.6, 2.0))
    assert blurred.tip_budget_mm.fit > 1.5 * sharp.tip_budget_mm.fit
    for found in (sharp, blurred):
        off_px = np.hypot(*(np.array(found.tip_px) - NEEDLE.tip_px))
        assert off_px / NEEDLE.px_per_mm < 1.96 * found.tip_budget_mm.total


def test_variations_of_the_map_are_listed_by_group():
    """Only the group that has variations is known, and a scale off by 0.1 % is 0.1 % of the radius."""
    exact = PlaneMap.from_scale(NEEDLE.px_per_mm, (0.0, 0.0), "right")
    larger = np.diag([1.001, 1.001, 1.0]) @ exact.matrix
    budget = measure(
        NEEDLE, plane=exact.change(variations=(Variation(homography=larger, group="surface"),))
    ).radius_budget_mm
    assert budget.surface == pytest.approx(0.028, rel=1e-3)
    assert (budget.lens, budget.plane) == (None, None)
    assert budget.largest == "surface"
    assert budget.calibration == budget.surface


def test_several_variations_of_a_group_add_their_squares():
    """Two variations of 3 and 4 are one of 5."""
    exact = PlaneMap.from_scale(10.0, (0.0, 0.0), "right")
    shifts = [np.array([[1.0, 0.0, y], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ exact.matrix for y in (3.0, -4.0)]
    plane = exact.change(variations=tuple(Variation(homography=shift, group="plane") for shift in shifts))
    here = exact.to_mm([(50.0, 60.0)])[0]
    assert propagate_map(plane, [(50.0, 60.0)], lambda places: places[0] - here) == {
        "lens": None,
        "plane": pytest.approx(5.0),
        "surface": None,
    }


def test_a_distance_has_the_part_of_a_shift_that_lies_along_it():
    """A shift across the direction to the target does not move the distance from it."""
    plane = PlaneMap.from_scale(10.0, (0.0, 0.0), "right")
    errors = PlaceErrors(np.array([0.3, 0.0]), np.array([0.0, 0.2]), 0.1)
    budget = budget_place(plane, (50.0, 60.0), errors, np.array([0.0, 1.0]))
    assert budget.lighting == pytest.approx(0.001)
    assert (budget.roll, budget.fit) == (pytest.approx(0.2), 0.1)


def test_drift_since_the_calibration_is_a_part_of_the_plane():
    """Drift adds to the plane's part, known or not; no drift changes nothing."""
    assert ErrorBudget(plane=0.03).with_drift(0.04).plane == pytest.approx(0.05)
    assert ErrorBudget().with_drift(0.04).plane == pytest.approx(0.04)
    assert ErrorBudget().with_drift(0.0).plane is None


def test_roll_out_of_the_plane_is_added_where_it_is_known():
    """A stated roll has a part in the radius, and a roll of zero has none; an impossible one is refused.

    Where the camera stands is not known without intrinsics: the roll's part is not known either.
    """
    stated = SETTINGS.model_copy(update={"roll_sd_deg": 4.0})
    known = measure(NEEDLE, stated, FAR)
    assert known.radius_budget_mm.roll > 0.0
    assert known.tip_budget_mm.roll < 0.001
    assert measure(NEEDLE, SETTINGS.model_copy(update={"roll_sd_deg": 0.0}), FAR).radius_budget_mm.roll == 0.0
    assert measure(NEEDLE, stated).radius_budget_mm.roll is None
    with pytest.raises(ValueError, match="roll_sd_deg"):
        CurvatureSettings(roll_sd_deg=31.0)


def test_a_rolled_needle_seems_less_bent():
    """Seen from far away, the radius of a short arc seems 1 / cos(rho) times as large as it is."""
    turn = np.linspace(0.0, 0.15, 30)
    seen = 28.0 * np.column_stack((1.0 - np.cos(turn), np.sin(turn)))
    bending = BendingPlane(np.zeros(2), np.array([0.0, 1.0]), None)
    unrolled = fit_circle(bending.unroll(seen, np.deg2rad(8.0)), robust=False).radius
    assert 28.0 / unrolled == pytest.approx(1.0 / np.cos(np.deg2rad(8.0)), abs=0.001)


def test_no_source_makes_the_interval_shorter():
    """A needle seen over few blocks has a wide interval, and a known roll before it does not narrow it."""
    short = replace(NEEDLE, length_mm=22.0)
    without, known = (
        measure(short, SETTINGS.model_copy(update={"roll_sd_deg": roll}), FAR) for roll in (None, 2.0)
    )
    assert known.sigma_radius_mm > without.sigma_radius_mm
    assert np.diff(known.radius_ci95_mm) >= np.diff(without.radius_ci95_mm)


def test_roll_before_a_camera_is_the_scatter_of_rolled_arcs():
    """The stated part of the roll is the rms error of radii of arcs in space, rolled at random and projected."""
    lens = RenderedLens()
    plane, random = lens.plane_map(), np.random.default_rng(3)
    turn = np.linspace(0.0, 1.2, 60)
    flat = 28.0 * np.column_stack((np.cos(turn) - 1.0, np.sin(turn)))
    y_axis, z_axis, origin = np.linalg.solve(lens.matrix, lens.plane_to_ideal()).T
    # The camera looks along its own z, so nearer to it is against this normal.
    normal = np.cross(y_axis, z_axis)
    sd_rad = np.deg2rad(3.0)

    def see(roll_rad):
        space = (
            origin
            + np.outer(flat[:, 0] * np.cos(roll_rad), y_axis)
            + np.outer(flat[:, 1], z_axis)
            + np.outer(flat[:, 0] * np.sin(roll_rad), normal)
        )
        px = (space / space[:, 2:]) @ lens.matrix.T
        homogeneous = px @ np.linalg.inv(lens.plane_to_ideal()).T
        return homogeneous[:, :2] / homogeneous[:, 2:]

    errors = [fit_circle(see(roll), robust=False).radius - 28.0 for roll in random.normal(0.0, sd_rad, 400)]
    bending = BendingPlane(np.zeros(2), np.array([0.0, 1.0]), plane.camera_mm())
    changes = [
        fit_circle(bending.unroll(flat, turned), robust=False).radius - 28.0 for turned in (sd_rad, -sd_rad)
    ]
    assert combine_turns(*changes) == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=0.15)
