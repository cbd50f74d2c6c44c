"""The corners of a flat board in a photograph: chessboards, whole or cut by the frame, ChArUco boards and AprilGrids.

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
- An AprilGrid is Kalibr's: tags of the family 36h11 with a black border of two cells, numbered from the lower left, and
  black squares between their corners. OpenCV finds the tags and puts their corners up to a sixth of a side off, so a
  corner counts only if it proves true after refinement. Of drawn tags of 50 px or more the corners are then off by
  0.03 to 0.07 px (rms, noise of 2 grey levels); smaller or blurred tags lose corners or are not found.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.marker import load_dictionary
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
# Tags of the family 36h11, and the width of their border in cells.
_APRIL_TAGS, _APRIL_BORDER = 587, 2
# Corners of a tag in OpenCV's order, y up; OpenCV's tags are turned by 180 degrees against Kalibr's.
_TAG_CORNERS = np.array([(1.0, 0.0), (0.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
# Radius of the circle around a corner in corner spacings, its samples, and the least share of the second harmonic.
_CIRCLE, _CIRCLE_SAMPLES, _LEAST_ALTERNATION = 0.25, 32, 0.6
# A corner further than this from the grid of the others, in sides of a square or of a tag, is false; a lens bends the
# grid by less.
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
class AprilGrid:
    """What makes a board an AprilGrid as Kalibr draws it.

    Attributes
    ----------
    tag_spacing : float
        Gap between tags over the side of a tag, `tagSpacing` of Kalibr.
    """

    tag_spacing: float

    def __post_init__(self) -> None:
        if not 0.0 < self.tag_spacing <= 1.0:
            raise InputError(
                f"the tag spacing is {self.tag_spacing:g}, and has to be above 0 and at most 1",
                "give the gap between tags over the side of a tag, tagSpacing of Kalibr",
            )


@dataclass(frozen=True)
class BoardSearch:
    """How to search for the board.

    Attributes
    ----------
    partial : bool
        Whether the frame may cut a chessboard; it may always cut a ChArUco board or an AprilGrid.
    charuco : Charuco or None
        None for another board.
    april : AprilGrid or None
        None for a board of squares. The columns and rows of an AprilGrid are those of its tags, its square is a tag.
    window_px : int or None
        Half side of the refinement window; None (recommended) derives it from the corner spacing.
    """

    partial: bool = False
    charuco: Charuco | None = None
    window_px: int | None = None
    april: AprilGrid | None = None

    def __post_init__(self) -> None:
        if self.window_px is not None and self.window_px < 1:
            raise InputError(f"the corner window is {self.window_px} px", "give 1 or more, or leave it out")
        if self.charuco is not None and self.april is not None:
            raise InputError("a board is a ChArUco board or an AprilGrid, not both", "leave one out")

    def name_board(self, columns: int, rows: int) -> str:
        """Return the board in words."""
        if self.april is not None:
            return f"AprilGrid of {columns} x {rows} tags"
        return f"board of {columns} x {rows} inner corners"


@dataclass(frozen=True, eq=False)
class BoardView:
    """The corners found.

    Attributes
    ----------
    cells : ndarray (N, 2)
        Their places along rows and columns of the board, in sides of a square or of a tag.
    pixels : ndarray (N, 2)
        (u, v).
    pitch : float
        Least distance between corners of the board, in the unit of `cells`.
    """

    cells: _FloatArray
    pixels: _FloatArray
    pitch: float = 1.0


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
    _require_side(square_mm)
    return np.asarray(_cells(columns, rows) * float(square_mm), dtype=np.float64)


def check_board(columns: int, rows: int, square_mm: float, search: BoardSearch) -> None:
    """Raise `InputError` if there is no such board."""
    if search.april is None:
        board_points_mm(columns, rows, square_mm)
        return
    if min(columns, rows) < 1 or not 4 * columns * rows >= _LEAST_PART or columns * rows > _APRIL_TAGS:
        raise InputError(
            f"the AprilGrid has {columns} x {rows} tags",
            f"{_LEAST_PART // 4} to {_APRIL_TAGS} are possible; count tags, not corners",
        )
    _require_side(square_mm)


def _require_side(square_mm: float) -> None:
    if not (np.isfinite(square_mm) and square_mm > 0.0):
        raise InputError(f"the board's squares are {square_mm} mm", "measure a square with a ruler")


def _cells(columns: int, rows: int) -> _FloatArray:
    row, column = np.mgrid[0:rows, 0:columns].astype(np.float64)
    return np.column_stack((column.ravel(), row.ravel()))


def find_board(image: Picture, columns: int, rows: int, search: BoardSearch | None = None) -> BoardView:
    """Find the inner corners of a board, or of its visible part, to a fraction of a pixel, row by row.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    columns, rows : int
        Inner corners, not squares; tags of an AprilGrid.
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
    if search.april is not None:
        return _find_april(grey, columns, rows, search.april, search.window_px)
    if search.charuco is not None:
        found = _find_charuco(grey, columns, rows, search.charuco)
    else:
        found = _find_whole(grey, columns, rows)
        if found is None and search.partial:
            found = _find_part(grey, columns, rows)
    if found is None:
        raise MeasurementRefusedError(
            f"no {search.name_board(columns, rows)}",
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
        cells, pixels = found.cells[true], found.pixels[true]
        # OpenCV's sampling has a fixed seed of its own.
        true[true] = (
            cv2.findHomography(cells, pixels, cv2.RANSAC, _OFF_GRID * spacing / found.pitch)[1].ravel() > 0
        )
    if true.sum() < _LEAST_PART:
        return None
    return replace(found, cells=found.cells[true], pixels=found.pixels[true])


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
    index = np.asarray(numbers, dtype=np.int64).ravel()
    return BoardView(_cells(columns, rows)[index], np.asarray(corners, dtype=np.float64).reshape(-1, 2))


def _find_april(grey: Picture, columns: int, rows: int, grid: AprilGrid, window_px: int | None) -> BoardView:
    """Return the refined corners of an AprilGrid's visible tags."""
    rough = _find_tags(grey, columns, rows, grid)
    found = None
    if len(rough.pixels) >= _LEAST_PART:
        fine = _refine_corners(grey, rough.pixels, _smallest_spacing(rough), window_px)
        found = _select_true_corners(grey, replace(rough, pixels=fine))
    # A row of a grid of another layout fits by itself.
    true = 0 if found is None else len(found.pixels)
    if found is None or 2 * true <= len(rough.pixels):
        raise MeasurementRefusedError(
            f"no AprilGrid of {columns} x {rows} tags: of {len(rough.pixels)} corners of tags, {true} prove true, "
            f"at least {_LEAST_PART} and more than half have to",
            "show tags of 50 px or more, sharply, of a grid that Kalibr drew: tag 0 at the lower left, black squares "
            "between the tags",
        )
    return found


def _find_tags(grey: Picture, columns: int, rows: int, grid: AprilGrid) -> BoardView:
    """Return the rough corners of the tags that can be told, four for each tag."""
    setting = cv2.aruco.DetectorParameters()
    setting.markerBorderBits = _APRIL_BORDER
    tags = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, numbers, _ = cv2.aruco.ArucoDetector(tags, setting).detectMarkers(grey)
    index = np.array([] if numbers is None else numbers, dtype=np.int64).ravel()
    # Of two tags of one number, one is of another board, and nothing tells which.
    told = (np.bincount(index, minlength=1)[index] == 1) & (index < columns * rows)
    places = np.column_stack((index % columns, index // columns))[told] * (1.0 + grid.tag_spacing)
    return BoardView(
        (places[:, None] + _TAG_CORNERS).reshape(-1, 2),
        np.array(corners, dtype=np.float64).reshape(-1, 4, 2)[told].reshape(-1, 2),
        grid.tag_spacing,
    )


def _refine(grey: Picture, found: BoardView, window_px: int | None) -> BoardView:
    """Refine the corners; refuse them if one of them moves far."""
    spacing = _smallest_spacing(found)
    fine = _refine_corners(grey, found.pixels, spacing, window_px)
    moved = float(np.linalg.norm(fine - found.pixels, axis=1).max())
    if moved > 0.5 * spacing:
        raise MeasurementRefusedError(
            f"a corner moved {moved:.1f} px in refinement, corners are {spacing:.1f} px apart",
            "hold the board closer",
        )
    return replace(found, pixels=fine)


def _refine_corners(grey: Picture, pixels: _FloatArray, spacing: float, window_px: int | None) -> _FloatArray:
    """Return corners refined in windows that do not reach their neighbours, unless `window_px` sets another size."""
    bound = int(np.clip(spacing * _WINDOW_PER_SPACING, _SMALLEST_WINDOW_PX, _LARGEST_WINDOW_PX))
    window = bound if window_px is None else window_px
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    rough = pixels.astype(np.float32).reshape(-1, 1, 2)
    fine = cv2.cornerSubPix(grey, rough, (window, window), (-1, -1), stop)
    return np.asarray(fine.reshape(-1, 2), dtype=np.float64)


def _smallest_spacing(found: BoardView) -> float:
    """Return the least distance [px] between neighbouring corners of the board, by those that are seen."""
    apart = np.linalg.norm(found.cells[:, None] - found.cells[None], axis=2)
    neighbours = (apart > 0.0) & (apart < 1.0 + 1e-6)
    if not neighbours.any():
        raise MeasurementRefusedError(
            "no two neighbouring corners of the board are seen", "show more of the board"
        )
    distances = np.linalg.norm(found.pixels[:, None] - found.pixels[None], axis=2)
    return found.pitch * float((distances[neighbours] / apart[neighbours]).min())
