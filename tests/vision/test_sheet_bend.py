"""Sheets that are not flat: their height above the plane, its place, and how well it explains the crossings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrig.vision.plane_calibration import calibrate_plane
from labrig.vision.plane_fit import fit_plane
from labrig.vision.sheet_bend import find_bend

from .graph_paper_pictures import draw_paper, make_bench

ORIGIN = (100.3, 200.7)
LENS = (-0.05, 0.01, 0.0, 0.0, 0.0)
# The sheet of the laws below: crossings [mm] of lines 5 mm apart, seen from about 300 mm at 5 px/mm.
CELLS = np.array([(i, j) for i in range(-12, 13) for j in range(-8, 9)], dtype=float)
SHEET_MM = 5.0 * CELLS
ODD = (CELLS // 5).sum(axis=1) % 2 == 1
DISTANCE_MM, FOCAL_PX = 300.0, 1500.0


EVERYWHERE = np.array([(u, v) for u in range(15, 800, 35) for v in range(15, 600, 30)], dtype=float)


def over_plane(places_mm, heights_mm):
    """Return heights (N,) above their best plane."""
    design = np.column_stack((places_mm, np.ones(len(places_mm))))
    return heights_mm - design @ np.linalg.lstsq(design, heights_mm, rcond=None)[0]


def project(heights_mm, foot_mm, noise_mm=0.03, seed=0):
    """Return pixels of crossings that stand so high (N,), by a camera at DISTANCE_MM over `foot_mm` that looks down."""
    aside = SHEET_MM - foot_mm
    px = FOCAL_PX * aside / (DISTANCE_MM - heights_mm)[:, None]
    return px + np.random.default_rng(seed).normal(0.0, noise_mm * FOCAL_PX / DISTANCE_MM, px.shape)


def bend_of(px, foot_mm, noise_mm=0.042):
    """Return the bend found, and the plane fit that it explains."""
    known = None if foot_mm is None else np.array([*foot_mm, DISTANCE_MM])
    fit = fit_plane(px, SHEET_MM, 1.25, with_radial=foot_mm is None)
    return find_bend(fit, px, px, ODD, noise_mm=noise_mm, camera_mm=known), fit


@pytest.mark.parametrize("radius_mm", [400.0, 3000.0])
def test_height_of_a_rolled_sheet_is_found(radius_mm):
    """From a drawn picture, within 5 %: the middle lowest, an edge highest, left-out crossings at their own noise."""
    bench = make_bench(distortion=LENS)
    plane = calibrate_plane(draw_paper(bench, roll_mm=radius_mm), bench.intrinsics, 1.0, ORIGIN, "right")
    ends = np.array([plane.bend.highest_px, plane.bend.lowest_px])
    sheet = bench.roll_mm(np.concatenate((ends, EVERYWHERE)), radius_mm)
    high, low = over_plane(sheet, radius_mm * (1.0 - np.cos(sheet[:, 0] / radius_mm)))[:2]
    true = high - low
    assert plane.bend.height_mm == pytest.approx(true, rel=0.05)
    assert abs(plane.bend.height_mm - true) < 3.0 * plane.bend.sigma_mm
    assert abs(sheet[0, 0]) > 20.0 > 5.0 > abs(sheet[1, 0])
    assert plane.bend.holdout_rms_mm < 1.05 * plane.crossing_noise_mm
    assert plane.bend.holdout_rms_mm < 0.8 * plane.holdout_rms_mm
    assert "mm higher over its best plane" in plane.bend.sentence()


def test_bend_is_stated_and_changes_no_verdict():
    """A sheet that is too far off a plane is still refused, and the map stays that of the plane."""
    bench = make_bench(distortion=LENS)
    plane = calibrate_plane(draw_paper(bench, roll_mm=400.0), bench.intrinsics, 1.0, ORIGIN, "right")
    assert not plane.accepted
    assert any("off a plane" in reason for reason in plane.reasons)
    assert plane.to_json()["bend"]["height_mm"] == plane.bend.height_mm


@pytest.mark.parametrize("known", [True, False])
def test_flat_sheet_is_given_no_bend(known):
    """A flat sheet has no bend, with or without intrinsics: only noise is left, and noise is not explained."""
    bench = make_bench(distortion=LENS)
    lens = bench.intrinsics if known else None
    plane = calibrate_plane(draw_paper(bench), lens, 1.0, ORIGIN, "right")
    assert plane.bend is None
    assert plane.rms_mm == pytest.approx(plane.crossing_noise_mm, rel=0.1)


def test_without_a_lens_no_height_is_stated():
    """Foot, radial term and height have the same effect: the bend states only how far lines move, and where."""
    bench = make_bench(distortion=LENS)
    bend = calibrate_plane(draw_paper(bench, roll_mm=150.0), None, 1.0, ORIGIN, "right").bend
    assert (bend.height_mm, bend.sigma_mm, bend.highest_px, bend.lowest_px) == (None, None, None, None)
    assert bend.largest_shift_mm > 0.1
    assert "or the lens has more than one radial term" in bend.sentence()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), known=st.booleans())
def test_noise_is_never_taken_for_a_bend(seed, known):
    """If the crossings of a flat sheet are off by noise alone, no order is better than none."""
    foot = (10.0, -20.0)
    # The noise is message to be too small, so that the search is made.
    assert bend_of(project(np.zeros(len(CELLS)), foot, seed=seed), foot if known else None, 0.02)[0] is None


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    foot=st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)),
    height_mm=st.floats(2.0, 6.0),
    twist=st.floats(-1.0, 1.0),
)
def test_height_is_right_within_what_is_stated(seed, foot, height_mm, twist):
    """Gentle surfaces of the second and third order under a camera whose place is known: four sigma hold the height."""
    x, y = (CELLS / (12.0, 8.0)).T
    heights = height_mm * (x**2 - 0.4 * twist * x * y + 0.2 * twist * y**3)
    bend, fit = bend_of(project(heights, foot), foot)
    shown = np.hypot(*fit.residuals_mm.T).max()
    assert bend is not None or shown < 0.3
    if bend is not None:
        true = np.ptp(over_plane(SHEET_MM, heights))
        assert bend.height_mm == pytest.approx(true, abs=0.05 * true + 4.0 * bend.sigma_mm)


def test_bend_explains_a_sheet_seen_by_an_unknown_camera():
    """Left-out crossings of a bent sheet are predicted within a tenth of their own noise, for any camera."""
    x, y = (CELLS / (12.0, 8.0)).T
    px = project(5.0 * x**2 + 3.0 * x**2 * y, (80.0, -50.0))
    bend, fit = bend_of(px, None)
    left = np.sqrt(np.mean(np.sum(fit.residuals_mm[fit.kept] ** 2, axis=1)))
    assert bend.holdout_rms_mm < 1.1 * 0.042 < 0.7 * left
