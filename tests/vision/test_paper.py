"""Graph paper by an independent renderer, its scale stated roughly: lines are counted right, or it is refused."""

from dataclasses import replace
from functools import cache, partial

import cv2
import numpy as np
import pytest

from labrig.errors import CalibrationRefusedError, MeasurementRefusedError
from labrig.vision.calibrate_plane import calibrate_plane, find_px_per_mm
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.paper import find_paper
from tests.vision.paper_renderer import Camera, Sheet, draw_sheet

CAMERA = Camera(size=(480, 320), focal_px=760.0, centre_px=(244.0, 156.0))
MIDDLE = (240.0, 160.0)


def lens_of(camera):
    """Return the lens as a calibration states it."""
    sigma = dict.fromkeys(("fx", "fy", "cx", "cy"), 0.5)
    focal, (u, v) = camera.focal_px, camera.centre_px
    return Intrinsics(
        camera.size, focal, focal, u, v, (camera.k1, camera.k2, 0.0, 0.0, 0.0), sigma, 0.1, 0.1, (), True, ()
    )


def sheet_of(ruling, px_per_mm, **how):
    """Return a sheet before the camera, tilted and rolled."""
    tilted = {"tilt_deg": 9.0, "tilt_towards_deg": 50.0, "roll_deg": 14.0, "camera": CAMERA}
    return Sheet(ruling=ruling, px_per_mm=px_per_mm, **{**tilted, **how})


# Nine samples of a pixel in place of sixteen: the drawing takes half the time.
picture_of = cache(partial(draw_sheet, supersampling=3))


def calibrate(sheet, off=1.0, lens=None):
    """Return the plane map of a sheet's picture whose scale is stated that many times too large."""
    return calibrate_plane(
        picture_of(sheet),
        lens or lens_of(sheet.camera),
        sheet.pitch_mm,
        MIDDLE,
        "right",
        px_per_mm=off * sheet.px_per_mm,
    )


def length_error(plane, sheet):
    """Return the largest relative error of a length in any direction."""
    width, height = sheet.camera.size
    px = np.array([(u, v) for u in range(20, width, 40) for v in range(20, height, 40)], dtype=float)
    px = px[sheet.is_inside(sheet.to_mm(px), 0.0)]
    true = sheet.to_mm(px)
    design = np.column_stack((true, np.ones(len(true))))
    affine = np.linalg.lstsq(design, plane.to_mm(px), rcond=None)[0]
    return float(np.abs(np.linalg.svd(affine[:2], compute_uv=False) - 1.0).max())


@pytest.mark.parametrize(
    ("ruling", "px_per_mm", "off", "how"),
    [
        ("1", 3.2, 0.87, {"roll_deg": 5.0}),
        ("1/5", 6.0, 1.15, {"tilt_deg": 24.0}),
        ("1/10", 4.6, 1.0, {"blur_px": 0.9, "unevenness": 0.9}),
        ("1/5/10", 6.1, 0.9, {"width_mm": 0.1, "density": 0.4}),
        ("1/5/10", 12.0, 1.1, {"roll_deg": -20.0}),
        ("2", 7.0, 1.0, {"ink": "orange", "paper": "cream"}),
        ("5", 4.0, 1.1, {"ink": "green", "noise": 5.0}),
        ("1/5", 5.0, 0.9, {"extent_mm": (-38.0, -25.0, 30.0, 40.0), "behind": 15.0}),
        ("5", 4.0, 1.0, {"extent_mm": (-48.0, -30.0, 41.0, 33.0), "grey": True}),
    ],
)
def test_ordinary_sheets_are_accepted_and_right(ruling, px_per_mm, off, how):
    """Any ruling and ink, tilted, blurred, lit from one side, on a dark bench: lengths are right to a thousandth."""
    sheet = sheet_of(ruling, px_per_mm, **how)
    plane = calibrate(sheet, off)
    assert plane.accepted, plane.reasons
    assert length_error(plane, sheet) < 1e-3


