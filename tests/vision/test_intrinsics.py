"""The lens: the model and its inverse, Zhang's calibration and what it refuses; bent boards and bad views."""

import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError
from labrig.vision.calibrate_lens import (
    Charuco,
    board_points_mm,
    calibrate_from_pictures,
    calibrate_intrinsics,
    find_board,
)
from labrig.vision.calibration_file import load_intrinsics, save_intrinsics
from tests.vision.renderer import Board, Camera, bend_board, turn_about

CORNERS = Path(__file__).parent / "marks" / "opencv_left_corners.csv"
CAMERA = Camera((1280, 720), 1400.0, (645.0, 352.0), (-0.12, 0.05, 5e-4, -3e-4, 0.0), aspect=1403 / 1400)
SIZE, LENS = CAMERA.size, CAMERA.intrinsics
BOARD = Board(square_mm=6.0)
POINTS = board_points_mm(9, 6, 6.0)
# Tilt and turn [deg], and place [mm], as a careful person would hold the board.
POSES = ((0, 0, 0, 0), (35, 0, -15, 8), (-35, 0, 15, -8), (0, 35, -20, -6), (0, -35, 20, 6),
         (25, 25, 18, -9), (-25, 25, -18, 9), (30, -30, 0, 0))  # fmt: skip


def see_board(tilt_deg, turn_deg, shift=(0.0, 0.0), distance=120.0, noise=0.1, seed=0, camera=CAMERA):
    """Return the pixels of the board's corners in this pose."""
    turn = turn_about(*np.deg2rad((tilt_deg, turn_deg, 5.0)))
    return BOARD.see(camera, turn, (*shift, distance), noise, np.random.default_rng(seed))


def good_views(noise=0.1, seed=0, zoom=1.0):
    """Return eight views as a careful person would take them."""
    camera, distance = replace(CAMERA, focal_px=zoom * CAMERA.focal_px), 120.0 * max(zoom, 1.0)
    return [
        see_board(tilt, turn, place, distance, noise, 100 * seed + n, camera)
        for n, (tilt, turn, *place) in enumerate(POSES)
    ]


def calibrate(views, names=None):
    """Return the calibration from views of the whole board."""
    return calibrate_intrinsics([POINTS] * len(views), views, SIZE, names)


@settings(max_examples=50, deadline=None)
@given(u=st.floats(-0.5, 1279.5), v=st.floats(-0.5, 719.5))
def test_undistortion_undoes_distortion(u, v):
    """There and back is the same pixel, all over the picture."""
    assert LENS.distort_px(LENS.undistort_px([(u, v)])) == pytest.approx(np.array([(u, v)]), abs=1e-8)


def test_refuses_pixels_beyond_the_fold():
    """Where strong distortion folds the picture over, no ideal pixel is invented; other shapes are wrong input."""
    with pytest.raises(MeasurementRefusedError, match="no inverse at pixel"):
        replace(LENS, distortion=(-1.5, 0.0, 0.0, 0.0, 0.0)).undistort_px([(640.0, 360.0), (3.0, 3.0)])
    assert LENS.undistort_px(np.empty((0, 2))).shape == (0, 2)
    with pytest.raises(InputError, match="shape"):
        LENS.undistort_px([1.0, 2.0])


@pytest.mark.processors
def test_finds_the_camera_that_took_the_views():
    """Careful views of a board give the drawn camera within three standard deviations, and are accepted.

    The document has every key of the interface, and each view its four keys.
    """
    found = calibrate(good_views(), [f"view{n}.png" for n in range(8)])
    for name, true in [("fx", 1400.0), ("fy", 1403.0), ("cx", 645.0), ("cy", 352.0)]:
        assert abs(getattr(found, name) - true) < 3.0 * found.sigma[name], name
    assert found.accepted, found.reasons
    assert found.rms_px == pytest.approx(0.1 * np.sqrt(2.0), rel=0.1)
    assert found.holdout_rms_px == pytest.approx(found.rms_px, rel=0.2)
    assert all(view.used for view in found.views)
    document = found.to_json()
    keys = "accepted reasons fx fy cx cy sigma distortion rms_px holdout_rms_px"
    assert set(keys.split()) < set(document)
    assert list(document["sigma"]) == ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"]
    assert set(document["views"][0]) == {"image", "rms_px", "used", "reason"}
    assert (len(document["distortion"]), document["views"][3]["image"]) == (5, "view3.png")


