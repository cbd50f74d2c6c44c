"""Camera calibration from photographs of a flat board (Zhang 2000, IEEE PAMI 22:1330).

Camera, warp of the board and covariance come from `lens_fit`, which leaves out bad views; the result is judged by
`lens_judgement`. Boards are chessboards, and ChArUco boards, which the frame may cut. Decisions, with figures measured
on OpenCV's own thirteen photographs of a board:

- `findChessboardCorners` finds whole boards. The newer `findChessboardCornersSB`, in its accurate and exhaustive mode,
  misses a board that the classic function finds and takes thirty times as long.
- `cornerSubPix` refines every corner with a window of a third of the smallest corner spacing. Half the spacing reaches
  neighbouring corners (RMS 0.35 px, fx 1.9 px off); a third gives RMS 0.170 px. ChArUco corners are refined in the
  same way, because OpenCV's own were half a pixel off in some versions.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError, PictureError
from labrig.vision.intrinsics import Intrinsics, ViewResidual
from labrig.vision.lens_fit import ObservedView, select_views
from labrig.vision.lens_judgement import judge_lens
from labrig.vision.marker import load_dictionary
from labrig.vision.picture import Picture, as_grey, require_contrast, require_size, size_of

_FloatArray = NDArray[np.float64]

_LEAST_CORNERS = 6
# Standard deviation of the board's warp before the views are seen, over half its diagonal.
_PRIOR_PER_DIAGONAL = 3e-3
_CORNER_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SMALLEST_WINDOW_PX = 2
_LARGEST_WINDOW_PX = 11
_WINDOW_PER_SPACING = 1.0 / 3.0
# The fewest corners of a ChArUco board.
_LEAST_PART = 12


@dataclass(frozen=True)
class Charuco:
    """What makes a chessboard a ChArUco board.

    Attributes
    ----------
    dictionary : str
        OpenCV's name of the markers' dictionary, for example "DICT_5X5_100".
    marker_share : float
        Side of a marker over the side of a square.
    """

    dictionary: str
    marker_share: float


@dataclass(frozen=True, eq=False)
class BoardView:
    """The corners found.

    Attributes
    ----------
    corners : ndarray of int (N,)
        Which corners of the board they are, row by row, as in `board_points_mm`.
    pixels : ndarray (N, 2)
        (u, v).
    """

    corners: NDArray[np.int64]
    pixels: _FloatArray


def board_points_mm(columns: int, rows: int, square_mm: float) -> _FloatArray:
    """Return the inner corners (columns * rows, 2) of a board [mm], row by row.

    Raises
    ------
    InputError
        If the board has fewer than 3 x 3 inner corners, or `square_mm` is not positive.
    """
    if columns < 3 or rows < 3:
        raise InputError(
            f"the board has {columns} x {rows} inner corners", "at least 3 x 3 are needed; count corners"
        )
    if not (np.isfinite(square_mm) and square_mm > 0.0):
        raise InputError(f"the board's squares are {square_mm} mm", "measure a square with a ruler")
    row, column = np.mgrid[0:rows, 0:columns].astype(np.float64)
    return np.column_stack((column.ravel(), row.ravel())) * float(square_mm)


def find_board(image: Picture, columns: int, rows: int, charuco: Charuco | None = None) -> BoardView:
    """Find the inner corners of a board, or of the visible part of a ChArUco board, to a fraction of a pixel.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    columns, rows : int
        Inner corners, not squares.
    charuco : Charuco, optional
        Without it, a plain chessboard.

    Raises
    ------
    MeasurementRefusedError
        If the picture shows no board or too little of it, or its corners are too close to be told apart.
    InputError
        If the ChArUco board is impossible.
    """
    grey = as_grey(image)
    require_contrast(grey)
    find = _find_chessboard if charuco is None else partial(_find_charuco, board=charuco)
    found = find(grey, columns, rows)
    if found is None:
        raise MeasurementRefusedError(
            f"no board of {columns} x {rows} inner corners",
            "show the whole board, evenly lit, with its white margin; of a ChArUco board a part is enough",
        )
    return _refine(grey, found)


def _find_chessboard(grey: Picture, columns: int, rows: int) -> BoardView | None:
    found, corners = cv2.findChessboardCorners(grey, (columns, rows), flags=_CORNER_FLAGS)
    if not found:
        return None
    return BoardView(np.arange(columns * rows), np.asarray(corners, dtype=np.float64).reshape(-1, 2))


def _find_charuco(grey: Picture, columns: int, rows: int, board: Charuco) -> BoardView | None:
    """Return the corners of a ChArUco board that have visible markers."""
    markers = load_dictionary(board.dictionary)
    if not 0.0 < board.marker_share < 1.0:
        raise InputError(
            f"a marker's side is {board.marker_share:g} of a square's, and has to be below 1",
            "measure marker and square with a ruler",
        )
    sheet = cv2.aruco.CharucoBoard((columns + 1, rows + 1), 1.0, board.marker_share, markers)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(sheet).detectBoard(grey)
    if corners is None or len(corners) < _LEAST_PART:
        return None
    return BoardView(
        np.asarray(numbers, dtype=np.int64).ravel(), np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    )


def _refine(grey: Picture, found: BoardView) -> BoardView:
    """Refine the corners in windows that do not reach their neighbours; refuse them if one of them moves far."""
    spacing = float(pdist(found.pixels).min())
    window = int(np.clip(spacing * _WINDOW_PER_SPACING, _SMALLEST_WINDOW_PX, _LARGEST_WINDOW_PX))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    rough = found.pixels.astype(np.float32).reshape(-1, 1, 2)
    fine = cv2.cornerSubPix(grey, rough, (window, window), (-1, -1), stop)
    pixels = np.asarray(fine.reshape(-1, 2), dtype=np.float64)
    moved = float(np.linalg.norm(pixels - found.pixels, axis=1).max())
    if moved > 0.5 * spacing:
        raise MeasurementRefusedError(
            f"a corner moved {moved:.1f} px in refinement, corners are {spacing:.1f} px apart",
            "hold the board closer",
        )
    return BoardView(found.corners, pixels)


def calibrate_from_pictures(
    pictures: Sequence[tuple[str, Picture]],
    columns: int,
    rows: int,
    square_mm: float,
    *,
    charuco: Charuco | None = None,
) -> Intrinsics:
    """Calibrate from named photographs of a board.

    Photographs without a board, or of another size than most, are listed in `views` with the reason.

    Parameters
    ----------
    pictures : sequence of (str, ndarray)
    columns, rows : int
        Inner corners, not squares.
    square_mm : float
        Side of a square.
    charuco : Charuco, optional
        Without it, the board is a plain chessboard.

    Raises
    ------
    InputError
        If there are no pictures, or the board's description is impossible.
    CalibrationRefusedError
        If no picture shows the board.
    """
    if not pictures:
        raise InputError("no pictures to calibrate from", "give photographs of the board")
    # The size of most; in a tie, the size that comes first.
    size = Counter(size_of(image) for _, image in pictures).most_common(1)[0][0]
    board = board_points_mm(columns, rows, square_mm)
    names, boards, pixels, missed = [], [], [], {}
    for index, (name, image) in enumerate(pictures):
        try:
            require_size(image, size, "the calibration")
            seen = find_board(image, columns, rows, charuco)
            names.append(name)
            boards.append(board[seen.corners])
            pixels.append(seen.pixels)
        except (PictureError, MeasurementRefusedError) as refusal:
            missed[index] = ViewResidual(name, None, used=False, reason=f"{refusal.message}: {refusal.hint}")
    if not names:
        raise CalibrationRefusedError(
            f"no board of {columns} x {rows} inner corners was found in any of {len(pictures)} pictures: "
            "show the whole board, flat and sharp, with its white margin",
            "count inner corners, not squares",
        )
    found = calibrate_intrinsics(boards, pixels, size, names)
    rest = iter(found.views)
    views = tuple(missed[index] if index in missed else next(rest) for index in range(len(pictures)))
    return replace(found, views=views)


def calibrate_intrinsics(
    board_points_mm: Sequence[ArrayLike],
    pixels: Sequence[ArrayLike],
    image_size: tuple[int, int],
    names: Sequence[str] | None = None,
) -> Intrinsics:
    """Calibrate a camera from corners of a flat board seen in several poses.

    Parameters
    ----------
    board_points_mm : sequence of array_like (N, 2)
        Corners on the board [mm], one array a view; views may show different corners.
    pixels : sequence of array_like (N, 2)
        The same corners in the picture (u, v).
    image_size : (int, int)
        Width and height [px].
    names : sequence of str, optional
        Names of the views; without them, "view 0", "view 1", ...

    Returns
    -------
    Intrinsics
        `accepted` is False, with reasons, if measurements should not rely on it. A view that
        contradicts the others is left out and listed with the reason.

    Raises
    ------
    InputError
        If the lists do not match or are empty, or an array has the wrong shape or values that are not finite.
    CalibrationRefusedError
        If no camera explains the views at all.
    """
    views, prior_mm = _add_warp(_check_views(board_points_mm, pixels, image_size, names))
    return judge_lens(select_views(views, image_size), image_size, prior_mm)


def _add_warp(views: Sequence[ObservedView]) -> tuple[list[ObservedView], float]:
    """Return the views with the parabolas of their common board, and the prior deviation of a height [mm]."""
    flat = [view.board[:, :2] for view in views]
    corners = np.vstack(flat)
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    half = 0.5 * np.max([np.ptp(board, axis=0) for board in flat], axis=0)
    prior_mm = _PRIOR_PER_DIAGONAL * float(np.hypot(*half))
    shapes = [prior_mm * (1.0 - ((board - middle) / half) ** 2) for board in flat]
    if np.isclose(half[0], half[1]):  # views may show the board turned
        shapes = [shape.sum(axis=1, keepdims=True) for shape in shapes]
    return [replace(view, warp_shapes=shape) for view, shape in zip(views, shapes, strict=True)], prior_mm


def _check_views(
    boards: Sequence[ArrayLike],
    pixels: Sequence[ArrayLike],
    size: tuple[int, int],
    names: Sequence[str] | None,
) -> list[ObservedView]:
    labels = [f"view {index}" for index in range(len(boards))] if names is None else list(names)
    if not len(boards) == len(pixels) == len(labels):
        raise InputError(
            f"{len(boards)} boards, {len(pixels)} arrays of pixels and {len(labels)} names do not match"
        )
    if not labels:
        raise InputError("no views to calibrate from", "give at least one array of corners")
    return [_check_view(*view, size) for view in zip(labels, boards, pixels, strict=True)]


def _check_view(name: str, board: ArrayLike, pixels: ArrayLike, size: tuple[int, int]) -> ObservedView:
    flat, seen = np.asarray(board, dtype=np.float64), np.asarray(pixels, dtype=np.float64)
    if flat.ndim != 2 or flat.shape[1] != 2 or flat.shape != seen.shape:
        raise InputError(f"{name}: board points {flat.shape} and pixels {seen.shape} are not both (N, 2)")
    if len(flat) < _LEAST_CORNERS:
        raise InputError(f"{name}: {len(flat)} corners, at least {_LEAST_CORNERS} are needed")
    if not (np.isfinite(flat).all() and np.isfinite(seen).all()):
        raise InputError(f"{name}: a corner is not finite")
    if (seen < -0.5).any() or (seen > np.array(size) - 0.5).any():
        raise InputError(
            f"{name}: a corner lies outside the picture of {size[0]} x {size[1]}", "check the picture's size"
        )
    return ObservedView(name, np.column_stack((flat, np.zeros(len(flat)))), seen, np.empty((len(flat), 0)))
