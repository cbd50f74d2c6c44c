"""Bent boards and bad views in the calibration of the lens: what is told, what is left out, and what sigma rests on."""

import re
from dataclasses import replace

import numpy as np
import pytest

from labrig.vision.calibrate_lens import calibrate_intrinsics
from labrig.vision.calibration_file import load_intrinsics, save_intrinsics
from tests.vision.renderer import Board, Camera, bend_board

LENS = (-0.15, 0.06, 4e-4, -3e-4, 0.0)
CAMERA = Camera(focal_px=1100.0, centre_px=(645.0, 352.0), distortion=LENS, aspect=1102 / 1100)
FLAT, SLIGHT = Board(), bend_board(0.1, 0.05)


def views_of(board, count, seed, camera=CAMERA, **how):
    """Return the corners of a board in so many random poses."""
    return board.see_often(camera, count, seed, **how)


def calibrate(views, **how):
    """Return the calibration from views of the whole board, named by their numbers."""
    names = [str(index) for index in range(len(views))]
    return calibrate_intrinsics([FLAT.points_mm] * len(views), views, CAMERA.size, names, **how)


def left_out(found):
    """Return the numbers of the views that were left out."""
    return [int(view.image) for view in found.views if not view.used]


def test_sigma_of_the_focal_length_holds_for_warped_boards():
    """For warps of 0 to 0.5 mm, the errors of fx are about as large as their stated standard deviations."""
    shares = []
    for draw in range(24):
        warp_mm = 0.5 * (draw % 3) / 2
        found = calibrate(views_of(bend_board(warp_mm, 0.5 * warp_mm), 8, (8, draw)))
        shares.append((found.fx - CAMERA.focal_px) / found.sigma["fx"])
        assert found.board_warp.row_mm == pytest.approx(warp_mm, abs=4.0 * found.board_warp.sigma_row_mm)
        assert found.board_warp.column_mm == pytest.approx(
            0.5 * warp_mm, abs=4.0 * found.board_warp.sigma_column_mm
        )
    # Of 24 draws, the rms of a standard normal variable is 0.65 to 1.4 in 999 of 1000 cases.
    assert 0.65 < np.sqrt(np.mean(np.square(shares))) < 1.4


@pytest.mark.processors
def test_warp_is_positive_towards_the_camera_whatever_the_numbering():
    """A middle that stands towards the camera is positive, also if the board's rows are numbered upwards."""
    board = bend_board(0.4, -0.2)
    views = views_of(board, 8, 1)
    mirrored = [FLAT.points_mm * (1.0, -1.0)] * 8
    for found in (calibrate(views), calibrate_intrinsics(mirrored, views, CAMERA.size)):
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
        boards, [view[part] for view, part in zip(views, parts, strict=True)], CAMERA.size
    )
    # The height over 150 mm of 200 mm.
    assert found.board_warp.row_mm == pytest.approx(0.4 * 0.75**2, abs=0.05)


def test_a_board_that_may_be_turned_has_one_warp():
    """Where views may show the board turned by 90 degrees, the same height is fitted along rows and columns."""
    square = replace(bend_board(0.3, 0.3), columns=7, rows=7)
    views = views_of(square, 8, 3)
    turned = square.points_mm[:, ::-1] * (1.0, -1.0)
    boards = [turned if index % 2 else square.points_mm for index in range(8)]
    warp = calibrate_intrinsics(boards, views, CAMERA.size).board_warp
    assert warp.row_mm == warp.column_mm == pytest.approx(0.3, abs=0.05)


def test_a_warp_that_the_views_do_not_tell_is_left_at_zero():
    """Of one view the warp stays at zero within its prior deviation, and the sentence says so."""
    warp = calibrate(views_of(bend_board(0.5, 0.0), 1, 4, tilt_deg=2.0)).board_warp
    assert abs(warp.row_mm) < 0.5 * warp.prior_mm
    assert warp.sigma_row_mm == pytest.approx(warp.prior_mm, rel=0.2)
    assert "hardly tell the warp" in warp.sentence()
    assert f"within {warp.prior_mm:.3f} mm" in warp.sentence()


def accelerate(view):
    """Return the view as a rolling shutter takes it while the camera accelerates sideways."""
    v = (view[:, 1] - view[:, 1].mean()) / np.ptp(view[:, 1])
    return view + np.column_stack((16.0 * v**2, np.zeros(len(v))))


LONGER = replace(CAMERA, focal_px=1.05 * CAMERA.focal_px)
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
    found = calibrate([*views[:4], BAD_FRAMES[kind](), *views[4:]])
    assert left_out(found) == [4]
    assert re.search(
        "px from where the other views put them|longer than that of the other views", found.views[4].reason
    )
    assert found.accepted, found.reasons
    assert found.fx == pytest.approx(CAMERA.focal_px, abs=3.5 * found.sigma["fx"])


@pytest.mark.parametrize(("good", "accepted"), [(9, True), (6, False)])
def test_more_bad_views_than_a_third_are_refused(good, accepted):
    """Frames that are each bad in their own way are left out; where they are too many the rest is no evidence."""
    heights = ((4.0, 0.0), (-4.0, 0.0)) if accepted else ((6.0, 0.0), (-6.0, 0.0), (0.0, 7.0), (5.0, -5.0))
    odd = [views_of(bend_board(*each), 1, 11 * accepted + index)[0] for index, each in enumerate(heights)]
    found = calibrate([*views_of(SLIGHT, good, 21 + (not accepted)), *odd])
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
        assert left_out(calibrate(views_of(SLIGHT, 4, (23, seed)))) == []


def test_sigma_by_views_is_that_of_a_jackknife_and_a_file_keeps_it(tmp_path):
    """Of boards that are bent otherwise in each view the sigma of fx agrees with fits that leave out one in turn."""
    count, random = 12, np.random.default_rng(3)
    views = [views_of(bend_board(*random.normal(0.1, 0.15, 2)), 1, random)[0] for _ in range(count)]
    found = calibrate(views)
    jackknife = np.std([calibrate(views[:n] + views[n + 1 :]).fx for n in range(count)]) * np.sqrt(count - 1)
    # The scatter is used in no direction below the corners' noise, so it may be larger.
    assert 0.95 * jackknife < found.sigma["fx"] < 1.3 * jackknife
    save_intrinsics(tmp_path / "intrinsics.json", found, {})
    kept = [replace(view, corners_px=(), errors_px=()) for view in found.views]
    assert load_intrinsics(tmp_path / "intrinsics.json") == replace(found, views=tuple(kept))
