"""The standard deviations of a lens: by the corners' noise, or by the scatter between views where that is larger."""

from dataclasses import replace

import numpy as np
import pytest

from labrig.vision.calibrate_lens import calibrate_intrinsics
from labrig.vision.calibration_file import load_intrinsics, save_intrinsics
from tests.vision.warped_boards import SimulatedBoard, SimulatedCamera, draw_views, parabolas

CAMERA = SimulatedCamera()
POINTS = SimulatedBoard().points_mm
VIEWS = 12


def draw_bent_views(sd_mm, seed):
    """Return views of a board that is bent by hand, otherwise in each."""
    random = np.random.default_rng(seed)
    views = []
    for _ in range(VIEWS):
        row_mm, column_mm = random.normal(0.1, sd_mm, 2)
        board = SimulatedBoard(height_mm=parabolas(row_mm, column_mm))
        views += draw_views(CAMERA, board, 1, random)
    return views


def calibrate(views):
    """Return the calibration from views of the whole board."""
    return calibrate_intrinsics([POINTS] * len(views), views, CAMERA.size)


@pytest.fixture(scope="module")
def scattered():
    """Return views whose boards are bent by 0.15 mm, each otherwise, and the lens from all."""
    views = draw_bent_views(0.15, 3)
    return views, calibrate(views)


def test_sigma_by_views_is_that_of_a_jackknife(scattered):
    """Without refitting, the sigma of the focal length agrees with fits that leave out one view in turn."""
    views, found = scattered
    left_out = [calibrate(views[:number] + views[number + 1 :]).fx for number in range(VIEWS)]
    jackknife = np.std(left_out) * np.sqrt(VIEWS - 1)
    # The scatter is used in no direction below the corners' noise, so it may be larger.
    assert 0.95 * jackknife < found.sigma["fx"] < 1.3 * jackknife


def test_a_file_keeps_what_sigma_rests_on(tmp_path, scattered):
    """A calibration is read as it was written."""
    path = tmp_path / "intrinsics.json"
    save_intrinsics(path, scattered[1], {})
    kept = [replace(view, corners_px=(), errors_px=()) for view in scattered[1].views]
    assert load_intrinsics(path) == replace(scattered[1], views=tuple(kept))
