"""The corners of a flat board in a photograph: chessboards, whole or cut by the frame, and ChArUco boards.

Decided here, with figures measured on OpenCV's own thirteen photographs of a board:

- A whole board comes from `findChessboardCorners`. The newer `findChessboardCornersSB`, asked to be accurate and
  exhaustive, misses a board that the classic one finds and takes thirty times as long; it serves where the frame cuts
  the board, since it alone finds a part of one. Which part does not matter: each view has a pose of its own.
- OpenCV takes what borders on the board for a row more (in 3 of 20 photographs of a board that the frame cuts, by up
  to a square). So a corner of a part counts only where light and dark alternate twice around it: of the variance along
  a small circle at least 0.6 belongs to the second harmonic (0.84 to 0.90 at true corners, 0.36 at most of the others),
  and where it lies in the grid of the others.
- Every corner is refined by `cornerSubPix` with a window that is a third of the smallest corner spacing. Half of the
  spacing reaches neighbouring corners (RMS 0.35 px, fx 1.9 px off), a third gives RMS 0.178 px. ChArUco corners are
  refined in the same way, because OpenCV's own were half a pixel off in some versions.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.picture import Picture, as_grey, require_contrast

_FloatArray = NDArray[np.float64]

_CORNER_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_PART_FLAGS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
_SMALLEST_WINDOW_PX = 2
_LARGEST_WINDOW_PX = 11
_WINDOW_PER_SPACING = 1.0 / 3.0
# Parts that are looked for, grown as far as they go; and the least that is worth a view.
_PARTS = ((5, 4), (4, 4), (4, 3))
_LEAST_PART = 12
# The circle around a corner, in corner spacings, its samples, and the least share of the second harmonic.
_CIRCLE, _CIRCLE_SAMPLES, _LEAST_ALTERNATION = 0.25, 32, 0.6
# A corner further from the grid of the others, in spacings, is none of them; a lens bends the grid by less.
_OFF_GRID = 0.25


@dataclass(frozen=True)
class Charuco:
    """What makes a chessboard a ChArUco board.

    Attributes
    ----------
    dictionary : str
        OpenCV's name of the markers' dictionary, "DICT_5X5_100" for example.
    marker_share : float
        Side of a marker in sides of a square.
    """

    dictionary: str
    marker_share: float


@dataclass(frozen=True)
class BoardSearch:
    """How the board is looked for.

    Attributes
    ----------
    partial : bool
        Whether a chessboard may be cut by the frame; ChArUco boards always may.
    charuco : Charuco or None
        None for a plain chessboard.
    window_px : int or None
        Half side of the refinement window; None binds it to the corner spacing, which is right.
    """

    partial: bool = False
    charuco: Charuco | None = None
    window_px: int | None = None

    def __post_init__(self) -> None:
        if self.window_px is not None and self.window_px < 1:
            raise InputError(f"the corner window is {self.window_px} px", "give 1 or more, or leave it out")


@dataclass(frozen=True, eq=False)
class BoardView:
    """Corners that were found: which ones (N, 2), column and row, and where (N, 2), pixels (u, v)."""

    cells: NDArray[np.int64]
    pixels: _FloatArray


def board_points_mm(columns: int, rows: int, square_mm: float) -> _FloatArray:
    """Return the inner corners (columns * rows, 2) of a board [mm], in the order of `find_board_corners`.

    Raises
    ------
    InputError
        If the board is smaller than 3 x 3 inner corners or the squares have no size.
    """
    if columns < 3 or rows < 3:
        raise InputError(
            f"the board has {columns} x {rows} inner corners", "at least 3 x 3 are needed; count corners"
        )
    if not (np.isfinite(square_mm) and square_mm > 0.0):
        raise InputError(f"the board's squares are {square_mm} mm", "measure a square with a ruler")
    return np.asarray(_cells(columns, rows) * float(square_mm), dtype=np.float64)


def _cells(columns: int, rows: int) -> NDArray[np.int64]:
    row, column = np.mgrid[0:rows, 0:columns]
    return np.column_stack((column.ravel(), row.ravel()))


def find_board_corners(image: Picture, columns: int, rows: int) -> _FloatArray:
    """Find the inner corners of a whole chessboard to a fraction of a pixel.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    columns, rows : int
        Inner corners, not squares.

    Returns
    -------
    ndarray (columns * rows, 2)
        Pixels (u, v), row by row.

    Raises
    ------
    MeasurementRefusedError
        If the whole board is not seen, or is too small in the picture for its corners to be told apart.
    """
    return find_board(image, columns, rows, BoardSearch()).pixels


def find_board(image: Picture, columns: int, rows: int, search: BoardSearch) -> BoardView:
    """Find the corners of a board, or of the part of it that is seen, to a fraction of a pixel.

    Raises
    ------
    MeasurementRefusedError
        If no board, or too little of it, is seen, or its corners are too close to be told apart.
    InputError
        If the ChArUco board cannot be.
    """
    grey = as_grey(image)
    require_contrast(grey)
    if search.charuco is not None:
        found = _find_charuco(grey, columns, rows, search.charuco)
    else:
        found = _find_whole(grey, columns, rows)
        if found is None and search.partial:
            found = _find_part(grey, columns, rows)
    if found is None:
        raise MeasurementRefusedError(
            f"no board of {columns} x {rows} inner corners",
            "show the whole board, evenly lit, with its white margin, or let the frame cut it (--partial)",
        )
    return _refine(grey, found, search.window_px)


def _find_whole(grey: Picture, columns: int, rows: int) -> BoardView | None:
    found, corners = cv2.findChessboardCorners(grey, (columns, rows), flags=_CORNER_FLAGS)
    if not found:
        return None
    return BoardView(_cells(columns, rows), np.asarray(corners, dtype=np.float64).reshape(-1, 2))


def _find_part(grey: Picture, columns: int, rows: int) -> BoardView | None:
    """Return the largest part of a chessboard that is seen."""
    largest: BoardView | None = None
    most = sorted((columns, rows))
    for least in _PARTS:
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(grey, least, _PART_FLAGS)
        if not found or (np.array(sorted(meta.shape)) > most).any():
            continue
        seen = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
        if len(seen) >= max(_LEAST_PART, 0 if largest is None else len(largest.pixels) + 1):
            largest = BoardView(_cells(meta.shape[1], meta.shape[0]), seen)
    return None if largest is None else _select_true_corners(grey, largest)


def _select_true_corners(grey: Picture, found: BoardView) -> BoardView | None:
    """Return the corners that are some and lie in the grid of the others; None where they are too few."""
    spacing = _smallest_spacing(found)
    true = _has_alternation(grey, found.pixels, _CIRCLE * spacing)
    if true.sum() >= _LEAST_PART:
        cells, pixels = found.cells[true].astype(np.float64), found.pixels[true]
        # OpenCV's sampling has a fixed seed of its own.
        true[true] = cv2.findHomography(cells, pixels, cv2.RANSAC, _OFF_GRID * spacing)[1].ravel() > 0
    return BoardView(found.cells[true], found.pixels[true]) if true.sum() >= _LEAST_PART else None


def _has_alternation(grey: Picture, pixels: _FloatArray, radius: float) -> NDArray[np.bool_]:
    """Return around which pixels (N,) light and dark alternate twice."""
    angles = np.arange(_CIRCLE_SAMPLES) * 2.0 * np.pi / _CIRCLE_SAMPLES
    u, v = (
        (pixels[:, axis, None] + radius * turn).astype(np.float32)
        for axis, turn in enumerate((np.cos(angles), np.sin(angles)))
    )
    seen = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
    power = np.abs(np.fft.rfft(seen, axis=1)) ** 2
    everything = np.maximum(power[:, 1:].sum(axis=1), np.finfo(float).tiny)
    return np.asarray(power[:, 2] >= _LEAST_ALTERNATION * everything)


def _find_charuco(grey: Picture, columns: int, rows: int, board: Charuco) -> BoardView | None:
    """Return the corners of a ChArUco board beside which markers are seen."""
    dictionary = getattr(cv2.aruco, board.dictionary, None)
    if not board.dictionary.startswith("DICT_") or dictionary is None:
        raise InputError(f"there is no dictionary {board.dictionary!r}", "for example DICT_5X5_100")
    if not 0.0 < board.marker_share < 1.0:
        raise InputError(
            f"a marker's side is {board.marker_share:g} of a square's, and has to be below 1",
            "measure marker and square with a ruler",
        )
    markers = cv2.aruco.getPredefinedDictionary(dictionary)
    sheet = cv2.aruco.CharucoBoard((columns + 1, rows + 1), 1.0, board.marker_share, markers)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(sheet).detectBoard(grey)
    if corners is None or len(corners) < _LEAST_PART:
        return None
    index = np.asarray(numbers, dtype=np.int64).ravel()
    return BoardView(_cells(columns, rows)[index], np.asarray(corners, dtype=np.float64).reshape(-1, 2))


def _refine(grey: Picture, found: BoardView, window_px: int | None) -> BoardView:
    """Return the corners refined in windows that do not reach their neighbours, unless another window is forced."""
    spacing = _smallest_spacing(found)
    bound = int(np.clip(spacing * _WINDOW_PER_SPACING, _SMALLEST_WINDOW_PX, _LARGEST_WINDOW_PX))
    window = bound if window_px is None else window_px
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    rough = found.pixels.astype(np.float32).reshape(-1, 1, 2)
    fine = cv2.cornerSubPix(grey, rough.copy(), (window, window), (-1, -1), stop)
    moved = float(np.linalg.norm(fine - rough, axis=2).max())
    if moved > 0.5 * spacing:
        raise MeasurementRefusedError(
            f"a corner moved {moved:.1f} px in refinement, corners are {spacing:.1f} px apart",
            "hold the board closer",
        )
    return BoardView(found.cells, np.asarray(fine.reshape(-1, 2), dtype=np.float64))


def _smallest_spacing(found: BoardView) -> float:
    """Return the least distance [px] between corners that are neighbours on the board."""
    apart = found.cells[:, None, :] - found.cells[None, :, :]
    neighbours = np.abs(apart).sum(axis=2) == 1
    if not neighbours.any():
        raise MeasurementRefusedError(
            "no two neighbouring corners of the board are seen", "show more of the board"
        )
    distances = np.linalg.norm(found.pixels[:, None] - found.pixels[None], axis=2)
    return float(distances[neighbours].min())
