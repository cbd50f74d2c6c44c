"""Graph paper by an independent renderer: lines are counted right or the sheet is refused, and nothing else passes."""

from dataclasses import replace
from functools import cache, partial

import cv2
import numpy as np
import pytest

from labrig.errors import CalibrationRefusedError
from labrig.vision.graph_paper import find_crossings
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.plane_calibration import calibrate_plane
from tests.benchmarks.graph_paper import choose_penned_sheet, measure_sheet
from tests.vision import no_graph_paper
from tests.vision.paper_renderer import Camera, PenGrid, Sheet, draw_sheet

CAMERA = Camera(size=(800, 480), focal_px=1100.0, centre_px=(404.0, 236.0))
SMALL_CAMERA = Camera(size=(560, 360), focal_px=1100.0, centre_px=(284.0, 176.0))
MIDDLE = (400.0, 240.0)


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


def calibrate(sheet, pitch_mm=None, lens=None):
    """Return the plane map of a sheet's picture."""
    return calibrate_plane(
        picture_of(sheet), lens or lens_of(sheet.camera), pitch_mm or sheet.pitch_mm, MIDDLE, "right"
    )


def length_error(plane, sheet):
    """Return the largest relative error of a length in any direction."""
    px = np.array([(u, v) for u in range(40, 800, 60) for v in range(40, 480, 50)], dtype=float)
    true = sheet.to_mm(px)
    design = np.column_stack((true, np.ones(len(true))))
    affine = np.linalg.lstsq(design, plane.to_mm(px), rcond=None)[0]
    return float(np.abs(np.linalg.svd(affine[:2], compute_uv=False) - 1.0).max())


@pytest.mark.parametrize(
    ("ruling", "px_per_mm", "how"),
    [
        ("1/5/10", 5.0, {}),
        ("1/5/10", 12.0, {"roll_deg": -38.0}),
        ("1/5/10", 4.2, {"tilt_deg": 19.0}),
        ("1/10", 4.6, {"blur_px": 1.2}),
        ("1/10", 2.2, {"blur_px": 0.7}),
        ("2/10", 7.0, {"ink": "orange", "paper": "cream"}),
        ("1", 6.5, {"ink": "grey", "grey": True}),
        ("5", 6.0, {"ink": "green", "noise": 6.0}),
        ("5", 5.6, {"blur_px": 2.5}),
    ],
)
def test_lines_are_counted_right(ruling, px_per_mm, how):
    """The finest lines set the scale to a thousandth, seen or not, at any roll, under tilt, blur and noise."""
    sheet = sheet_of(ruling, px_per_mm, **how)
    plane = calibrate(sheet)
    turned = [reason for reason in plane.reasons if "turned" in reason]
    assert list(plane.reasons) == turned
    assert length_error(plane, sheet) < 1e-3


@pytest.mark.parametrize(
    ("ruling", "px_per_mm", "pitch_mm", "counted"),
    [
        ("1/5/10", 8.0, 5.0, "every 5th line is heavier"),
        ("1/10", 8.0, 5.0, "every 10th line is heavier"),
        ("2/10", 8.0, 5.0, "every 5th line is heavier"),
        ("1/5/10", 8.0, 2.0, "every 10th line is heavier"),
    ],
)
def test_a_pitch_that_contradicts_the_heavier_lines_is_refused(ruling, px_per_mm, pitch_mm, counted):
    """The reason says what was counted, how far apart heavier lines would be, and which pitch would fit."""
    plane = calibrate(sheet_of(ruling, px_per_mm), pitch_mm)
    assert not plane.accepted
    assert counted in plane.reasons[0]
    assert "would fit" in plane.reasons[0]


def test_lines_that_may_be_heavier_ones_are_refused():
    """Where finer lines are blurred away and nothing else tells the scale, the sheet is refused."""
    plane = calibrate(sheet_of("1/10", 1.8, blur_px=1.6))
    assert not plane.accepted
    assert "with finer lines between them that the picture does not show" in plane.reasons[0]


