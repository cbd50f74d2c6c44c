"""Camera calibration from photographs of a flat board (Zhang 2000, IEEE PAMI 22:1330), by OpenCV.

Decided here, with figures measured on OpenCV's own thirteen photographs of a board:

- Corners come from `findChessboardCorners` and `cornerSubPix`. The newer `findChessboardCornersSB`, asked to be
  accurate and exhaustive, misses a board that the classic one finds and takes thirty times as long.
- The refinement window is a third of the smallest corner spacing. Half of the spacing reaches neighbouring
  corners (RMS 0.35 px, fx 1.9 px off), a third gives RMS 0.178 px.
- The RMS of the fit never decides: nearly identical photographs can give 0.2 px and a focal length 20 % off. What
  decides is the number of different poses, their tilts, how much of the picture they cover, the standard deviation
  of the focal lengths, and the error in predicting photographs that were left out. Of random subsets of 3, 5 and
  8 photographs 7, 61 and 97 % are accepted under these limits; the worst focal length among them is 0.5, 0.75
  and 0.4 % off, and without the limits it is 2.8, 1.35 and 0.4 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError, PictureError
from labrig.vision.intrinsics import Intrinsics, ViewResidual
from labrig.vision.limits import above, below
from labrig.vision.picture import Picture, as_grey, size_of

_FloatArray = NDArray[np.float64]

_CORNER_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SMALLEST_WINDOW_PX = 2
_LARGEST_WINDOW_PX = 11
_WINDOW_PER_SPACING = 1.0 / 3.0

_LEAST_CORNERS = 6
# Limits of a calibration that is accepted.
_LEAST_DIFFERENT_VIEWS = 3
_LEAST_TILT_SPREAD_RAD = np.deg2rad(20.0)
_LEAST_COVERAGE = 0.35
_LARGEST_SIGMA_SHARE = 0.002
_LARGEST_HOLDOUT_PX = 1.0
# Poses are one pose if their tilts and their places (in distances from the camera) differ by less.
_SAME_TILT_RAD = np.deg2rad(4.0)
_SAME_PLACE = 0.04
_FOLDS = 8
# A view is a gross outlier if it is predicted this much worse than the median view, and worse than this.
_OUTLIER_FACTOR = 4.0
_OUTLIER_PX = 1.0


@dataclass(frozen=True)
class _View:
    """One photograph's corners: board (N, 3) [mm], pixels (N, 2)."""

    name: str
    board: _FloatArray
    pixels: _FloatArray


@dataclass(frozen=True)
class _Fit:
    """What one run of the calibration gave; `turns` are rotation vectors (3,), `shifts` in mm (3,)."""

    rms_px: float
    matrix: _FloatArray
    distortion: _FloatArray
    sigma: _FloatArray
    turns: tuple[_FloatArray, ...]
    shifts: tuple[_FloatArray, ...]


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
    row, column = np.mgrid[0:rows, 0:columns]
    return np.column_stack((column.ravel(), row.ravel())) * float(square_mm)


