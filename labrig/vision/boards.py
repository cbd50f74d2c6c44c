"""The corners of a board in a photograph, and the warp of a board that is not flat.

Boards are chessboards, and ChArUco boards, which the frame may cut. Decisions, with figures measured on OpenCV's own
thirteen photographs of a board:

- `findChessboardCorners` finds whole boards. The newer `findChessboardCornersSB`, in its accurate and exhaustive mode,
  misses a board that the classic function finds and takes thirty times as long.
- `cornerSubPix` refines every corner with a window of a third of the smallest corner spacing. Half the spacing reaches
  neighbouring corners (RMS 0.35 px, fx 1.9 px off); a third gives RMS 0.170 px. ChArUco corners are refined in the
  same way, because OpenCV's own were half a pixel off in some versions.

A printed board on a plate is bent by tenths of a millimetre. A fit that takes it for flat changes the focal length
instead: of twelve views of a board 200 mm long, a warp of 0.3 mm puts it off by eight stated standard deviations. So
the height of the board is a parabola along its rows plus one along its columns, as in mrcal, and both are fitted with
the camera. A view may show a part of the board at an unknown place, because a shifted parabola differs from the first
one by a tilt alone. A board as wide as high may also be seen turned by 90 degrees, so its two parabolas are taken to be
equal. A twist of the board is not in the model, nor in mrcal's: one of 0.3 mm makes the error of fx 4.4 times larger.
The scatter between views shows it (`lens_fit`): the stated deviation is 1.13 of the actual error over 200 sets of
twelve views.

Before the views are seen, each height is zero within 1.5 mm per metre of the board's diagonal, one standard deviation.
Where the views cannot tell it, it stays there, and this deviation is in the uncertainty of the lens.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.picture import Picture, as_grey, require_contrast

_FloatArray = NDArray[np.float64]

_CORNER_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SMALLEST_WINDOW_PX = 2
_LARGEST_WINDOW_PX = 11
_WINDOW_PER_SPACING = 1.0 / 3.0
# The fewest corners of a ChArUco board.
_LEAST_PART = 12


def load_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Return a dictionary of markers by OpenCV's name, for example "DICT_4X4_50".

    Raises
    ------
    InputError
        When there is none of this name.
    """
    number = getattr(cv2.aruco, name, None)
    if not name.startswith("DICT_") or number is None:
        raise InputError(f"there is no dictionary {name!r}", "for example DICT_5X5_100")
    return cv2.aruco.getPredefinedDictionary(number)


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
    if charuco is not None:
        found = _find_charuco(grey, columns, rows, charuco)
    else:
        found = _find_chessboard(grey, columns, rows)
    if found is None:
        raise MeasurementRefusedError(
            f"no board of {columns} x {rows} inner corners",
            "show the whole board, evenly lit, with its white margin; of a ChArUco board a part is enough",
        )
    return _refine(grey, found, columns)


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


def _refine(grey: Picture, found: BoardView, columns: int) -> BoardView:
    """Refine the corners in windows that do not reach their neighbours; refuse them if one of them moves far."""
    spacing = _smallest_spacing(found, columns)
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


def _smallest_spacing(found: BoardView, columns: int) -> float:
    """Return the least distance [px] between corners that are neighbours on the board."""
    cells = np.column_stack((found.corners % columns, found.corners // columns))
    neighbours = np.abs(cells[:, None] - cells[None]).sum(axis=2) == 1
    if not neighbours.any():
        raise MeasurementRefusedError(
            "no two neighbouring corners of the board are seen", "show more of the board"
        )
    return float(np.linalg.norm(found.pixels[:, None] - found.pixels[None], axis=2)[neighbours].min())


_PRIOR_PER_DIAGONAL = 1.5e-3
# The views tell the warp if they reduce its standard deviation to this share.
_TOLD = 0.5


@dataclass(frozen=True)
class BoardWarp:
    """How far the middle of the board stands above its edges, towards the camera, along its rows and its columns.

    Attributes
    ----------
    row_mm, column_mm : float
        Height of the middle of a row over its ends, and of the middle of a column over its ends.
    sigma_row_mm, sigma_column_mm : float
        Their standard deviations.
    prior_mm : float
        The standard deviation of both before the views are seen.
    """

    row_mm: float
    column_mm: float
    sigma_row_mm: float
    sigma_column_mm: float
    prior_mm: float

    def sentence(self) -> str:
        """Return the warp in words."""
        heights = (
            f"the middle of its rows stands {self.row_mm:+z.3f} ± {self.sigma_row_mm:.3f} mm, that of its columns "
            f"{self.column_mm:+z.3f} ± {self.sigma_column_mm:.3f} mm towards the camera (1 sigma)"
        )
        if max(self.sigma_row_mm, self.sigma_column_mm) <= _TOLD * self.prior_mm:
            return f"Warp of the board: {heights}."
        return (
            f"The views hardly tell the warp of the board: {heights}. It is taken to be within {self.prior_mm:.3f} mm "
            "(1 sigma), which is in the uncertainty of the lens; more tilted views would tell it."
        )


@dataclass(frozen=True, eq=False)
class WarpModel:
    """The parabolas of a board.

    Attributes
    ----------
    middle_mm, half_mm : ndarray (2,)
        Middle of all corners, and half the length of the largest view along rows and columns.
    prior_mm : float
        Standard deviation of a height before the views are seen.
    """

    middle_mm: _FloatArray
    half_mm: _FloatArray
    prior_mm: float

    @classmethod
    def of_boards(cls, boards_mm: Sequence[_FloatArray]) -> "WarpModel":
        """Return the model for a board of which each view shows some corners (N, 2)."""
        corners = np.vstack(boards_mm)
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        half = 0.5 * np.max([np.ptp(board, axis=0) for board in boards_mm], axis=0)
        prior = 2.0 * _PRIOR_PER_DIAGONAL * float(np.hypot(*half))
        return cls(middle, half, prior)

    def shapes(self, board_mm: _FloatArray) -> _FloatArray:
        """Return the heights (N, W) [mm] of corners (N, 2) along z, for one prior deviation of each parabola."""
        parabolas = self.prior_mm * (1.0 - ((board_mm - self.middle_mm) / self.half_mm) ** 2)
        may_turn = np.isclose(self.half_mm[0], self.half_mm[1])
        return np.asarray(parabolas.sum(axis=1, keepdims=True) if may_turn else parabolas)

    def describe(self, warp: _FloatArray, sigma: _FloatArray, *, away: bool) -> BoardWarp:
        """Return the fitted warp [prior deviations] in mm; `away` if z of the board points away from the camera."""
        row, column = np.broadcast_to((-1.0 if away else 1.0) * self.prior_mm * warp, 2)
        sigma_row, sigma_column = np.broadcast_to(self.prior_mm * sigma, 2)
        return BoardWarp(float(row), float(column), float(sigma_row), float(sigma_column), self.prior_mm)
