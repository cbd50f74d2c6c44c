"""Graph paper, its scale stated roughly: lines are counted right, or it is refused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from labrig.errors import CalibrationRefusedError, MeasurementRefusedError
from labrig.vision.calibrate_plane import calibrate_plane, find_px_per_mm
from labrig.vision.paper import find_paper
from tests.vision.renderer import Camera, Photo, Sheet

CAMERA = Camera((480, 320), 760.0, (244.0, 156.0), (-0.1, 0.02, 0.0, 0.0, 0.0), 95.0, 9.0, 50.0, 14.0)
SHEET = Sheet(camera=CAMERA)
MIDDLE = (240.0, 160.0)


def sheet_of(ruling="1/5/10", px_per_mm=8.0, tilt_deg=9.0, roll_deg=14.0, photo=SHEET.photo, **how):
    """Return a sheet before the camera, tilted and rolled."""
    camera = replace(CAMERA, distance_mm=760.0 / px_per_mm, tilt_deg=tilt_deg, roll_deg=roll_deg)
    return Sheet(ruling, camera, photo, **how)


@cache
def picture_of(sheet):
    """Return the picture of a sheet."""
    return sheet.draw()


def calibrate(sheet, off=1.0, picture=None, pitch_mm=None, lens=None):
    """Return the plane map of a sheet's picture whose scale is stated that many times too large."""
    return calibrate_plane(
        picture_of(sheet) if picture is None else picture,
        lens or sheet.camera.intrinsics,
        pitch_mm or sheet.pitch_mm,
        MIDDLE,
        "right",
        px_per_mm=off * sheet.camera.px_per_mm,
    )


@pytest.mark.parametrize(
    ("sheet", "off"),
    [
        (sheet_of("1", 3.2, roll_deg=5.0), 0.87),
        (sheet_of("1/5", 6.0, tilt_deg=24.0), 1.15),
        (sheet_of("1/10", 4.6, photo=Photo(0.36, 0.54, 0.23, blur_px=0.9)), 1.0),
        (sheet_of("1/5/10", 6.1, width_mm=0.1, density=0.4), 0.9),
        (sheet_of("1/5/10", 12.0, roll_deg=-20.0), 1.1),
        (sheet_of("2", 7.0, ink="orange", paper="cream"), 1.0),
        (sheet_of("5", 4.0, photo=replace(SHEET.photo, noise=5.0), ink="green"), 1.1),
        (sheet_of("1/5", 5.0, extent_mm=(-38.0, -25.0, 30.0, 40.0), behind=15.0), 0.9),
        (
            sheet_of("5", 4.0, photo=replace(SHEET.photo, grey=True), extent_mm=(-48.0, -30.0, 41.0, 33.0)),
            1.0,
        ),
    ],
)
def test_ordinary_sheets_are_accepted_and_right(sheet, off):
    """Any ruling and ink, tilted, blurred, lit from one side, on a dark bench: lengths are right to a thousandth."""
    plane = calibrate(sheet, off)
    assert plane.accepted, plane.reasons
    assert sheet.length_error(plane) < 1e-3


@pytest.mark.parametrize(
    ("sheet", "off", "pitch_mm", "words"),
    [
        *((SHEET, off, None, r"px apart|too close") for off in (5.0, 2.0, 1.4, 0.7, 0.5, 0.2)),
        *((sheet_of("1"), off, None, r"px apart|too close") for off in (5.0, 0.1)),
        (SHEET, 1.0, 5.0, r"(7\.9|8\.\d) px apart in the picture, .* would be (39|40)\.\d px"),
    ],
)
def test_a_scale_or_a_pitch_that_the_sheet_contradicts_is_refused(sheet, off, pitch_mm, words):
    """The sentence has both distances between lines; the hint says what to measure. Five is typed for a 1 mm sheet."""
    with pytest.raises(CalibrationRefusedError, match=words) as caught:
        calibrate(sheet, off, pitch_mm=pitch_mm)
    assert "measure" in caught.value.hint or "come closer" in caught.value.hint


@pytest.mark.parametrize("turn_deg", [20.0, 45.0])
def test_a_second_sheet_is_refused(turn_deg):
    """Two sheets in one picture, of which one is turned."""
    first, second = (
        picture_of(sheet_of(roll_deg=roll, photo=replace(SHEET.photo, seed=number)))
        for number, roll in enumerate((0.0, turn_deg))
    )
    both = np.concatenate((first[:, :260], second[:, 260:]), axis=1)
    with pytest.raises(MeasurementRefusedError, match="two sheets") as caught:
        find_paper(both, 8.0)
    assert "take one" in caught.value.hint


def test_what_covers_the_paper_from_side_to_side_makes_no_second_sheet():
    """A ruler across the sheet hides its lines, and the larger part is used."""
    covered = picture_of(SHEET).copy()
    covered[100:130] = 240
    assert SHEET.length_error(calibrate(SHEET, picture=covered)) < 1e-3


def test_an_overexposed_picture_is_the_reason():
    """White everywhere: the hint is a shorter exposure."""
    with pytest.raises(MeasurementRefusedError, match="overexposed") as caught:
        find_paper(np.full((320, 480, 3), 255, np.uint8), 8.0)
    assert "exposure" in caught.value.hint


def test_a_lens_through_which_the_grid_is_no_square_is_refused():
    """The calibration of another camera shows in the shape of the cells."""
    plane = calibrate(SHEET, lens=replace(CAMERA.intrinsics, fy=1.06 * 760.0))
    assert not plane.accepted
    assert any("no square grid through the lens" in reason for reason in plane.reasons)


def test_a_map_says_what_its_scale_implies():
    """The picture's width in mm and the camera's distance, which a person checks with a ruler, and which tells it."""
    plane = calibrate(SHEET)
    assert plane.picture_mm == pytest.approx(CAMERA.picture_size_mm(), rel=0.005)
    assert plane.camera_distance_mm == pytest.approx(95.0, rel=0.005)
    assert "mm wide" in plane.view_sentence()
    assert plane.to_json()["camera_distance_mm"] == plane.camera_distance_mm
    assert find_px_per_mm(CAMERA.intrinsics, 95.0) == pytest.approx(8.0)


def test_a_sheet_the_size_of_a_phone_s_picture_is_read_as_well():
    """Lines a hundred pixels apart are followed in a smaller picture, and located in the whole one."""
    camera = replace(CAMERA, size=(1600, 1200), focal_px=2500.0, centre_px=(800.0, 600.0), distance_mm=125.0)
    sheet = Sheet("5", camera, replace(SHEET.photo, blur_px=1.8), samples=2)
    assert find_paper(sheet.draw(), 110.0).spacing_px == pytest.approx(100.0, rel=0.05)