def find_board_corners(image: Picture, columns: int, rows: int) -> _FloatArray:
    """Find the inner corners of a chessboard to a fraction of a pixel.

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
    grey = as_grey(image)
    found, corners = cv2.findChessboardCorners(grey, (columns, rows), flags=_CORNER_FLAGS)
    if not found:
        raise MeasurementRefusedError(
            f"no board of {columns} x {rows} inner corners",
            "show the whole board, evenly lit, with its white margin",
        )
    rough = np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    spacing = _smallest_spacing(rough.reshape(rows, columns, 2))
    window = int(np.clip(spacing * _WINDOW_PER_SPACING, _SMALLEST_WINDOW_PX, _LARGEST_WINDOW_PX))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    fine = cv2.cornerSubPix(grey, rough.copy(), (window, window), (-1, -1), stop)
    moved = float(np.linalg.norm(fine - rough, axis=2).max())
    if moved > 0.5 * spacing:
        raise MeasurementRefusedError(
            f"a corner moved {moved:.1f} px in refinement, corners are {spacing:.1f} px apart",
            "hold the board closer",
        )
    return np.asarray(fine.reshape(-1, 2), dtype=np.float64)


def _smallest_spacing(grid: NDArray[np.float32]) -> float:
    """Return the least distance between neighbours in a (rows, columns, 2) grid of pixels."""
    return min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min()) for axis in (0, 1))


def calibrate_from_pictures(
    pictures: Sequence[tuple[str, Picture]], columns: int, rows: int, square_mm: float
) -> Intrinsics:
    """Calibrate from named photographs of a chessboard.

    Photographs in which the board is not found are listed in `views` with the reason.

    Raises
    ------
    PictureError
        If the photographs are not all of one size.
    InputError
        If there are none, or the board's description is impossible.
    CalibrationRefusedError
        If the board is found in none of them.
    """
    size = _common_size(pictures)
    board = board_points_mm(columns, rows, square_mm)
    names, pixels, missed = [], [], {}
    for index, (name, image) in enumerate(pictures):
        try:
            pixels.append(find_board_corners(image, columns, rows))
            names.append(name)
        except MeasurementRefusedError as refusal:
            missed[index] = ViewResidual(name, None, used=False, reason=f"{refusal.message}: {refusal.hint}")
    if not names:
        raise CalibrationRefusedError(
            f"no board of {columns} x {rows} inner corners was found in any of {len(pictures)} pictures: "
            "show the whole board, flat and sharp, with its white margin",
            "count inner corners, not squares",
        )
    found = calibrate_intrinsics([board] * len(names), pixels, size, names)
    rest = iter(found.views)
    views = tuple(missed[index] if index in missed else next(rest) for index in range(len(pictures)))
    return replace(found, views=views)


def _common_size(pictures: Sequence[tuple[str, Picture]]) -> tuple[int, int]:
    if not pictures:
        raise InputError("no pictures to calibrate from", "give photographs of the board")
    first, size = pictures[0][0], size_of(pictures[0][1])
    for name, image in pictures[1:]:
        if size_of(image) != size:
            other = size_of(image)
            raise PictureError(
                f"{name} has {other[0]} x {other[1]} pixels, {first} has {size[0]} x {size[1]}",
                "calibrate from pictures of one camera setting",
            )
    return size


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
        Of the views; numbered from "view 0" otherwise.

    Returns
    -------
    Intrinsics
        `accepted` is False, with reasons, where it should not be relied on. A view whose corners the others
        contradict grossly is left out and listed with the reason.

    Raises
    ------
    InputError
        If the lists do not match, are empty, or hold arrays of the wrong shape or without finite numbers.
    CalibrationRefusedError
        If no camera explains the views at all.
    """
    views = _checked_views(board_points_mm, pixels, image_size, names)
    kept = list(range(len(views)))
    residuals: dict[int, ViewResidual] = {}
    while True:
        chosen = [views[index] for index in kept]
        fit, predicted = _calibrate(chosen, image_size), _predicted_rms(chosen, image_size)
        worst = _gross_outlier(predicted)
        if worst is None:
            break
        rms = float(predicted[worst])
        reason = f"left out: its corners are {rms:.1f} px from where the other views put them"
        residuals[kept[worst]] = ViewResidual(views[kept[worst]].name, rms, used=False, reason=reason)
        del kept[worst]
    for index, rms in zip(kept, _rms_by_view(chosen, fit), strict=True):
        residuals[index] = ViewResidual(views[index].name, rms, used=True)
    return _judged(chosen, fit, predicted, image_size, tuple(residuals[index] for index in range(len(views))))


def _checked_views(
    boards: Sequence[ArrayLike],
    pixels: Sequence[ArrayLike],
    size: tuple[int, int],
    names: Sequence[str] | None,
) -> list[_View]:
    labels = [f"view {index}" for index in range(len(boards))] if names is None else list(names)
    if not len(boards) == len(pixels) == len(labels):
        raise InputError(
            f"{len(boards)} boards, {len(pixels)} arrays of pixels and {len(labels)} names do not match"
        )
    if not labels:
        raise InputError("no views to calibrate from", "give at least one array of corners")
    if min(size) < 1:
        raise InputError(f"the picture's size is {size[0]} x {size[1]}", "give width and height in pixels")
    views = [_checked_view(*view) for view in zip(labels, boards, pixels, strict=True)]
    for view in views:
        if (view.pixels < -0.5).any() or (view.pixels > np.array(size) - 0.5).any():
            raise InputError(
                f"{view.name}: a corner lies outside the picture of {size[0]} x {size[1]}",
                "check the picture's size",
            )
    return views


def _checked_view(name: str, board: ArrayLike, pixels: ArrayLike) -> _View:
    flat, seen = np.asarray(board, dtype=np.float64), np.asarray(pixels, dtype=np.float64)
    if flat.ndim != 2 or flat.shape[1] != 2 or flat.shape != seen.shape:
        raise InputError(f"{name}: board points {flat.shape} and pixels {seen.shape} are not both (N, 2)")
    if len(flat) < _LEAST_CORNERS:
        raise InputError(f"{name}: {len(flat)} corners, at least {_LEAST_CORNERS} are needed")
    if not (np.isfinite(flat).all() and np.isfinite(seen).all()):
        raise InputError(f"{name}: a corner is not finite")
    for points, what in ((flat, "board points"), (seen, "pixels")):
        extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if extents[1] <= 1e-6 * extents[0]:
            raise InputError(f"{name}: the {what} lie on one line", "give corners of more than one row")
    return _View(name, np.column_stack((flat, np.zeros(len(flat)))), seen)