SHIFTS = (
    ((-20.0, 0.0), 130.0), ((20.0, 0.0), 130.0), ((0.0, 8.0), 110.0), ((0.0, -8.0), 150.0),
    ((0.0, 0.0), 95.0),
)  # fmt: skip
TILTS = ((0, 0), (40, 0), (-40, 0), (0, 40), (0, -40), (30, 30))
FAR = {"distance": 300.0}
REFUSED = {
    "nearly identical": (
        lambda: [see_board(3.0 + 0.3 * n, 2.0, (0.2 * n, 0.0), seed=n) for n in range(5)],
        "tilts differ.*makes radii uncertain by|makes radii uncertain by.*tilts differ",
    ),
    "all parallel": (
        lambda: [see_board(0, 0, *how, seed=n) for n, how in enumerate(SHIFTS)],
        "tilts differ.*edge towards the camera",
    ),
    "in the middle only": (
        lambda: [see_board(*tilt, **FAR, seed=n) for n, tilt in enumerate(TILTS)],
        "boards cover.*near the picture's corners",
    ),
    "away from a corner": (
        lambda: [see_board(tilt, 0.0, (8.0, 6.0), **FAR, seed=tilt) for tilt in (0, 4, 8, 12, 15)],
        "boards cover.*closer",
    ),
    "one": (lambda: good_views()[1:2], "cannot be checked"),
    "two": (lambda: good_views()[1:3], "cannot be checked"),
    "noisy": (
        lambda: good_views(noise=2.5),
        "makes radii uncertain by.*views held out of the fit are|views held out of the fit are.*makes radii",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_refuses_views_that_leave_the_lens_uncertain(kind):
    """However well the corners fit, the lens is refused, and the reasons say what to photograph next."""
    draw, words = REFUSED[kind]
    found = calibrate(draw())
    assert not found.accepted
    assert re.search(words, " ".join(found.reasons)), found.reasons


@pytest.mark.parametrize(
    ("boards", "pixels", "message"),
    [
        ([], [], "no views"),
        ([POINTS], [], "do not match"),
        ([POINTS], [POINTS[:-1]], "not both"),
        ([POINTS[:, :1]], [POINTS[:, :1]], "not both"),
        ([POINTS[:3]], [POINTS[:3]], "3 corners"),
        ([POINTS], [np.where(POINTS > 20.0, np.nan, POINTS)], "not finite"),
        ([POINTS], [POINTS + np.array([1250.0, 0.0])], "outside the picture of 1280 x 720"),
    ],
)
def test_refuses_lists_that_do_not_make_views(boards, pixels, message):
    """Empty, unequal, misshapen, non-finite and outlying corners are wrong input."""
    with pytest.raises(InputError, match=message):
        calibrate_intrinsics(boards, pixels, SIZE)


def draw_board(turn_deg=0.0, square_px=40, blur=1.0):
    """Return a picture of a 7 x 5 board and where its corners are."""
    squares = (np.indices((6 * square_px, 8 * square_px)) // square_px).sum(axis=0) % 2
    sheet = np.pad(np.where(squares == 0, 30, 220).astype(np.uint8), 120, constant_values=220)
    height, width = sheet.shape
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), turn_deg, 1.0)
    picture = cv2.warpAffine(sheet, turn, (width, height), flags=cv2.INTER_AREA, borderValue=220)
    row, column = np.mgrid[1:6, 1:8]
    # A corner is the border of four pixels, half a pixel before the first of them.
    corners = np.column_stack((column.ravel(), row.ravel())) * square_px + 120 - 0.5
    return cv2.GaussianBlur(picture, (0, 0), blur), corners @ turn[:, :2].T + turn[:, 2]


@pytest.mark.processors
@pytest.mark.parametrize("turn_deg", [0.0, 7.0, -20.0])
def test_finds_corners_where_they_were_drawn(turn_deg):
    """Corners are found to a twentieth of a pixel, with pixel centres at integers."""
    picture, corners = draw_board(turn_deg)
    found = find_board(picture, 7, 5).pixels
    distance = np.linalg.norm(found[:, None] - corners[None], axis=2).min(axis=1)
    assert found.shape == (35, 2)
    assert distance.max() < 0.05


def test_pictures_without_the_board_or_of_another_size_are_listed_and_left_out():
    """Each keeps its place, with the reason, and the rest goes on; copies of one are no evidence, however they fit."""
    picture, _ = draw_board()
    shown = (picture, picture[:100, :100], np.full_like(picture, 90), *[picture] * 4)
    pictures = [(f"{n}.png", image) for n, image in enumerate(shown)]
    found = calibrate_from_pictures(pictures, 7, 5, 10.0)
    assert [view.image for view in found.views] == [name for name, _ in pictures]
    assert [view.used for view in found.views] == [True, False, False, *(True,) * 4]
    assert "100 x 100 pixels, the calibration is for 560 x 480" in found.views[1].reason
    assert "the picture is even grey" in found.views[2].reason
    assert found.views[2].rms_px is None
    assert not found.accepted
    assert any("tilts differ by" in reason for reason in found.reasons)


@pytest.mark.parametrize(("zoom", "others"), [(0.8, 2), (1.2, 2), (1.02, 3)])
def test_views_of_another_setting_are_named(zoom, others):
    """Views of another focal length are left out, though a fit over all looks fine; more than a third are refused."""
    views = [*good_views()[: 8 - others], *good_views(seed=1, zoom=zoom)[8 - others :]]
    found = calibrate(views, [f"{n}.png" for n in range(8)])
    assert found.accepted == (others == 2), found.reasons
    if found.accepted:
        assert {view.image for view in found.views if not view.used} == {"6.png", "7.png"}
        assert found.fx == pytest.approx(1400.0, abs=3.5 * found.sigma["fx"])
    else:
        assert "contradict the others" in found.reasons[0]
        assert "zoom and focus fixed" in found.reasons[0]


def test_refuses_pictures_without_any_board():
    """If no picture shows the board, the calibration is refused."""
    blank = np.full((480, 640), 128, dtype=np.uint8)
    with pytest.raises(CalibrationRefusedError, match="any of 2 pictures"):
        calibrate_from_pictures([("a.png", blank), ("b.png", blank)], 9, 6, 25.0)
    with pytest.raises(MeasurementRefusedError, match="9 x 6 inner corners") as caught:
        find_board(draw_board()[0], 9, 6)
    assert "margin" in caught.value.hint
    with pytest.raises(InputError, match="no pictures"):
        calibrate_from_pictures([], 9, 6, 25.0)


@pytest.mark.processors
def test_calibrates_from_real_photographs():
    """The left set gives the published focal length and is accepted, and every parameter of mrcal within 0.05 sigma.

    mrcal 2.2 fitted the same corners, with the warp of the board.
    """
    rows = np.loadtxt(CORNERS, delimiter=",", skiprows=1, dtype=str)
    views = [rows[rows[:, 0] == name][:, 2:].astype(float) for name in dict.fromkeys(rows[:, 0])]
    found = calibrate_intrinsics([board_points_mm(9, 6, 25.0)] * len(views), views, (640, 480))
    assert found.fx == pytest.approx(532.83, abs=2 * 0.44)
    assert found.fy == pytest.approx(532.95, abs=2 * 0.46)
    assert found.rms_px < 0.22
    assert found.holdout_rms_px < 0.25
    assert found.accepted, found.reasons
    assert len(found.views) == 13
    focal = (533.2582, 533.38, 342.0852, 234.2647)
    distortion = (-0.2814055, 0.03508815, 1.045154e-3, -1.140617e-4, 0.1388458)
    shares = (np.array(found.parameters()) - (*focal, *distortion)) / list(found.sigma.values())
    assert np.abs(shares).max() < 0.05
    # mrcal's z points away from the camera: 0.0450 and -0.1674 mm.
    assert found.board_warp.row_mm == pytest.approx(-0.0450, abs=0.005)
    assert found.board_warp.column_mm == pytest.approx(0.1674, abs=0.005)


def draw_charuco(cut):
    """Return a drawn ChArUco board of 8 x 6 squares, the first `cut` columns of pixels gone."""
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    sheet = cv2.aruco.CharucoBoard((8, 6), 1.0, 0.7, book)
    return cv2.GaussianBlur(sheet.generateImage((800, 600), marginSize=0), (0, 0), 0.8)[:, cut:]


@pytest.mark.parametrize("cut", [0, 250])
def test_charuco_corners_are_found_where_they_were_drawn(cut):
    """A ChArUco board may be cut by the frame: what is seen of it has the right numbers and places."""
    seen = find_board(draw_charuco(cut), 7, 5, Charuco("DICT_5X5_100", 0.7))
    assert len(seen.pixels) >= (35 if not cut else 20)
    # Squares are 100 px; their borders lie between pixels.
    corners = board_points_mm(7, 5, 100.0)[seen.corners] + 100.0
    assert seen.pixels == pytest.approx(corners - 0.5 - (cut, 0.0), abs=0.05)


@pytest.mark.parametrize(
    "look",
    [
        *(partial(board_points_mm, *board) for board in ((2, 6, 25.0), (9, 0, 25.0), (9, 6, 0.0), (9, 6, np.nan))),
        partial(find_board, draw_charuco(0), 7, 5, Charuco("NONE", 0.7)),
        partial(find_board, draw_charuco(0), 7, 5, Charuco("DICT_5X5_100", 1.2)),
    ],
)  # fmt: skip
def test_refuses_boards_that_cannot_be(look):
    """At least three by three corners, squares of a positive size, a known dictionary and markers inside of squares."""
    with pytest.raises(InputError, match=r"board|no dictionary|marker's side"):
        look()


def test_standard_deviations_are_numbers_or_unknown():
    """With hardly more corners than unknowns no standard deviation is NaN, as OpenCV's may be."""
    corners = [0, 8, 22, 31, 45, 53]
    with pytest.raises(CalibrationRefusedError, match="6 corners are too few for a camera, 8 are the least"):
        calibrate_intrinsics([POINTS[corners]], [good_views()[1][corners]], SIZE)
    for count in (2, 3):
        views = [view[corners] for view in good_views()[:count]]
        found = calibrate_intrinsics([POINTS[corners]] * count, views, SIZE)
        assert not found.accepted
        assert all(sigma is None or np.isfinite(sigma) for sigma in found.sigma.values())
        assert json.loads(json.dumps(found.to_json(), allow_nan=False))["sigma"].keys() == found.sigma.keys()


FULL_LENS = (-0.15, 0.06, 4e-4, -3e-4, 0.0)
FULL_CAMERA = Camera(focal_px=1100.0, centre_px=(645.0, 352.0), distortion=FULL_LENS, aspect=1102 / 1100)
FLAT, SLIGHT = Board(), bend_board(0.1, 0.05)


def views_of(board, count, seed, camera=FULL_CAMERA, **how):
    """Return the corners of a board in so many random poses."""
    return board.see_often(camera, count, seed, **how)


def calibrate_full(views, **how):
    """Return the calibration from views of the whole board, named by their numbers."""
    names = [str(index) for index in range(len(views))]
    return calibrate_intrinsics([FLAT.points_mm] * len(views), views, FULL_CAMERA.size, names, **how)


def left_out(found):
    """Return the numbers of the views that were left out."""
    return [int(view.image) for view in found.views if not view.used]


def test_sigma_of_the_focal_length_holds_for_warped_boards():
    """For warps of 0 to 0.5 mm, the errors of fx are about as large as their stated standard deviations."""
    shares = []
    for draw in range(24):
        warp_mm = 0.5 * (draw % 3) / 2
        found = calibrate_full(views_of(bend_board(warp_mm, 0.5 * warp_mm), 8, (8, draw)))
        shares.append((found.fx - FULL_CAMERA.focal_px) / found.sigma["fx"])
        assert found.board_warp.row_mm == pytest.approx(warp_mm, abs=4.0 * found.board_warp.sigma_row_mm)
        assert found.board_warp.column_mm == pytest.approx(
            0.5 * warp_mm, abs=4.0 * found.board_warp.sigma_column_mm
        )
    # Of 24 draws, the rms of a standard normal variable is 0.65 to 1.4 in 999 of 1000 cases.
    assert 0.65 < np.sqrt(np.mean(np.square(shares))) < 1.4


@pytest.mark.processors
def test_warp_is_positive_towards_the_camera_whatever_the_numbering():
    """A middle that stands towards the camera is positive, also if the board's rows are numbered upwards."""
    views = views_of(bend_board(0.4, -0.2), 8, 1)
    mirrored = [FLAT.points_mm * (1.0, -1.0)] * 8
    for found in (calibrate_full(views), calibrate_intrinsics(mirrored, views, FULL_CAMERA.size)):
        assert found.board_warp.row_mm == pytest.approx(0.4, abs=0.05)
        assert found.board_warp.column_mm == pytest.approx(-0.2, abs=0.05)


def test_parts_of_a_board_share_its_warp():
    """Views that show parts of the board with an origin of their own find the warp of the whole board."""
    board = bend_board(0.4, 0.2)
    points = FLAT.points_mm
    views = views_of(board, 10, 2)
    left, right = points[:, 0] <= 150.0, points[:, 0] >= 50.0
    parts = [left if index % 2 else right for index in range(10)]
    boards = [points[part] - points[part].min(axis=0) for part in parts]
    found = calibrate_intrinsics(
        boards, [view[part] for view, part in zip(views, parts, strict=True)], FULL_CAMERA.size
    )
    # The height over 150 mm of 200 mm.
    assert found.board_warp.row_mm == pytest.approx(0.4 * 0.75**2, abs=0.05)


def test_a_board_that_may_be_turned_has_one_warp():
    """Where views may show the board turned by 90 degrees, the same height is fitted along rows and columns."""
    square = replace(bend_board(0.3, 0.3), columns=7, rows=7)
    views = views_of(square, 8, 3)
    turned = square.points_mm[:, ::-1] * (1.0, -1.0)
    boards = [turned if index % 2 else square.points_mm for index in range(8)]
    warp = calibrate_intrinsics(boards, views, FULL_CAMERA.size).board_warp
    assert warp.row_mm == warp.column_mm == pytest.approx(0.3, abs=0.05)


def test_a_warp_that_the_views_do_not_tell_is_left_at_zero():
    """Of one view the warp stays at zero within its prior deviation, and the sentence says so."""
    warp = calibrate_full(views_of(bend_board(0.5, 0.0), 1, 4, tilt_deg=2.0)).board_warp
    assert abs(warp.row_mm) < 0.5 * warp.prior_mm
    assert warp.sigma_row_mm == pytest.approx(warp.prior_mm, rel=0.2)
    assert "hardly tell the warp" in warp.sentence()
    assert f"within {warp.prior_mm:.3f} mm" in warp.sentence()


def accelerate(view):
    """Return the view as a rolling shutter takes it while the camera accelerates sideways."""
    v = (view[:, 1] - view[:, 1].mean()) / np.ptp(view[:, 1])
    return view + np.column_stack((16.0 * v**2, np.zeros(len(v))))


LONGER = replace(FULL_CAMERA, focal_px=1.05 * FULL_CAMERA.focal_px)
BAD_FRAMES = {
    "bent": lambda: views_of(bend_board(4.0, 0.0), 1, 11)[0],
    "twisted": lambda: views_of(Board(height_mm=lambda x, y: 3.0 * x * y), 1, 12)[0],
    "rolling shutter": lambda: accelerate(views_of(SLIGHT, 1, 13)[0]),
    "another focus": lambda: views_of(SLIGHT, 1, 14, LONGER)[0],
    "noise": lambda: views_of(SLIGHT, 1, 15, noise_px=1.5)[0],
}


@pytest.mark.parametrize("kind", BAD_FRAMES)
def test_one_bad_frame_is_named_and_left_out(kind):
    """A single bad frame is listed with the reason, the rest gives the camera, and nobody speaks of two cameras."""
    views = views_of(SLIGHT, 9, 20)
    found = calibrate_full([*views[:4], BAD_FRAMES[kind](), *views[4:]])
    assert left_out(found) == [4]
    assert re.search(
        "px from where the other views put them|longer than that of the other views", found.views[4].reason
    )
    assert found.accepted, found.reasons
    assert found.fx == pytest.approx(FULL_CAMERA.focal_px, abs=3.5 * found.sigma["fx"])


@pytest.mark.parametrize(("good", "accepted"), [(9, True), (6, False)])
def test_more_bad_views_than_a_third_are_refused(good, accepted):
    """Frames that are each bad in their own way are left out; where they are too many the rest is no evidence."""
    heights = ((4.0, 0.0), (-4.0, 0.0)) if accepted else ((6.0, 0.0), (-6.0, 0.0), (0.0, 7.0), (5.0, -5.0))
    odd = [views_of(bend_board(*each), 1, 11 * accepted + index)[0] for index, each in enumerate(heights)]
    found = calibrate_full([*views_of(SLIGHT, good, 21 + (not accepted)), *odd])
    assert found.accepted == accepted, found.reasons
    if accepted:
        assert left_out(found) == [good, good + 1]
    else:
        assert any(
            "contradict the others and were left out, at most a third may be" in why for why in found.reasons
        )


@pytest.mark.processors
def test_good_views_are_kept_where_the_others_hardly_tell_the_lens():
    """Of four good views none is left out because the other three predict it badly."""
    for seed in range(6):
        assert left_out(calibrate_full(views_of(SLIGHT, 4, (23, seed)))) == []


def test_sigma_by_views_is_that_of_a_jackknife_and_a_file_keeps_it(tmp_path):
    """Of boards that are bent otherwise in each view the sigma of fx agrees with fits that leave out one in turn."""
    count, random = 12, np.random.default_rng(3)
    views = [views_of(bend_board(*random.normal(0.1, 0.15, 2)), 1, random)[0] for _ in range(count)]
    found = calibrate_full(views)
    jackknife = np.std([calibrate_full(views[:n] + views[n + 1 :]).fx for n in range(count)]) * np.sqrt(
        count - 1
    )
    # The scatter is used in no direction below the corners' noise, so it may be larger.
    assert 0.95 * jackknife < found.sigma["fx"] < 1.3 * jackknife
    save_intrinsics(tmp_path / "intrinsics.json", found, {})
    kept = [replace(view, corners_px=(), errors_px=()) for view in found.views]
    assert load_intrinsics(tmp_path / "intrinsics.json") == replace(found, views=tuple(kept))