def test_lines_too_close_for_the_camera_are_the_reason():
    """Where fine lines are seen but not followed, their distance is stated, and that the camera has to come closer."""
    with pytest.raises(
        CalibrationRefusedError, match=r"lines in the picture are 2\.[45] px apart, too close"
    ) as caught:
        calibrate(sheet_of("1", 2.5, tilt_deg=2.0, blur_px=0.6))
    assert "come closer" in caught.value.hint


def test_printed_lines_between_drawn_ones_are_told_by_the_spectrum_where_blur_hides_them():
    """At 5.5 px from line to line and a blur of 1.4 px there is no dip between a drawn line and the printed one."""
    sharp = no_graph_paper.draw_second_grid(24.0, wobble_px=0.0)
    small = cv2.resize(sharp, (587, 330), interpolation=cv2.INTER_AREA)
    picture = np.asarray(cv2.GaussianBlur(small, (0, 0), 1.2), dtype=np.uint8)
    with pytest.raises(
        CalibrationRefusedError, match=r"between the lines .* px apart there are fainter ones"
    ):
        calibrate_plane(picture, None, 1.0, (300.0, 150.0), "right")


@pytest.mark.parametrize(
    "draw",
    [
        no_graph_paper.draw_lined_paper,
        no_graph_paper.draw_dotted_paper,
        no_graph_paper.draw_chessboard,
        no_graph_paper.draw_keyboard,
        lambda: no_graph_paper.draw_keyboard((0, 25, 50, 75)),
        no_graph_paper.draw_second_grid,
        lambda: no_graph_paper.draw_second_grid(60.0, 30.0),
        lambda: no_graph_paper.draw_second_grid(48.0),
        lambda: no_graph_paper.draw_second_grid(24.0, wobble_px=0.0),
        lambda: no_graph_paper.draw_second_grid(36.0, wobble_px=0.0),
    ],
    ids=[
        "lined",
        "dotted",
        "chessboard",
        "keyboard",
        "keyboard with even offsets",
        "second grid",
        "turned second grid",
        "on every 4th line",
        "on every 2nd line",
        "on every 3rd line",
    ],
)
def test_what_is_no_graph_paper_alone_is_refused(draw):
    """Lined and dotted paper, a chessboard, a keyboard, and a second grid drawn by hand give no accepted map."""
    try:
        accepted = calibrate_plane(draw(), None, 1.0, (600.0, 300.0), "right").accepted
    except CalibrationRefusedError:
        accepted = False
    assert not accepted


def test_the_same_paper_without_a_second_grid_is_accepted():
    """The drawing that the second grid was drawn on is good graph paper."""
    picture = no_graph_paper.photograph(no_graph_paper.draw_ruled_paper())
    assert find_crossings(picture).ruling.rhythm.heavy == 10