def _calibrate(views: Sequence[_View], size: tuple[int, int]) -> _Fit:
    boards = [view.board.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    try:
        # The stubs know only filled arrays for the matrix and the distortion, OpenCV takes None for "estimate
        # them".
        rms, matrix, distortion, turns, shifts, sigma, _, _ = cv2.calibrateCameraExtended(
            boards,
            pixels,
            size,
            None,
            None,  # type: ignore[call-overload]
        )
    except cv2.error as error:
        raise CalibrationRefusedError(
            f"no camera explains the {len(views)} views: {error.err}",
            "photograph the board tilted in several ways",
        ) from error
    return _Fit(
        rms_px=float(rms),
        matrix=np.asarray(matrix, dtype=np.float64),
        distortion=np.asarray(distortion, dtype=np.float64).ravel()[:5],
        sigma=np.asarray(sigma, dtype=np.float64).ravel()[:4],
        turns=tuple(np.asarray(turn, dtype=np.float64).ravel() for turn in turns),
        shifts=tuple(np.asarray(shift, dtype=np.float64).ravel() for shift in shifts),
    )


def _rms_by_view(views: Sequence[_View], fit: _Fit) -> list[float]:
    """Return the reprojection error of each fitted view [px]."""
    return [
        _rms(view, fit, turn, shift) for view, turn, shift in zip(views, fit.turns, fit.shifts, strict=True)
    ]


def _rms(view: _View, fit: _Fit, turn: _FloatArray, shift: _FloatArray) -> float:
    projected = cv2.projectPoints(view.board, turn, shift, fit.matrix, fit.distortion)[0]
    return float(np.sqrt(np.mean(np.sum((projected.reshape(-1, 2) - view.pixels) ** 2, axis=1))))


def _predicted_rms(views: Sequence[_View], size: tuple[int, int]) -> _FloatArray:
    """Return the reprojection error of each view [px] through a camera that was fitted without it.

    Only the view's own pose is fitted then.
    Up to `_FOLDS` views are left out one by one, more of them in `_FOLDS` groups. With fewer than three views
    there is nothing to predict from, and the answer is empty.
    """
    if len(views) < 3:
        return np.empty(0)
    predicted = np.full(len(views), np.inf)
    folds = min(len(views), _FOLDS)
    for fold in range(folds):
        fit = _calibrate([view for index, view in enumerate(views) if index % folds != fold], size)
        for index in range(fold, len(views), folds):
            predicted[index] = _posed_rms(views[index], fit)
    return predicted


def _posed_rms(view: _View, fit: _Fit) -> float:
    solved, turn, shift = cv2.solvePnP(view.board, view.pixels, fit.matrix, fit.distortion)
    if not solved:
        return float("inf")
    return _rms(view, fit, np.asarray(turn, dtype=np.float64), np.asarray(shift, dtype=np.float64))


def _gross_outlier(predicted: _FloatArray) -> int | None:
    """Return the view that the others predict grossly worse than one another, if there is one."""
    if len(predicted) <= _LEAST_DIFFERENT_VIEWS:
        return None
    worst = int(np.argmax(predicted))
    limit = max(_OUTLIER_PX, _OUTLIER_FACTOR * float(np.median(predicted)))
    return worst if predicted[worst] > limit else None


def _judged(
    views: Sequence[_View],
    fit: _Fit,
    predicted: _FloatArray,
    size: tuple[int, int],
    residuals: tuple[ViewResidual, ...],
) -> Intrinsics:
    holdout = float(np.sqrt(np.mean(predicted**2))) if len(predicted) else None
    k1, k2, p1, p2, k3 = map(float, fit.distortion)
    names = ("fx", "fy", "cx", "cy")
    found = Intrinsics(
        image_size=size,
        fx=float(fit.matrix[0, 0]),
        fy=float(fit.matrix[1, 1]),
        cx=float(fit.matrix[0, 2]),
        cy=float(fit.matrix[1, 2]),
        distortion=(k1, k2, p1, p2, k3),
        # OpenCV's are NaN where there are hardly more corners than unknowns.
        sigma={name: _known(value) for name, value in zip(names, fit.sigma, strict=True)},
        rms_px=fit.rms_px,
        holdout_rms_px=_known(holdout),
        views=residuals,
        accepted=False,
        reasons=(),
    )
    reasons = (*_pose_reasons(views, fit, size), *_number_reasons(found))
    return replace(found, accepted=not reasons, reasons=reasons)


def _known(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def _pose_reasons(views: Sequence[_View], fit: _Fit, size: tuple[int, int]) -> list[str]:
    """Say what the board's poses lack."""
    reasons = []
    normals, centres = _poses(views, fit)
    different = _count_different(normals, centres)
    if different < _LEAST_DIFFERENT_VIEWS:
        reasons.append(
            f"{different} different views of the board, at least {_LEAST_DIFFERENT_VIEWS} are needed: "
            "photograph it in more poses"
        )
    spread = float(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0)))
    if spread < _LEAST_TILT_SPREAD_RAD:
        reasons.append(
            f"the board's tilts differ by {below(np.rad2deg(spread), 1)} degrees at most, "
            f"{np.rad2deg(_LEAST_TILT_SPREAD_RAD):.0f} are needed: tilt it by 30 to 45 degrees, both ways"
        )
    coverage = _coverage(views, size)
    if coverage < _LEAST_COVERAGE:
        reasons.append(
            f"the boards cover {below(100.0 * coverage, 1)} % of the picture, "
            f"{100.0 * _LEAST_COVERAGE:.0f} % are needed: "
            "photograph the board near the picture's corners, or closer"
        )
    return reasons


