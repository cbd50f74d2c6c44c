"""Grid pictures before and after a run: the effect of a bumped camera."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from labrig.errors import CalibrationRefusedError, PictureError
from labrig.vision.calibrate_plane import calibrate_plane
from labrig.vision.gel import Gel
from labrig.vision.plane_check import check_grid, compare_grids
from tests.vision.test_plane import CAMERA, PAPER, picture_of


@pytest.fixture(scope="module")
def before():
    """Return the plane map, the picture of the paper that it was made from, and its check."""
    picture = picture_of(PAPER)
    plane = calibrate_plane(picture, CAMERA.intrinsics, 1.0, (100.3, 200.7), "right", px_per_mm=14.0)
    return plane, picture, check_grid(picture, plane, 1.0)


def warp(picture, matrix):
    """Return the picture from a camera that was moved."""
    size = picture.shape[::-1]
    return cv2.warpPerspective(picture, np.array(matrix, float), size, borderMode=cv2.BORDER_REFLECT_101)


def test_paper_seen_through_its_own_map_has_its_pitch(before):
    """The scale is 1 in every direction, and the points lie on an even grid."""
    _, _, check = before
    assert (check.scale, check.other_scale) == pytest.approx((1.0, 1.0), abs=2e-4)
    assert check.residual_mm < 0.02
    assert compare_grids(check, check).relative == 0.0


def test_paper_laid_anew_is_no_drift(before):
    """Turned and shifted paper has the same scale and shape: its place does not count."""
    plane, _, check = before
    turned = replace(PAPER, camera=replace(CAMERA, roll_deg=4.0), photo=replace(PAPER.photo, seed=5))
    drift = compare_grids(check, check_grid(turned.draw(), plane, 1.0))
    assert drift.accepted
    assert drift.relative < 1e-3


@pytest.mark.parametrize(
    ("scale", "tilt", "words"), [(1.003, 0.0, ""), (1.01, 0.0, "the camera was bumped"), (1.0, 4e-5, "again")]
)
def test_a_camera_that_moved_is_an_error_bar_or_refuses(before, scale, tilt, words):
    """A drift of 0.3 % is accepted and stated; 1 % is refused, and a tilt even if the mean scale stays the same."""
    plane, picture, check = before
    u, v = np.array([400.0, 300.0]) * (1.0 - scale)
    moved = warp(picture, [[scale, 0, u], [0, scale, v], [tilt, 0, 1.0 - 400 * tilt]])
    drift = compare_grids(check, check_grid(moved, plane, 1.0))
    assert drift.accepted == (not words)
    assert tilt or drift.relative == pytest.approx(scale - 1.0, abs=5e-4)
    assert words in (drift.reason or "")


@pytest.mark.parametrize("factor", [5.0, 0.5])
def test_a_map_of_another_scale_is_refused(before, factor):
    """Through it the paper's lines are not where they would be; missing paper and another picture are refused too."""
    plane, picture, _ = before
    with pytest.raises(CalibrationRefusedError, match=r"px apart|no grid of ruled lines") as caught:
        check_grid(picture, plane.change(homography=np.diag([factor, factor, 1.0]) @ plane.matrix), 1.0)
    assert "calibrate the plane again" in caught.value.hint
    with pytest.raises(CalibrationRefusedError, match="no grid"):
        check_grid(np.full_like(picture, 128), plane, 1.0)
    with pytest.raises(PictureError, match="the plane map is for"):
        check_grid(picture[:100], plane, 1.0)


def test_a_camera_that_was_moved_before_the_run_is_refused(before):
    """A map 4 % off is refused, though nothing changes between the two pictures; 2 % off is not."""
    plane, picture, _ = before
    for factor, accepted in ((1.04, False), (0.98, True)):
        matrix = np.diag([factor, factor, 1.0]) @ plane.matrix
        check = check_grid(picture, plane.change(homography=matrix, mm_per_px=factor * plane.mm_per_px), 1.0)
        drift = compare_grids(check, check)
        assert drift.accepted == accepted
        assert accepted or "1.040 times the true ones" in drift.reason


def test_the_paper_lies_in_air_where_the_map_corrects_for_gel(before):
    """The map's correction for a gel that comes later does not count as a wrong scale."""
    plane, picture, check = before
    behind = plane.change(gel=Gel(index=1.35, depth_mm=10.0, paper_at="surface"))
    assert check_grid(picture, behind, 1.0) == check
