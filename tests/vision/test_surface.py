"""Graph paper in and through gel, and through a telecentric lens: maps, measured gels, and refusals."""

from dataclasses import fields, replace

import numpy as np
import pytest

from labrig.errors import CalibrationRefusedError, InputError
from labrig.vision.gel_measurement import SeenThrough
from labrig.vision.grid_check import check_grid
from labrig.vision.plane_calibration import calibrate_plane
from labrig.vision.refraction import Gel, Layer

from .graph_paper_pictures import PaperBench, SunkenBench, TelecentricBench, draw_paper, make_bench

ORIGIN = (100.3, 120.7)
SIZE = (480, 360)
TO_FRAME = np.array([(0.0, 1.0), (-1.0, 0.0)])


def sink(bench: PaperBench, **gel):
    """Return the bench with a gel over its sheet."""
    return SunkenBench(*(getattr(bench, part.name) for part in fields(PaperBench)), **gel)


def field_px(count=200):
    """Return pixels all over the picture."""
    return np.random.default_rng(5).uniform((0.0, 0.0), (SIZE[0] - 1.0, SIZE[1] - 1.0), (count, 2))


def largest_error_mm(plane, bench):
    """Return the largest error of a map with the insertion to the right, by the bench's own rays."""
    px = field_px()
    true = (bench.mm(px) - bench.mm([ORIGIN])) @ TO_FRAME
    return float(np.linalg.norm(plane.to_mm(px) - true, axis=1).max())


def find_lens():
    """Return the bench in air, its lens with the uncertainty of a usual calibration."""
    bench = make_bench(SIZE, px_per_mm=12.0, tilt_deg=4.0)
    covariance = np.diag([0.25, 0.25, 0.5, 0.5, 1e-8, 1e-8, 1e-10, 1e-10, 1e-12, 0.0])
    return replace(bench, intrinsics=replace(bench.intrinsics, covariance=tuple(map(tuple, covariance))))


BENCH = find_lens()
BARE = draw_paper(BENCH)


def test_paper_in_the_gel_is_flat_and_fixes_the_scale():
    """Fitted with its refraction the sheet is not bent and the map right; the gel's index and depth hardly matter."""
    sunken = sink(BENCH)
    picture = draw_paper(sunken)
    gel = Gel(1.35, 4.0, "gel", index_sigma=0.01, depth_sigma_mm=0.5)
    plane = calibrate_plane(picture, BENCH.intrinsics, 1.0, ORIGIN, "right", gel=gel)
    assert plane.accepted, plane.reasons
    assert plane.bend is None
    assert largest_error_mm(plane, sunken) < 0.003
    seen = check_grid(picture, plane, 1.0)
    assert (seen.scale, seen.other_scale) == pytest.approx((1.0, 1.0), abs=2e-4)
    px = field_px()
    for moved in plane.variants("surface"):
        assert np.abs(moved.to_mm(px) - plane.to_mm(px)).max() < 0.02
        assert moved.to_mm([ORIGIN]) == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    untold = calibrate_plane(picture, BENCH.intrinsics, 1.0, ORIGIN, "right")
    assert untold.bend.gel_depth_mm == pytest.approx(4.0, rel=0.1)
    assert f"or lies flat under {untold.bend.gel_depth_mm:.1f} mm of gel" in untold.bend.sentence()
    assert largest_error_mm(untold, sunken) > 0.02


def test_a_rolled_sheet_is_not_taken_for_one_in_gel():
    """A cylinder bends lines along one direction alone, which no gel does."""
    plane = calibrate_plane(draw_paper(BENCH, roll_mm=700.0), BENCH.intrinsics, 1.0, ORIGIN, "right")
    assert plane.bend is not None
    assert plane.bend.gel_depth_mm is None


@pytest.mark.parametrize("quantity", ["depth", "index"])
def test_paper_seen_through_it_gives_the_gel(quantity):
    """Depth or index and both tilts are found within 4 sigma, and the map behind the gel is right."""
    sunken = sink(BENCH, depth_mm=5.0, slopes=(0.02, -0.035))
    seen = SeenThrough(draw_paper(sunken, seed=3), quantity)
    stated = (
        Gel(1.35, 8.0)
        if quantity == "depth"
        else Gel(1.45, 5.0 + float(sunken.mm([ORIGIN])[0] @ sunken.slopes))
    )
    plane = calibrate_plane(BARE, BENCH.intrinsics, 1.0, ORIGIN, "right", gel=stated, through=seen)
    found = plane.gel_measurement
    true = {"depth": 5.0 + float(sunken.mm([ORIGIN])[0] @ sunken.slopes), "index": 1.35}[quantity]
    assert plane.accepted, plane.reasons
    assert found.value == pytest.approx(true, abs=4.0 * found.sigma)
    assert found.sigma < 0.03 * true
    tilt_deg = np.rad2deg(np.arctan((0.035, 0.02)))
    assert found.tilt_deg == pytest.approx(tilt_deg, abs=4.0 * found.tilt_sigma_deg)
    assert found.tilt_sigma_deg < 0.3
    assert largest_error_mm(plane, sunken) < 0.005
    assert plane.not_in_interval()[1:] == (
        f"the gel's {'refractive index' if quantity == 'depth' else 'depth'}",
    )