def _poses(views: Sequence[_View], fit: _Fit) -> tuple[_FloatArray, _FloatArray]:
    """Return each board's normal towards the camera and its centre [mm], each (N, 3)."""
    turns = [np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64) for turn in fit.turns]
    posed = zip(turns, views, fit.shifts, strict=True)
    centres = np.array([turn @ view.board.mean(axis=0) + shift for turn, view, shift in posed])
    normals = np.array([turn[:, 2] for turn in turns])
    away = np.sum(normals * centres, axis=1) > 0.0
    return np.where(away[:, None], -normals, normals), centres


def _count_different(normals: _FloatArray, centres: _FloatArray) -> int:
    """Count poses, taking those for one whose tilts and places are nearly the same."""
    kept: list[int] = []
    for index, (normal, centre) in enumerate(zip(normals, centres, strict=True)):
        same_tilt = normals[kept] @ normal > np.cos(_SAME_TILT_RAD)
        same_place = np.linalg.norm(centres[kept] - centre, axis=1) < _SAME_PLACE * np.linalg.norm(centre)
        if not (same_tilt & same_place).any():
            kept.append(index)
    return len(kept)


def _coverage(views: Sequence[_View], size: tuple[int, int]) -> float:
    """Return the share of the picture inside the convex hull of all corners."""
    corners = np.vstack([view.pixels for view in views]).astype(np.float32)
    return float(cv2.contourArea(cv2.convexHull(corners))) / (size[0] * size[1])


def _number_reasons(found: Intrinsics) -> list[str]:
    """Say which of the calibration's own numbers are not good enough."""
    reasons = []
    for name, focal in (("fx", found.fx), ("fy", found.fy)):
        sigma = found.sigma[name]
        if sigma is None or sigma > _LARGEST_SIGMA_SHARE * focal:
            known = "is unknown" if sigma is None else f"is {above(sigma, 2)} px"
            reasons.append(
                f"the standard deviation of {name} {known}, "
                f"the limit is {below(_LARGEST_SIGMA_SHARE * focal, 2)} px "
                f"({_LARGEST_SIGMA_SHARE:.1%}): add views that are closer and more tilted"
            )
    holdout = found.holdout_rms_px
    if holdout is None or holdout > _LARGEST_HOLDOUT_PX:
        known = "cannot be checked" if holdout is None else f"are predicted to {above(holdout, 2)} px"
        reasons.append(
            f"views left out of the fit {known}, the limit is {_LARGEST_HOLDOUT_PX:.2f} px: "
            "add sharp views, and check that the board is flat"
        )
    if not _invertible(found):
        reasons.append(
            "the lens model folds inside the picture: photograph the board near the picture's edges"
        )
    return reasons


def _invertible(found: Intrinsics) -> bool:
    width, height = found.image_size
    along, down = np.linspace(-0.5, width - 0.5, 33), np.linspace(-0.5, height - 0.5, 25)
    try:
        found.undistort_px(np.column_stack([axis.ravel() for axis in np.meshgrid(along, down)]))
    except MeasurementRefusedError:
        return False
    return True