@pytest.mark.parametrize(
    ("ruling", "off"), [("1/5/10", off) for off in (5.0, 2.0, 1.4, 0.7, 0.5, 0.2)] + [("1", 5.0), ("1", 0.1)]
)
def test_a_scale_that_the_sheet_contradicts_is_refused(ruling, off):
    """The sentence has both distances between lines; the hint says what to measure."""
    sheet = sheet_of(ruling, 8.0)
    with pytest.raises(CalibrationRefusedError, match=r"px apart|too close") as caught:
        calibrate(sheet, off)
    assert "measure" in caught.value.hint or "come closer" in caught.value.hint


def test_a_pitch_that_is_not_the_paper_s_is_refused():
    """Five typed for a 1 mm sheet: its lines are closer than they would be."""
    sheet = sheet_of("1/5/10", 8.0)
    with pytest.raises(
        CalibrationRefusedError, match=r"8\.\d px apart in the picture, .* would be (39|40)\.\d px"
    ):
        calibrate_plane(picture_of(sheet), None, 5.0, MIDDLE, "right", px_per_mm=8.0)


def test_the_distance_of_the_camera_tells_the_scale():
    """Focal length over distance, by tape, is near enough."""
    assert find_px_per_mm(lens_of(CAMERA), 95.0) == pytest.approx(8.0)


@pytest.mark.parametrize("turn_deg", [20.0, 45.0])
def test_a_second_sheet_is_refused(turn_deg):
    """Two sheets in one picture, of which one is turned."""
    first, second = (
        picture_of(sheet_of("1/5/10", 8.0, roll_deg=roll, seed=number))
        for number, roll in enumerate((0.0, turn_deg))
    )
    both = np.concatenate((first[:, :260], second[:, 260:]), axis=1)
    with pytest.raises(MeasurementRefusedError, match="two sheets") as caught:
        find_paper(both, 8.0)
    assert "take one" in caught.value.hint


def test_what_covers_the_paper_from_side_to_side_makes_no_second_sheet():
    """A ruler across the sheet hides its lines, and the larger part is used."""
    sheet = sheet_of("1/5/10", 8.0)
    covered = picture_of(sheet).copy()
    covered[100:130] = 240
    plane = calibrate_plane(covered, lens_of(CAMERA), 1.0, MIDDLE, "right", px_per_mm=8.0)
    assert length_error(plane, sheet) < 1e-3


def test_an_overexposed_picture_is_the_reason():
    """White everywhere: the hint is a shorter exposure."""
    with pytest.raises(MeasurementRefusedError, match="overexposed") as caught:
        find_paper(np.full((320, 480, 3), 255, np.uint8), 8.0)
    assert "exposure" in caught.value.hint


def test_a_lens_through_which_the_grid_is_no_square_is_refused():
    """The calibration of another camera shows in the shape of the cells."""
    lens = lens_of(CAMERA)
    plane = calibrate(sheet_of("1/5/10", 8.0), lens=replace(lens, fy=1.06 * lens.fy))
    assert not plane.accepted
    assert any("no square grid through the lens" in reason for reason in plane.reasons)


def test_a_map_says_what_its_scale_implies():
    """The picture's width in mm and the camera's distance, which a person checks with a ruler."""
    sheet = sheet_of("1/5/10", 8.0)
    plane = calibrate(sheet)
    assert plane.picture_mm == pytest.approx(sheet.picture_size_mm(), rel=0.005)
    assert plane.camera_distance_mm == pytest.approx(95.0, rel=0.005)
    assert "mm wide" in plane.view_sentence()
    assert plane.to_json()["camera_distance_mm"] == plane.camera_distance_mm


def test_a_sheet_the_size_of_a_phone_s_picture_is_read_as_well():
    """Lines a hundred pixels apart are followed in a smaller picture, and located in the whole one."""
    sheet = sheet_of("5", 20.0, camera=Camera((1600, 1200), 2500.0, (800.0, 600.0)), blur_px=1.5)
    small = draw_sheet(sheet, supersampling=2)
    found = find_paper(np.asarray(cv2.GaussianBlur(small, (0, 0), 1.0), np.uint8), 110.0)
    assert found.spacing_px == pytest.approx(100.0, rel=0.05)
