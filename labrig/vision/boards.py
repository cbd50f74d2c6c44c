"""The corners of a flat board in a photograph: chessboards, whole or cut by the frame, and ChArUco boards.

Decisions, with figures measured on OpenCV's own thirteen photographs of a board:

- `findChessboardCorners` finds whole boards. The newer `findChessboardCornersSB`, in its accurate and exhaustive mode,
  misses a board that the classic function finds and takes thirty times as long. It serves boards that the frame cuts,
  because it alone finds a part of a board. Which part it finds does not matter: each view has its own pose.
- OpenCV sometimes takes what borders on the board for a further row (in 3 of 20 photographs of a board that the frame
  cuts, by up to a square). So a corner of a part counts only if light and dark alternate twice around it, and if it
  lies on the grid of the others. Light and dark alternate if the second harmonic holds at least 0.6 of the variance
  along a small circle (0.84 to 0.90 at true corners, at most 0.36 at most false ones).
- `cornerSubPix` refines every corner with a window of a third of the smallest corner spacing. Half the spacing reaches
  neighbouring corners (RMS 0.35 px, fx 1.9 px off); a third gives RMS 0.170 px. ChArUco corners are refined in the
  same way, because OpenCV's own were half a pixel off in some versions.
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
# Sizes at which the search for a part of a board starts before it grows, and the fewest corners of a view.
_PARTS = ((5, 4), (4, 4), (4, 3))
_LEAST_PART = 12
# Radius of the circle around a corner in corner spacings, its samples, and the least share of the second harmonic.
_CIRCLE, _CIRCLE_SAMPLES, _LEAST_ALTERNATION = 0.25, 32, 0.6
# A corner further than this from the grid of the others, in spacings, is false; a lens bends the grid by less.
_OFF_GRID = 0.25


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


@dataclass(frozen=True)
class BoardSearch:
    """How to search for the board.

    Attributes
    ----------
    partial : bool
        Whether the frame may cut a chessboard; it may always cut a ChArUco board.
    charuco : Charuco or None
        None for a plain chessboard.
    window_px : int or None
        Half side of the refinement window; None (recommended) derives it from the corner spacing.
    """

    partial: bool = False
    charuco: Charuco | None = None
    window_px: int | None = None

    def __post_init__(self) -> None:
        if self.window_px is not None and self.window_px < 1:
            raise InputError(f"the corner window is {self.window_px} px", "give 1 or more, or leave it out")


@dataclass(frozen=True, eq=False)
class BoardView:
    """The corners found: their columns and rows on the board (N, 2), and their pixels (u, v) (N, 2)."""

    cells: NDArray[np.int64]
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
    return np.asarray(_cells(columns, rows) * float(square_mm), dtype=np.float64)


def _cells(columns: int, rows: int) -> NDArray[np.int64]:
    row, column = np.mgrid[0:rows, 0:columns]
    return np.column_stack((column.ravel(), row.ravel()))


def find_board(image: Picture, columns: int, rows: int, search: BoardSearch | None = None) -> BoardView:
    """Find the inner corners of a board, or of its visible part, to a fraction of a pixel, row by row.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    columns, rows : int
        Inner corners, not squares.
    search : BoardSearch, optional
        Kind of board, and how to search for it; without it, a whole chessboard.

    Raises
    ------
    MeasurementRefusedError
        If the picture shows no board or too little of it, or its corners are too close to be told apart.
    InputError
        If the ChArUco board is impossible.
    """
    grey, search = as_grey(image), search or BoardSearch()
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
    """Return the largest visible part of a chessboard."""
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
    """Return the true corners: light and dark alternate, and they fit the grid; None if there are too few."""
    spacing = _smallest_spacing(found)
    true = _has_alternation(grey, found.pixels, _CIRCLE * spacing)
    if true.sum() >= _LEAST_PART:
        cells, pixels = found.cells[true].astype(np.float64), found.pixels[true]
        # OpenCV's sampling has a fixed seed of its own.
        true[true] = cv2.findHomography(cells, pixels, cv2.RANSAC, _OFF_GRID * spacing)[1].ravel() > 0
    return BoardView(found.cells[true], found.pixels[true]) if true.sum() >= _LEAST_PART else None


def _has_alternation(grey: Picture, pixels: _FloatArray, radius: float) -> NDArray[np.bool_]:
    """Return for each pixel (N,) whether light and dark alternate twice around it."""
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
    """Return the corners of a ChArUco board that have visible markers."""
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
    """Refine the corners in windows that do not reach their neighbours, unless `window_px` sets another size."""
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
    """Return the least distance [px] between neighbouring corners of the board."""
    apart = found.cells[:, None, :] - found.cells[None, :, :]
    neighbours = np.abs(apart).sum(axis=2) == 1
    if not neighbours.any():
        raise MeasurementRefusedError(
            "no two neighbouring corners of the board are seen", "show more of the board"
        )
    distances = np.linalg.norm(found.pixels[:, None] - found.pixels[None], axis=2)
    return float(distances[neighbours].min())
