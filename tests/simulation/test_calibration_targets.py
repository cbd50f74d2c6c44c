"""Chessboard and graph paper, as a calibration would see them."""

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from labrig.simulation.description import stream
from labrig.simulation.lens import plane_to_pixels, project
from labrig.simulation.targets import Chessboard, choose_board_pose
from labrig.simulation.world import World
from tests.simulation.benches import QUIET

BOARD = Chessboard(9, 6, 25.0)
Floats = npt.NDArray[np.float64]


def corners_mm() -> Floats:
    """Return the inner corners (54, 2) about the board's middle, row by row."""
    x = (np.arange(BOARD.columns) - (BOARD.columns - 1) / 2) * BOARD.square_mm
    y = (np.arange(BOARD.rows) - (BOARD.rows - 1) / 2) * BOARD.square_mm
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def find_corners(picture: npt.NDArray[np.uint8]) -> Floats:
    """Return the inner corners of the board in a picture (54, 2), refined."""
    found, corners = cv2.findChessboardCorners(picture, (BOARD.columns, BOARD.rows))
    assert found
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-4)
    return np.asarray(cv2.cornerSubPix(picture, corners, (7, 7), (-1, -1), stop), float)[:, 0]


def test_corners_are_seen_where_the_pose_puts_them() -> None:
    """Found corners agree with the projected ones within 0.1 px rms in every view, from either end."""
    world = World(QUIET.model_copy(update={"noise_sd": 3.0}), 2)
    for view in range(6):
        world.hold_board(view, BOARD.columns, BOARD.rows, BOARD.square_mm)
        found = find_corners(world.picture())
        pose = choose_board_pose(view, BOARD, stream(2, "board", view), QUIET.lens)
        expected = project(pose.to_camera(corners_mm()), QUIET.lens)
        missed = min(
            np.sqrt(((found - corners) ** 2).sum(axis=1).mean()) for corners in (expected, expected[::-1])
        )
        assert missed < 0.1


def brightness_along(
    picture: npt.NDArray[np.uint8], start_mm: Floats, way: Floats, strip_mm: float
) -> Floats:
    """Return the brightest of a strip beside each place of a 30 mm way in the plane, every 0.01 mm.

    A strip one pitch wide blots out the lines that run along the way.
    """
    along = np.arange(0.0, 30.0, 0.01)[:, None, None] * way
    beside = np.linspace(0.0, strip_mm, 9)[None, :, None] * way[::-1]
    places = start_mm + along + beside
    pixels = plane_to_pixels(places.reshape(-1, 2), QUIET.lens).reshape(places.shape).astype(np.float32)
    sampled = cv2.remap(picture.astype(np.float32), pixels[..., 0], pixels[..., 1], cv2.INTER_CUBIC)
    return np.asarray(sampled.max(axis=1), float)


def line_places_mm(profile: Floats, pitch_mm: float) -> Floats:
    """Return the centroids of the dark lines of a profile sampled every 0.01 mm."""
    paper = cv2.dilate(profile[:, None], np.ones((round(110 * pitch_mm), 1)))[:, 0]
    ink = np.clip(paper - profile - 15, 0, None)
    lines = np.split(np.arange(len(ink)), np.flatnonzero(np.diff((ink > 0).astype(int)) != 0) + 1)
    centres = [(ink[line] * line).sum() / ink[line].sum() for line in lines if ink[line].any()]
    return np.array(centres) * 0.01


@pytest.mark.parametrize("pitch_mm", [1.0, 2.0])
def test_graph_paper_is_ruled_in_the_steering_plane(pitch_mm: float) -> None:
    """Sampled through the lens along z and along y, its lines stand one pitch apart all over the view."""
    world = World(QUIET, 3)
    world.lay_graph_paper(pitch_mm)
    picture = world.picture()
    for start_mm, way in (
        ((-5.0, -10.0), (0.0, 1.0)),
        ((10.0, 30.0), (-1.0, 0.0)),
        ((-25.0, 25.0), (0.0, 1.0)),
    ):
        profile = brightness_along(picture, np.array(start_mm), np.array(way), pitch_mm)
        gaps_mm = np.diff(line_places_mm(profile, pitch_mm)[1:-1])
        assert len(gaps_mm) >= 30 / pitch_mm - 4
        assert gaps_mm == pytest.approx(np.full(len(gaps_mm), pitch_mm), abs=0.03)
        assert gaps_mm.mean() == pytest.approx(pitch_mm, abs=0.003)
