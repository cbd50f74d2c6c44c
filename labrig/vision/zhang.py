"""Camera calibration from photographs of a flat board (Zhang 2000, IEEE PAMI 22:1330).

Corners come from `boards`, camera and covariance from `bundle`. This file checks the views, leaves out those that the
others contradict, and has the result judged (`lens_evidence`).
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError
from labrig.vision.boards import BoardSearch, board_points_mm, find_board
from labrig.vision.bundle import Fit, LensModel, ObservedView, find_pose, fit_camera, project
from labrig.vision.intrinsics import Intrinsics, ViewResidual
from labrig.vision.lens_evidence import LEAST_DIFFERENT_VIEWS, judge_lens
from labrig.vision.mixed_settings import OtherSetting, find_other_setting
from labrig.vision.picture import Picture, size_of

_FloatArray = NDArray[np.float64]

_LEAST_CORNERS = 6
_FOLDS = 8
# A view is a gross outlier if its predicted error exceeds the median by this factor, and exceeds this many pixels.
_OUTLIER_FACTOR = 4.0
_OUTLIER_PX = 0.5


def calibrate_from_pictures(
    pictures: Sequence[tuple[str, Picture]],
    columns: int,
    rows: int,
    square_mm: float,
    *,
    search: BoardSearch | None = None,
    model: LensModel = "brown",
) -> Intrinsics:
    """Calibrate from named photographs of a board.

    Photographs without a board, or of another size than most, are listed in `views` with the reason.

    Parameters
    ----------
    pictures : sequence of (str, ndarray)
    columns, rows : int
        Inner corners, not squares.
    square_mm : float
    search : BoardSearch, optional
        Kind of board, and how to search for it; without it, a whole chessboard.
    model : "brown" or "zhang"

    Raises
    ------
    InputError
        If there are no pictures, or the board's description is impossible.
    CalibrationRefusedError
        If no picture shows the board.
    """
    size = _find_common_size(pictures)
    board_points_mm(columns, rows, square_mm)
    names, boards, pixels, missed = [], [], [], {}
    for index, (name, image) in enumerate(pictures):
        other = _describe_other_size(image, size)
        if other is not None:
            missed[index] = ViewResidual(name, None, used=False, reason=other)
            continue
        try:
            seen = find_board(image, columns, rows, search)
            names.append(name)
            boards.append(seen.cells * float(square_mm))
            pixels.append(seen.pixels)
        except MeasurementRefusedError as refusal:
            missed[index] = ViewResidual(name, None, used=False, reason=f"{refusal.message}: {refusal.hint}")
    if not names:
        raise CalibrationRefusedError(
            f"no board of {columns} x {rows} inner corners was found in any of {len(pictures)} pictures: "
            "show the whole board, flat and sharp, with its white margin",
            "count inner corners, not squares",
        )
    found = calibrate_intrinsics(boards, pixels, size, names, model=model)
    rest = iter(found.views)
    views = tuple(missed[index] if index in missed else next(rest) for index in range(len(pictures)))
    return replace(found, views=views)


def _find_common_size(pictures: Sequence[tuple[str, Picture]]) -> tuple[int, int]:
    """Return the size of most pictures; in a tie, the size that comes first."""
    if not pictures:
        raise InputError("no pictures to calibrate from", "give photographs of the board")
    return Counter(size_of(image) for _, image in pictures).most_common(1)[0][0]


def _describe_other_size(image: Picture, size: tuple[int, int]) -> str | None:
    """Return why a picture is not of the calibrated camera setting, or None."""
    found = size_of(image)
    if found == size:
        return None
    return (
        f"{found[0]} x {found[1]} pixels, the calibration is of {size[0]} x {size[1]}: "
        "calibrate from pictures of one camera setting"
    )


def calibrate_intrinsics(
    board_points_mm: Sequence[ArrayLike],
    pixels: Sequence[ArrayLike],
    image_size: tuple[int, int],
    names: Sequence[str] | None = None,
    *,
    model: LensModel = "brown",
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
    model : "brown" or "zhang"
        OpenCV's five coefficients of distortion, or Zhang's two with a skew of the pixel axes.

    Returns
    -------
    Intrinsics
        `accepted` is False, with reasons, if measurements should not rely on it. A view that grossly
        contradicts the others is left out and listed with the reason.

    Raises
    ------
    InputError
        If the lists do not match or are empty, or an array has the wrong shape or values that are not finite.
    CalibrationRefusedError
        If no camera explains the views at all.
    """
    views = _check_views(board_points_mm, pixels, image_size, names)
    kept = list(range(len(views)))
    residuals: dict[int, ViewResidual] = {}
    while True:
        chosen = [views[index] for index in kept]
        fit, predicted = fit_camera(chosen, image_size, model), _predict_rms(chosen, image_size, model)
        worst = _find_gross_outlier(predicted)
        if worst is None:
            break
        rms = float(predicted[worst])
        reason = f"its corners are {rms:.2f} px from where the other views put them"
        view = views[kept[worst]]
        residuals[kept[worst]] = ViewResidual(
            view.name, rms, used=False, reason=reason, corners_px=_pairs(view.pixels)
        )
        del kept[worst]
    mixed = find_other_setting(fit, chosen, lambda some: fit_camera(some, image_size, model))
    for index, pose in zip(kept, fit.poses, strict=True):
        residuals[index] = _describe_view(views[index], fit, pose, mixed)
    holdout = float(np.sqrt(np.mean(predicted**2))) if len(predicted) else None
    listed = tuple(residuals[index] for index in range(len(views)))
    found = judge_lens(chosen, fit, holdout, image_size, listed)
    # Numbers fitted to two settings describe neither.
    return found if mixed is None else replace(found, accepted=False, reasons=(mixed.reason,))


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
    if min(size) < 1:
        raise InputError(f"the picture's size is {size[0]} x {size[1]}", "give width and height in pixels")
    views = [_check_view(*view) for view in zip(labels, boards, pixels, strict=True)]
    for view in views:
        if (view.pixels < -0.5).any() or (view.pixels > np.array(size) - 0.5).any():
            raise InputError(
                f"{view.name}: a corner lies outside the picture of {size[0]} x {size[1]}",
                "check the picture's size",
            )
    return views


