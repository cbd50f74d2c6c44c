"""The lens: the model and its inverse, Zhang's calibration, and what it refuses."""

import json
from functools import cache
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
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.picture import read_picture

PHOTOGRAPHS = Path(__file__).parents[2].parent / "shared" / "data" / "opencv_chess"
ZHANG = Path(__file__).parents[2].parent / "shared" / "data" / "zhang"
SIZE = (1280, 720)
MATRIX = np.array([[1400.0, 0.0, 645.0], [0.0, 1403.0, 352.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.12, 0.05, 5e-4, -3e-4, 0.0])
BOARD = board_points_mm(9, 6, 6.0)


def lens(distortion=tuple(DISTORTION)):
    """Return the lens that draws the views of these tests."""
    return Intrinsics(
        image_size=SIZE,
        fx=MATRIX[0, 0],
        fy=MATRIX[1, 1],
        cx=MATRIX[0, 2],
        cy=MATRIX[1, 2],
        distortion=distortion,
        sigma={"fx": 0.5, "fy": 0.5, "cx": 0.5, "cy": 0.5},
        rms_px=0.1,
        holdout_rms_px=0.1,
        views=(),
        accepted=True,
        reasons=(),
    )


def project_board(tilt_deg, turn_deg, shift=(0.0, 0.0), distance=120.0, noise=0.1, seed=0, zoom=1.0):
    """Return the pixels of the board's corners in this pose."""
    first = cv2.Rodrigues(np.deg2rad(np.array([tilt_deg, turn_deg, 5.0])))[0]
    centre = np.append(BOARD.mean(axis=0), 0.0)
    corners = (np.column_stack((BOARD, np.zeros(len(BOARD)))) - centre) @ first.T + (*shift, distance)
    matrix = MATRIX * [[zoom, 1.0, 1.0], [1.0, zoom, 1.0], [1.0, 1.0, 1.0]]
    px = cv2.projectPoints(corners, np.zeros(3), np.zeros(3), matrix, DISTORTION)[0].reshape(-1, 2)
    return px + np.random.default_rng(seed).normal(0.0, noise, px.shape)


def good_views(noise=0.1, seed=0, zoom=1.0):
    """Return eight views as a careful person would take them."""
    poses = [(0, 0, 0, 0), (35, 0, -15, 8), (-35, 0, 15, -8), (0, 35, -20, -6), (0, -35, 20, 6)]
    poses += [(25, 25, 18, -9), (-25, 25, -18, 9), (30, -30, 0, 0)]
    return [
        project_board(a, b, (u, v), 120.0 * max(zoom, 1.0), noise, 100 * seed + n, zoom)
        for n, (a, b, u, v) in enumerate(poses)
    ]


def calibrate(views, names=None):
    """Return the calibration from views of the whole board."""
    return calibrate_intrinsics([BOARD] * len(views), views, SIZE, names)


@settings(max_examples=50, deadline=None)
@given(u=st.floats(-0.5, 1279.5), v=st.floats(-0.5, 719.5))
def test_undistortion_undoes_distortion(u, v):
    """There and back is the same pixel, all over the picture."""
    assert lens().distort_px(lens().undistort_px([(u, v)])) == pytest.approx(np.array([(u, v)]), abs=1e-8)


def test_distortion_is_opencv_s():
    """The model puts ideal pixels where `cv2.projectPoints` does."""
    directions = np.random.default_rng(0).uniform((-0.4, -0.2), (0.4, 0.2), (50, 2))
    flat = np.column_stack((directions, np.ones(50)))
    expected = cv2.projectPoints(flat, np.zeros(3), np.zeros(3), MATRIX, DISTORTION)[0].reshape(-1, 2)
    ideal = flat @ MATRIX.T
    assert lens().distort_px(ideal[:, :2]) == pytest.approx(expected, abs=1e-9)


def test_refuses_pixels_beyond_the_fold():
    """Where strong distortion folds the picture over, no ideal pixel is invented."""
    with pytest.raises(MeasurementRefusedError, match="no inverse at pixel"):
        lens((-1.5, 0.0, 0.0, 0.0, 0.0)).undistort_px([(640.0, 360.0), (3.0, 3.0)])


def test_undistortion_of_nothing_is_nothing():
    """No pixels in, no pixels out; and other shapes are wrong input."""
    assert lens().undistort_px(np.empty((0, 2))).shape == (0, 2)
    with pytest.raises(InputError, match="shape"):
        lens().undistort_px([1.0, 2.0])


def test_fingerprint_follows_the_model_alone():
    """Two calibrations with the same numbers are the same lens; another number is another lens."""
    assert lens().fingerprint() == lens().fingerprint()
    assert lens().fingerprint() != lens((-0.12, 0.05, 5e-4, -3e-4, 1e-9)).fingerprint()


@pytest.mark.processors
def test_finds_the_camera_that_took_the_views():
    """Careful views of a board give the drawn camera within three standard deviations, and are accepted."""
    found = calibrate(good_views())
    for name, true in [("fx", 1400.0), ("fy", 1403.0), ("cx", 645.0), ("cy", 352.0)]:
        assert abs(getattr(found, name) - true) < 3.0 * found.sigma[name], name
    assert found.accepted, found.reasons
    assert found.rms_px == pytest.approx(0.1 * np.sqrt(2.0), rel=0.1)
    assert found.holdout_rms_px == pytest.approx(found.rms_px, rel=0.2)
    assert all(view.used for view in found.views)


def test_claimed_spread_is_the_observed_one():
    """The stated standard deviation of the focal length matches repeated calibrations."""
    found = [calibrate(good_views(noise=0.3, seed=seed)) for seed in range(40)]
    observed = np.std([lens.fx for lens in found])
    assert observed == pytest.approx(np.mean([lens.sigma["fx"] for lens in found]), rel=0.35)


def test_to_json_holds_the_keys_that_others_rely_on():
    """The document has every key of the interface, and each view its four keys."""
    document = calibrate(good_views(), [f"view{n}.png" for n in range(8)]).to_json()
    assert {
        "accepted",
        "reasons",
        "fx",
        "fy",
        "cx",
        "cy",
        "sigma",
        "distortion",
        "rms_px",
        "holdout_rms_px",
    } < set(document)
    assert set(document["sigma"]) == {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"}
    assert len(document["distortion"]) == 5
    assert set(document["views"][0]) == {"image", "rms_px", "used", "reason"}
    assert document["views"][3]["image"] == "view3.png"


SHIFTS = [
    ((-20.0, 0.0), 130.0),
    ((20.0, 0.0), 130.0),
    ((0.0, 8.0), 110.0),
    ((0.0, -8.0), 150.0),
    ((0.0, 0.0), 95.0),
]
TILTS = [(0, 0), (40, 0), (-40, 0), (0, 40), (0, -40), (30, 30)]
REFUSED = {
    "nearly identical": (
        lambda: [project_board(3.0 + 0.3 * n, 2.0, (0.2 * n, 0.0), seed=n) for n in range(5)],
        ("tilts differ", "makes radii uncertain by"),
    ),
    "all parallel": (
        lambda: [project_board(0, 0, *how, seed=n) for n, how in enumerate(SHIFTS)],
        ("tilts differ", "edge towards the camera"),
    ),
    "in the middle only": (
        lambda: [project_board(*tilt, distance=300.0, seed=n) for n, tilt in enumerate(TILTS)],
        ("boards cover", "near the picture's corners"),
    ),
    "away from a corner": (
        lambda: [
            project_board(tilt, 0.0, (8.0, 6.0), distance=300.0, seed=tilt) for tilt in (0, 4, 8, 12, 15)
        ],
        ("boards cover", "closer"),
    ),
    "one": (lambda: good_views()[1:2], ("cannot be checked",)),
    "two": (lambda: good_views()[1:3], ("cannot be checked",)),
    "noisy": (
        lambda: good_views(noise=2.5),
        ("makes radii uncertain by", "views left out of the fit are"),
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_refuses_views_that_leave_the_lens_uncertain(kind):
    """However well the corners fit, the lens is refused, and the reasons say what to photograph next."""
    draw, words = REFUSED[kind]
    found = calibrate(draw())
    assert not found.accepted
    assert all(word in " ".join(found.reasons) for word in words), found.reasons


@pytest.mark.processors
def test_leaves_out_a_gross_view():
    """A view with wrong corners is left out and listed with its error; the rest is used."""
    views = good_views()
    views[4] = views[4] + np.random.default_rng(9).normal(0.0, 15.0, views[4].shape)
    found = calibrate(views, [f"{n}.png" for n in range(8)])
    clean = calibrate([view for n, view in enumerate(views) if n != 4])
    assert [view.image for view in found.views if not view.used] == ["4.png"]
    assert "px from where the other views put them" in found.views[4].reason
    assert found.fx == pytest.approx(clean.fx, abs=0.01 * clean.sigma["fx"])
    assert found.accepted


def test_views_may_show_different_corners():
    """Each view brings its own corners, in any number."""
    views = good_views()
    boards = [BOARD[n:] for n in range(8)]
    found = calibrate_intrinsics(boards, [view[n:] for n, view in enumerate(views)], SIZE)
    assert found.fx == pytest.approx(1400.0, rel=2e-3)


@pytest.mark.parametrize(
    ("boards", "pixels", "message"),
    [
        ([], [], "no views"),
        ([BOARD], [], "do not match"),
        ([BOARD], [BOARD[:-1]], "not both"),
        ([BOARD[:, :1]], [BOARD[:, :1]], "not both"),
        ([BOARD[:3]], [BOARD[:3]], "3 corners"),
        ([BOARD], [np.where(BOARD > 20.0, np.nan, BOARD)], "not finite"),
        ([BOARD], [BOARD + np.array([1250.0, 0.0])], "outside the picture of 1280 x 720"),
    ],
)
def test_refuses_lists_that_do_not_make_views(boards, pixels, message):
    """Empty, unequal, misshapen, non-finite and outlying corners are wrong input."""
    with pytest.raises(InputError, match=message):
        calibrate_intrinsics(boards, pixels, SIZE)


@pytest.mark.parametrize(
    ("columns", "rows", "square"), [(2, 6, 25.0), (9, 0, 25.0), (9, 6, 0.0), (9, 6, float("nan"))]
)
def test_refuses_boards_that_cannot_be(columns, rows, square):
    """A board has at least three by three inner corners, and squares of a positive size."""
    with pytest.raises(InputError, match="board"):
        board_points_mm(columns, rows, square)


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


def test_says_that_there_is_no_board():
    """A picture without the board is refused with a hint."""
    with pytest.raises(MeasurementRefusedError, match="9 x 6 inner corners") as caught:
        find_board(draw_board()[0], 9, 6)
    assert "margin" in caught.value.hint


def test_pictures_of_another_size_are_left_out():
    """A picture of another camera setting is listed with both sizes, and the rest goes on."""
    picture, _ = draw_board()
    pictures = [("a.png", picture), ("b.png", picture[:100, :100]), ("c.png", picture)]
    found = calibrate_from_pictures(pictures, 7, 5, 10.0)
    assert [view.used for view in found.views] == [True, False, True]
    assert "100 x 100 pixels, the calibration is for 560 x 480" in found.views[1].reason


def test_views_of_another_camera_are_left_out():
    """Among eight views, a view of another camera with the same picture size is found and named."""
    views = good_views()
    other = MATRIX * [[0.8, 1, 1], [1, 0.8, 1], [1, 1, 1]]
    tilt = cv2.Rodrigues(np.deg2rad(np.array([25.0, 20.0, 5.0])))[0]
    corners = (np.column_stack((BOARD, np.zeros(len(BOARD)))) - [24.0, 15.0, 0.0]) @ tilt.T + (0.0, 0.0, 90.0)
    seen_there = cv2.projectPoints(corners, np.zeros(3), np.zeros(3), other, np.zeros(5))[0].reshape(-1, 2)
    found = calibrate([*views, seen_there])
    assert not found.views[8].used
    assert "from where the other views put them" in found.views[8].reason
    assert found.fx == pytest.approx(1400.0, rel=2e-3)


@pytest.mark.parametrize(("zoom", "others"), [(0.8, 2), (0.8, 4), (1.02, 3), (1.2, 2)])
def test_views_of_another_setting_are_named(zoom, others):
    """Views of another focal length are left out, though a fit over all looks fine; more than a third are refused."""
    views = [*good_views()[: 8 - others], *good_views(seed=1, zoom=zoom)[8 - others :]]
    found = calibrate(views, [f"{n}.png" for n in range(8)])
    odd = {int(view.image[0]) for view in found.views if not view.used}
    if others == 2:
        assert odd == {6, 7}
        assert found.accepted, found.reasons
        assert found.fx == pytest.approx(1400.0, abs=3.5 * found.sigma["fx"])
    else:
        assert not found.accepted
        assert "contradict the others" in found.reasons[0]
        assert "zoom and focus fixed" in found.reasons[0]


def test_three_views_that_contradict_one_another_are_refused():
    """Of three views, too, one that the other two do not predict is found."""
    views = good_views()[1:4]
    views[2] = views[2] + np.random.default_rng(9).normal(0.0, 8.0, views[2].shape)
    found = calibrate(views)
    assert not found.accepted
    assert sum(not view.used for view in found.views) == 1


def test_refuses_pictures_without_any_board():
    """If no picture shows the board, the calibration is refused."""
    blank = np.full((480, 640), 128, dtype=np.uint8)
    with pytest.raises(CalibrationRefusedError, match="any of 2 pictures"):
        calibrate_from_pictures([("a.png", blank), ("b.png", blank)], 9, 6, 25.0)
    with pytest.raises(InputError, match="no pictures"):
        calibrate_from_pictures([], 9, 6, 25.0)


@cache
def photographs():
    """Return the real photographs with their names, or skip."""
    if not PHOTOGRAPHS.is_dir():
        pytest.skip(f"the chessboard photographs are not at {PHOTOGRAPHS}")
    return [(path.name, read_picture(path)) for path in sorted(PHOTOGRAPHS.glob("left*.jpg"))]


@cache
def real_lens():
    """Return the lens of the real photographs."""
    return calibrate_from_pictures(photographs(), 9, 6, 25.0)


def test_calibrates_from_real_photographs():
    """OpenCV's thirteen photographs give the published focal length and are accepted."""
    found = real_lens()
    assert found.fx == pytest.approx(532.83, abs=2 * 0.44)
    assert found.fy == pytest.approx(532.95, abs=2 * 0.46)
    assert found.rms_px < 0.22
    assert found.holdout_rms_px < 0.25
    assert found.accepted, found.reasons
    assert len(found.views) == 13


@pytest.mark.processors
def test_lens_and_warp_are_mrcal_s():
    """mrcal 2.2 on the same corners, with the warp of the board, gives every parameter within 0.05 sigma."""
    found = real_lens()
    focal, distortion = (
        (533.2582, 533.38, 342.0852, 234.2647),
        (-0.2814055, 0.03508815, 1.045154e-3, -1.140617e-4),
    )
    shares = (np.array(found.parameters()) - (*focal, *distortion, 0.1388458)) / list(found.sigma.values())
    assert np.abs(shares).max() < 0.05
    # mrcal's z points away from the camera: 0.0450 and -0.1674 mm.
    assert found.board_warp.row_mm == pytest.approx(-0.0450, abs=0.005)
    assert found.board_warp.column_mm == pytest.approx(0.1674, abs=0.005)


def test_lists_photographs_without_the_board():
    """A photograph without a board keeps its place in the list, unused, with the reason."""
    pictures = list(photographs())
    pictures.insert(2, ("blank.png", np.full_like(pictures[0][1], 90)))
    found = calibrate_from_pictures(pictures, 9, 6, 25.0)
    assert found.views[2].image == "blank.png"
    assert not found.views[2].used
    assert found.views[2].rms_px is None
    assert "the picture is even grey" in found.views[2].reason
    assert [view.image for view in found.views] == [name for name, _ in pictures]


def test_refuses_one_photograph_taken_five_times():
    """Copies are no evidence, however well they fit."""
    found = calibrate_from_pictures([photographs()[0]] * 5, 9, 6, 25.0)
    assert not found.accepted
    assert any("tilts differ by" in reason for reason in found.reasons)


def draw_charuco(cut):
    """Return a drawn ChArUco board of 8 x 6 squares, the first `cut` columns of pixels gone."""
    sheet = cv2.aruco.CharucoBoard(
        (8, 6), 1.0, 0.7, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    )
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
    ("board", "message"),
    [(Charuco("NONE", 0.7), "no dictionary"), (Charuco("DICT_5X5_100", 1.2), "marker's side")],
)
def test_refuses_impossible_markers(board, message):
    """Impossible dictionaries and markers are wrong input and are named."""
    with pytest.raises(InputError, match=message):
        find_board(draw_charuco(0), 7, 5, board)


def test_standard_deviations_are_numbers_or_unknown():
    """With hardly more corners than unknowns no standard deviation is NaN, as OpenCV's may be."""
    corners = [0, 8, 22, 31, 45, 53]
    with pytest.raises(CalibrationRefusedError, match="6 corners are too few for a camera, 8 are the least"):
        calibrate_intrinsics([BOARD[corners]], [good_views()[1][corners]], SIZE)
    for count in (2, 3):
        views = [view[corners] for view in good_views()[:count]]
        found = calibrate_intrinsics([BOARD[corners]] * count, views, SIZE)
        assert not found.accepted
        assert all(sigma is None or np.isfinite(sigma) for sigma in found.sigma.values())
        assert json.loads(json.dumps(found.to_json(), allow_nan=False))["sigma"].keys() == found.sigma.keys()