def test_a_stated_deviation_widens_what_is_measured_with_it():
    """The index's standard deviation passes on to the depth, nearly as depth / (n (n - 1)) of it."""
    seen = SeenThrough(draw_paper(sink(BENCH, depth_mm=5.0), seed=3), "depth")
    sigmas = [
        calibrate_plane(
            BARE, BENCH.intrinsics, 1.0, ORIGIN, "right", gel=Gel(1.35, 8.0, index_sigma=sigma), through=seen
        ).gel_measurement.sigma
        for sigma in (0.0, 0.02)
    ]
    assert np.sqrt(sigmas[1] ** 2 - sigmas[0] ** 2) == pytest.approx(0.02 * 5.0 / (1.35 * 0.35), rel=0.1)


def test_refuses_what_no_gel_explains():
    """Another scale, paper without a gel, and a gel that is to be measured where it shows nothing."""
    gel = Gel(1.35, 8.0)
    other = SeenThrough(draw_paper(make_bench(SIZE, px_per_mm=16.0)), "depth")
    with pytest.raises(CalibrationRefusedError, match="times as far apart as in air"):
        calibrate_plane(BARE, BENCH.intrinsics, 1.0, ORIGIN, "right", gel=gel, through=other)
    nothing = SeenThrough(draw_paper(BENCH, seed=9), "depth")
    with pytest.raises(CalibrationRefusedError, match="its depth would be"):
        calibrate_plane(BARE, BENCH.intrinsics, 1.0, ORIGIN, "right", gel=gel, through=nothing)
    with pytest.raises(InputError, match="with paper at 'needle'"):
        calibrate_plane(
            BARE, BENCH.intrinsics, 1.0, ORIGIN, "right", gel=replace(gel, paper="surface"), through=nothing
        )


@pytest.mark.processors
def test_the_paper_s_height_moves_the_scale_by_its_share_of_the_camera_s():
    """A standard deviation of 1 mm stretches lengths by 1 mm over the camera's height; without one it is named."""
    plain, known = (
        calibrate_plane(BARE, BENCH.intrinsics, 1.0, ORIGIN, "right", paper_sigma_mm=sigma)
        for sigma in (None, 1.0)
    )
    (moved,) = known.variants("plane")[len(plain.variants("plane")) :]
    lengths = [
        np.linalg.norm(np.diff(plane.to_mm([ORIGIN, (400.0, 300.0)]), axis=0)) for plane in (known, moved)
    ]
    assert lengths[1] / lengths[0] - 1.0 == pytest.approx(1.0 / known.camera_mm()[2], rel=1e-6)
    assert plain.not_in_interval() == ("surface", "the height of the paper over the needle")
    assert known.not_in_interval() == ("surface",)
    with pytest.raises(InputError, match="needs the camera's intrinsics"):
        calibrate_plane(BARE, None, 1.0, ORIGIN, "right", paper_sigma_mm=1.0)


def test_refuses_a_tilted_surface_that_cuts_the_needle_s_plane():
    """A thin gel, and a tilt of a wrong sign or size: the reason names the depth and the corner."""
    gel = Gel(1.35, 1.0, tilt_rad=(0.0, -0.1))
    plane = calibrate_plane(BARE, BENCH.intrinsics, 1.0, ORIGIN, "right", gel=gel)
    assert any("mm below the needle's plane at (479, " in reason for reason in plane.reasons)


def test_a_telecentric_lens_sees_gel_without_a_change_of_scale():
    """A level gel and a wall change no length, and paper in the gel is as good as in air."""
    bench = TelecentricBench(BENCH.intrinsics, np.eye(3), px_per_mm=12.0, turn_deg=-3.0)
    picture = draw_paper(bench)
    for gel in (None, Gel(1.35, 10.0, layers=(Layer(1.52, 5.0),)), Gel(1.35, 10.0, "gel")):
        plane = calibrate_plane(picture, None, 1.0, ORIGIN, "right", gel=gel, telecentric=True)
        assert plane.accepted, plane.reasons
        assert largest_error_mm(plane, bench) < 0.005
        assert plane.to_px(plane.to_mm(field_px())) == pytest.approx(field_px(), abs=1e-6)
        assert plane.homography[2] == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)
    with pytest.raises(InputError, match="changes no scale"):
        calibrate_plane(
            picture,
            None,
            1.0,
            ORIGIN,
            "right",
            gel=Gel(1.35, 10.0),
            through=SeenThrough(picture, "depth"),
            telecentric=True,
        )


def test_a_lens_with_perspective_is_not_taken_for_a_telecentric_one():
    """Lines that run together are refused with what to do."""
    slanted = calibrate_plane(
        draw_paper(make_bench(SIZE, px_per_mm=12.0, tilt_deg=8.0)),
        None,
        1.0,
        ORIGIN,
        "right",
        telecentric=True,
    )
    assert any("the lens is not telecentric" in reason for reason in slanted.reasons)