def _check_view(name: str, board: ArrayLike, pixels: ArrayLike) -> ObservedView:
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
    return ObservedView(name, np.column_stack((flat, np.zeros(len(flat)))), seen)


def _describe_view(
    view: ObservedView, fit: Fit, pose: _FloatArray, mixed: OtherSetting | None
) -> ViewResidual:
    """Return what a view contributed to the fit."""
    errors = project(fit, pose, view.board) - view.pixels
    other = mixed is not None and view.name in mixed.others
    return ViewResidual(
        view.name,
        _rms(view, fit, pose),
        used=True,
        reason=f"of another camera setting: its focal length is {mixed.difference}"
        if mixed and other
        else None,
        corners_px=_pairs(view.pixels),
        errors_px=_pairs(errors),
    )


def _pairs(points: _FloatArray) -> tuple[tuple[float, float], ...]:
    return tuple((float(u), float(v)) for u, v in points)


def _rms(view: ObservedView, fit: Fit, pose: _FloatArray) -> float:
    errors = project(fit, pose, view.board) - view.pixels
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def _predict_rms(views: Sequence[ObservedView], size: tuple[int, int], model: LensModel) -> _FloatArray:
    """Return the reprojection error of each view [px] through a camera that was fitted without it.

    Only the pose is fitted to the view itself. Up to `_FOLDS` views are left out singly, more views in `_FOLDS`
    groups. With fewer than three views nothing can be predicted, and the result is empty.
    """
    if len(views) < 3:
        return np.empty(0)
    predicted = np.full(len(views), np.inf)
    folds = min(len(views), _FOLDS)
    for fold in range(folds):
        fit = fit_camera([view for index, view in enumerate(views) if index % folds != fold], size, model)
        for index in range(fold, len(views), folds):
            pose = find_pose(fit, views[index])
            predicted[index] = np.inf if pose is None else _rms(views[index], fit, pose)
    return predicted


def _find_gross_outlier(predicted: _FloatArray) -> int | None:
    """Return the index of the view that the others predict far worse than one another, or None."""
    if len(predicted) <= LEAST_DIFFERENT_VIEWS:
        return None
    worst = int(np.argmax(predicted))
    limit = max(_OUTLIER_PX, _OUTLIER_FACTOR * float(np.median(predicted)))
    return worst if predicted[worst] > limit else None