@pytest.mark.parametrize(
    ("ruling", "px_per_mm", "pen", "how", "reason"),
    [
        (
            "1/10",
            3.0,
            PenGrid(2, width_mm=0.35, density=0.8),
            {"grey": True, "blur_px": 1.15},
            "heavier ones every 5 mm, all alike",
        ),
        (
            "1/10",
            2.6,
            PenGrid(3, width_mm=0.48, colour="red"),
            {"blur_px": 1.2},
            "others at uneven distances",
        ),
        ("1/5/10", 3.1, PenGrid(4, width_mm=0.27, colour="pencil"), {}, "there are fainter ones"),
        ("1", 2.1, PenGrid(3, width_mm=0.4, colour="pencil"), {"ink": "green"}, "ink of another colour"),
        (
            "1",
            2.9,
            PenGrid(2, width_mm=0.4, colour="pencil"),
            {"ink": "grey", "blur_px": 1.2},
            "too blurred to tell",
        ),
        ("1", 2.65, PenGrid(5, width_mm=0.38), {"grey": True, "blur_px": 0.9}, "there are fainter ones"),
        (
            "1/10",
            3.0,
            PenGrid(4, width_mm=0.2, colour="red", density=0.63),
            {"blur_px": 1.2, "width_mm": 0.19, "density": 0.7, "camera": SMALL_CAMERA},
            "others at uneven distances",
        ),
        (
            "1/10",
            4.27,
            PenGrid(11, width_mm=0.45, colour="pencil", density=0.73),
            {"ink": "orange", "width_mm": 0.11, "density": 0.75, "blur_px": 1.09, "shift_mm": (6.3, 1.4)},
            "between the lines that were followed",
        ),
        (
            "2/10",
            2.48,
            PenGrid(12, first=4, width_mm=0.8, colour="pencil", density=0.84),
            {"width_mm": 0.19, "density": 0.35, "blur_px": 0.75, "shift_mm": (3.3, 5.4), "tilt_deg": 2.0},
            "there are fainter ones",
        ),
        (
            "1/10",
            1.7,
            PenGrid(11, first=5, width_mm=0.47, density=0.9),
            {"width_mm": 0.09, "density": 0.58, "blur_px": 1.04, "noise": 1.3, "grey": True},
            "between the lines that were followed",
        ),
        (
            "1/10",
            2.39,
            PenGrid(10, first=9, width_mm=0.41, colour="green", density=0.96),
            {"ink": "grey", "width_mm": 0.11, "density": 0.61, "blur_px": 0.54, "noise": 3.4},
            "beside the lines that were followed",
        ),
    ],
)
def test_a_pen_grid_over_lines_too_fine_to_see_is_refused(ruling, px_per_mm, pen, how, reason):
    """Lines drawn exactly over every second to twelfth printed line are not taken for the paper's."""
    sheet = sheet_of(ruling, px_per_mm, pen=pen, **how)
    try:
        reasons = calibrate(sheet).reasons
    except CalibrationRefusedError as refusal:
        reasons = (refusal.message,)
    assert any(reason in found for found in reasons)


def test_a_pen_grid_over_every_tenth_line_of_a_blurred_sheet_is_refused():
    """The tenth harmonic tells lines of the paper that the profile does not show."""
    _, sheet = choose_penned_sheet(214, 960_000)
    reason = measure_sheet(0, sheet, draw_sheet(sheet)).reason
    assert "there are fainter ones" in reason


def test_crossings_end_at_the_edge_of_the_paper():
    """No crossing lies beyond the ruled part, on the margin or on the desk, and a flat sheet stays flat."""
    sheet = sheet_of("5", 6.0, extent_mm=(-52.0, -28.0, 41.0, 33.0), margin_mm=3.0)
    found = find_crossings(picture_of(sheet))
    assert sheet.is_inside(sheet.to_mm(found.pixels), 0.2).all()
    plane = calibrate(sheet)
    assert plane.accepted, plane.reasons
    assert plane.bend is None
    assert plane.rms_mm < 0.02


def test_a_lens_through_which_the_grid_is_no_square_is_refused():
    """The calibration of another camera shows in the shape of the cells."""
    sheet = sheet_of("1/5/10", 8.0)
    lens = lens_of(CAMERA)
    plane = calibrate(sheet, lens=replace(lens, fy=1.06 * lens.fy))
    assert not plane.accepted
    assert any("no square grid through the lens" in reason for reason in plane.reasons)


def test_a_map_says_what_its_scale_implies():
    """The picture's width in mm and the camera's distance, which a person checks with a ruler."""
    sheet = sheet_of("1/5/10", 8.0)
    plane = calibrate(sheet)
    width, height = sheet.picture_size_mm()
    assert plane.picture_mm == pytest.approx((width, height), rel=0.005)
    assert plane.camera_distance_mm == pytest.approx(1100.0 / 8.0, rel=0.005)
    assert "mm wide" in plane.view_sentence()
    assert plane.to_json()["camera_distance_mm"] == plane.camera_distance_mm
