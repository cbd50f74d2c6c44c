"""AprilGrids: drawn by the tests' own code of Kalibr's layout, found where they were drawn."""

import cv2
import numpy as np
import pytest

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.boards import AprilGrid, BoardSearch, find_board
from labrig.vision.zhang import calibrate_from_pictures

COLUMNS, ROWS, TAG_MM = 4, 3, 20.0
# A tag has ten cells along a side, two of them on each side black; three cells are between tags.
TAG, GAP = 10, 3
CELL_MM = TAG_MM / TAG
SEARCH = BoardSearch(april=AprilGrid(GAP / TAG))
# The first codes of the family 36h11, row by row from the upper left, white is 1.
CODES = (
    *(0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822, 0xF31DAB3AC),
    *(0x056A5D085, 0x10652E1D4, 0x22B1DFEAD, 0x265AD0472, 0x34FE91B86, 0x3FF962CD5),
)
SIZE, CAMERA = (640, 480), np.array([[560.0, 0.0, 322.0], [0.0, 562.0, 236.0], [0.0, 0.0, 1.0]])
# Pixels of a cell in the drawing, and pixels of the sharp picture in a pixel.
FINE, DENSE = 16, 3


def draw_cells(order=range(COLUMNS * ROWS), squares=True):
    """Return the cells of a grid, 1 is white, with tags of these numbers from the lower left on."""
    step = TAG + GAP
    cells = np.ones((ROWS * step + GAP, COLUMNS * step + GAP), dtype=np.uint8)
    for index, number in enumerate(order):
        row, column = ROWS - 1 - index // COLUMNS, index % COLUMNS
        tag = cells[row * step + GAP : (row + 1) * step, column * step + GAP : (column + 1) * step]
        tag[:] = 0
        tag[2:-2, 2:-2] = np.array([int(bit) for bit in f"{CODES[number]:036b}"]).reshape(6, 6)
    if squares:
        for row in range(ROWS + 1):
            for column in range(COLUMNS + 1):
                cells[row * step : row * step + GAP, column * step : column * step + GAP] = 0
    return cells


def pose(seed, distance=1.3):
    """Return the homography from cells to pixels of a grid tilted by up to 45 degrees in a random pose."""
    random = np.random.default_rng(seed)
    width, height = COLUMNS * (TAG + GAP) * CELL_MM, ROWS * (TAG + GAP) * CELL_MM
    way, tilt, roll = random.uniform(0.0, 2.0 * np.pi), random.uniform(0.2, 0.8), random.normal(0.0, 0.3)
    turn = (
        cv2.Rodrigues(tilt * np.array([np.cos(way), np.sin(way), 0.0]))[0]
        @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    )
    shift = width * np.array(
        [*random.uniform(-0.15, 0.15, 2), random.uniform(distance - 0.2, distance + 0.2)]
    )
    middle = turn @ (width / 2.0, height / 2.0, 0.0)
    return CAMERA @ np.column_stack((turn[:, 0] * CELL_MM, turn[:, 1] * CELL_MM, shift - middle))


def photograph(cells, homography, seed):
    """Return a grey picture of the cells, blurred and noisy."""
    texture = np.kron(cells, np.ones((FINE, FINE), dtype=np.uint8)) * 190 + 30
    # The middle of the first pixel of the drawing is at half a pixel of it; that of a pixel at the middle of its parts.
    to_cells = np.array([[1.0 / FINE, 0.0, 0.5 / FINE], [0.0, 1.0 / FINE, 0.5 / FINE], [0.0, 0.0, 1.0]])
    to_dense = np.array([[DENSE, 0.0, (DENSE - 1) / 2], [0.0, DENSE, (DENSE - 1) / 2], [0.0, 0.0, 1.0]])
    dense = cv2.warpPerspective(
        texture,
        to_dense @ homography @ to_cells,
        (SIZE[0] * DENSE, SIZE[1] * DENSE),
        flags=cv2.INTER_LINEAR,
        borderValue=150,
    )
    sharp = cv2.resize(dense, SIZE, interpolation=cv2.INTER_AREA).astype(np.float64)
    noisy = cv2.GaussianBlur(sharp, (0, 0), 0.7) + np.random.default_rng(seed).normal(0.0, 2.0, sharp.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def measure_errors(seen, homography):
    """Return how far the found corners are from where they were drawn (N,) [px]."""
    u, v = GAP + seen.cells[:, 0] * TAG, ROWS * (TAG + GAP) - seen.cells[:, 1] * TAG
    drawn = np.column_stack((u, v, np.ones(len(u)))) @ homography.T
    return np.linalg.norm(drawn[:, :2] / drawn[:, 2:] - seen.pixels, axis=1)


@pytest.mark.processors
@pytest.mark.parametrize(("distance", "least"), [(1.3, 40), (0.8, 20)])
def test_corners_of_an_aprilgrid_are_found_where_they_were_drawn(distance, least):
    """Of a whole grid and of one that the frame cuts, each corner has its place on the board and in the picture."""
    for seed in range(3):
        homography = pose(seed, distance)
        seen = find_board(photograph(draw_cells(), homography, seed), COLUMNS, ROWS, SEARCH)
        errors = measure_errors(seen, homography)
        assert least <= len(errors) <= 48
        assert np.sqrt(np.mean(errors**2)) < 0.08
        assert errors.max() < 0.3


@pytest.mark.processors
def test_aprilgrid_gives_the_lens():
    """Eight views of a drawn grid give the camera within three stated standard deviations, and are accepted."""
    pictures = [(str(seed), photograph(draw_cells(), pose(seed, 1.1), seed)) for seed in range(8)]
    found = calibrate_from_pictures(pictures, COLUMNS, ROWS, TAG_MM, search=SEARCH)
    assert found.accepted, found.reasons
    assert found.rms_px < 0.08
    true = {"fx": CAMERA[0, 0], "fy": CAMERA[1, 1], "cx": CAMERA[0, 2], "cy": CAMERA[1, 2]}
    for name, value in true.items():
        assert abs(getattr(found, name) - value) < 3.0 * found.sigma[name]
        assert found.sigma[name] < 1.0


@pytest.mark.parametrize(
    "cells",
    [
        draw_cells(order=[8, 9, 10, 11, 4, 5, 6, 7, 0, 1, 2, 3]),
        draw_cells(order=[0, 1] * 6),
        draw_cells(squares=False),
    ],
    ids=["numbered from the top", "numbers twice", "without squares"],
)
def test_grid_of_another_layout_is_refused(cells):
    """A grid whose corners are not where Kalibr draws them is refused, with Kalibr's layout in the hint."""
    with pytest.raises(MeasurementRefusedError, match="no AprilGrid of 4 x 3 tags") as caught:
        find_board(photograph(cells, pose(1), 1), COLUMNS, ROWS, SEARCH)
    assert "tag 0 at the lower left" in caught.value.hint


@pytest.mark.parametrize(("columns", "rows"), [(1, 2), (30, 20)])
def test_impossible_number_of_tags_is_wrong_input(columns, rows):
    """Fewer tags than twelve corners need, or more than the family has, are named."""
    picture = photograph(draw_cells(), pose(1), 1)
    with pytest.raises(InputError, match=f"{columns} x {rows} tags"):
        calibrate_from_pictures([("0", picture)], columns, rows, TAG_MM, search=SEARCH)
