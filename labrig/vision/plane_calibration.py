"""The plane map from one picture of graph paper.

The homography is the least-squares one over all crossings (some thousands), so that the map is far better than one
crossing: on drawn pictures at 15 px/mm crossings scatter by 0.007 mm and the map is right to 0.001 mm. What is left
out is only what is a quarter of a pitch or more off; the rest, be it the lens or paper that is not flat, shows in the
residuals, over the picture in `residual_field_mm`, and decides whether the map is accepted.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError
from labrig.vision.graph_paper import Crossings, find_crossings
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.limits import above, below
from labrig.vision.picture import Picture, require_size, size_of
from labrig.vision.plane import PICTURE_AXES, Insertion, PlaneMap, checked_frame, projected, undistorted

_FloatArray = NDArray[np.float64]

# Limits of a map that is accepted. The map is wanted to 0.02 mm; that many crossings average their own errors
# out, so what this residual limits is the paper's unevenness and the lens.
_LARGEST_RMS_MM = 0.05
_LEAST_CROSSINGS = 60
_LEAST_COVERAGE = 0.25
_LARGEST_GROSS_SHARE = 0.1
_LARGEST_TURN_RAD = float(np.deg2rad(30.0))
# A crossing further than this from its place, in pitches, was mistaken for something else.
_GROSS = 0.25
_MAX_REFITS = 10
# Side of the blocks of crossings that the hold-out leaves out in turn: neighbours would vouch for one
# another.
_BLOCK = 5


@dataclass(frozen=True, eq=False)
class _Fit:
    """A homography from ideal pixels to paper [mm], which crossings it explains (N,), and by how much not (N,) [mm]."""

    homography: _FloatArray
    kept: NDArray[np.bool_]
    residuals_mm: _FloatArray


def calibrate_plane(
    image: Picture,
    intrinsics: Intrinsics | None,
    pitch_mm: float,
    origin_px: tuple[float, float],
    insertion: Insertion,
) -> PlaneMap:
    """Make the map from one picture of graph paper that lies in the steering plane.

    +z runs along the ruled lines that are nearest to `insertion` in the picture, and the origin is exactly
    `origin_px`, on a line or not. The homography is the least-squares one over all crossings but gross
    mistakes.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
        As the camera took it, not undistorted.
    intrinsics : Intrinsics or None
        Without them the lens's distortion stays in, and shows in `rms_mm`.
    pitch_mm : float
        Distance between the nearest lines of the paper; heavier ones every 5 or 10 mm do not matter.
    origin_px : (float, float)
        The pixel that is to be (0, 0) mm.
    insertion : "right", "left", "up" or "down"

    Returns
    -------
    PlaneMap
        `accepted` is False, with reasons, where it should not be relied on.

    Raises
    ------
    InputError
        If the pitch, the origin or the direction is impossible, or (as PictureError) the picture has another
        size than the intrinsics.
    CalibrationRefusedError
        If no grid is found, or no plane explains it.
    """
    size = size_of(image)
    origin, direction = checked_frame(origin_px, insertion)
    _check_inputs(pitch_mm, origin, size)
    if intrinsics is not None:
        require_size(image, intrinsics.image_size, "the lens's calibration")
    found, ideal, ideal_origin = _seen(image, intrinsics, origin)
    paper = np.asarray(found.indices * float(pitch_mm), dtype=np.float64)
    fit = _fitted(ideal, paper, _GROSS * pitch_mm)
    framed, turn = _framed(fit.homography, ideal_origin, direction)
    bare = PlaneMap(
        homography=framed,
        intrinsics=intrinsics,
        origin_px=origin,
        insertion=direction,
        image_size=size,
        mm_per_px=_mm_per_px(framed, intrinsics, origin),
        holdout_rms_mm=_holdout_rms(ideal, paper, found.indices, fit.kept),
    )
    return _judged(bare, found, fit, turn)


def _check_inputs(pitch_mm: float, origin: tuple[float, float], size: tuple[int, int]) -> None:
    if not (np.isfinite(pitch_mm) and pitch_mm > 0.0):
        raise InputError(f"pitch is {pitch_mm} mm, not a positive number", "measure ten lines with a ruler")
    if not (0.0 <= origin[0] <= size[0] - 1 and 0.0 <= origin[1] <= size[1] - 1):
        raise InputError(
            f"origin ({origin[0]:g}, {origin[1]:g}) px is outside the picture of {size[0]} x {size[1]}",
            "give a pixel of the picture",
        )


def _seen(
    image: Picture, intrinsics: Intrinsics | None, origin: tuple[float, float]
) -> tuple[Crossings, _FloatArray, _FloatArray]:
    """Return the paper's crossings, their ideal pixels (N, 2), and the origin's (1, 2)."""
    try:
        found = find_crossings(image)
        return found, undistorted(intrinsics, found.pixels), undistorted(intrinsics, np.array([origin]))
    except MeasurementRefusedError as refusal:
        raise CalibrationRefusedError(refusal.message, refusal.hint) from refusal


def _fitted(ideal: _FloatArray, paper: _FloatArray, gross_mm: float) -> _Fit:
    """Fit all crossings by least squares but those that are `gross_mm` or more off."""
    # OpenCV's sampling has a fixed seed of its own.
    homography = _homography(ideal, paper, gross_mm)
    kept = np.zeros(len(ideal), dtype=bool)
    for _ in range(_MAX_REFITS):
        residuals = np.linalg.norm(projected(homography, ideal) - paper, axis=1)
        last, kept = kept, residuals < gross_mm
        if (kept == last).all():
            break
        homography = _homography(ideal[kept], paper[kept])
    return _Fit(homography, kept, residuals)


def _homography(ideal: _FloatArray, paper: _FloatArray, gross_mm: float | None = None) -> _FloatArray:
    """Return the homography from ideal pixels to paper; by least squares, or by sampling where mistakes are likely."""
    found = None
    if len(ideal) >= 4:
        method = 0 if gross_mm is None else cv2.RANSAC
        found = cv2.findHomography(ideal, paper, method, gross_mm or 0.0)[0]
    if found is None:
        raise CalibrationRefusedError(
            "no plane explains the paper's lines", "lay the paper flat and fill the picture with it"
        )
    return np.asarray(found, dtype=np.float64)


def _holdout_rms(
    ideal: _FloatArray, paper: _FloatArray, indices: NDArray[np.int64], kept: NDArray[np.bool_]
) -> float | None:
    """Return the error [mm] of each half of the paper, in alternate blocks, through the map of the other half."""
    odd = (indices // _BLOCK).sum(axis=1) % 2 == 1
    if min((odd & kept).sum(), (~odd & kept).sum()) < 4:
        return None
    errors = []
    for half, other in ((odd & kept, ~odd & kept), (~odd & kept, odd & kept)):
        homography = _homography(ideal[other], paper[other])
        errors.append(projected(homography, ideal[half]) - paper[half])
    return float(np.sqrt(np.mean(np.sum(np.vstack(errors) ** 2, axis=1))))


def _framed(
    homography: _FloatArray, ideal_origin: _FloatArray, insertion: Insertion
) -> tuple[_FloatArray, float]:
    """Return the homography to the steering plane frame, and the angle [rad] from `insertion` to +z there."""
    place = projected(homography, ideal_origin)[0]
    ahead = projected(np.linalg.inv(homography), place + 1e-3 * np.eye(2)) - ideal_origin
    lines = ahead / np.linalg.norm(ahead, axis=1)[:, None]
    # Rows +y and +z, columns the paper's two axes: the cosines between them in the picture.
    along = np.array(PICTURE_AXES[insertion], dtype=np.float64) @ lines.T
    z_line = int(np.argmax(np.abs(along[1])))
    turn = np.zeros((2, 2))
    for row, line in ((0, 1 - z_line), (1, z_line)):
        turn[row, line] = np.sign(along[row, line])
    change = np.eye(3)
    change[:2, :2], change[:2, 2] = turn, -turn @ place
    return change @ homography, float(np.arccos(np.clip(np.abs(along[1, z_line]), 0.0, 1.0)))


def _mm_per_px(homography: _FloatArray, intrinsics: Intrinsics | None, origin: tuple[float, float]) -> float:
    """Return the square root of the area [mm] of the pixel at the origin."""
    sides = np.asarray(origin) + 0.5 * np.array([(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)])
    mm = projected(homography, undistorted(intrinsics, sides))
    return float(np.sqrt(np.abs(np.linalg.det(np.array([mm[1] - mm[0], mm[3] - mm[2]])))))


def _judged(bare: PlaneMap, found: Crossings, fit: _Fit, turn_rad: float) -> PlaneMap:
    pixels, residuals = found.pixels[fit.kept], fit.residuals_mm[fit.kept]
    rms = float(np.sqrt(np.mean(residuals**2)))
    reasons = (
        *_paper_reasons(pixels, float(np.mean(~fit.kept)), bare.image_size or (1, 1)),
        *_fit_reasons(rms, turn_rad, bare),
    )
    return replace(
        bare,
        rms_mm=rms,
        worst_mm=float(residuals.max()),
        residual_field_mm=_residual_field(pixels, residuals, bare.image_size or (1, 1)),
        crossings=len(pixels),
        accepted=not reasons,
        reasons=reasons,
    )


def _paper_reasons(pixels: _FloatArray, gross: float, size: tuple[int, int]) -> list[str]:
    """Say what the paper in the picture lacks."""
    reasons = []
    if len(pixels) < _LEAST_CROSSINGS:
        reasons.append(
            f"{len(pixels)} crossings of ruled lines, {_LEAST_CROSSINGS} are needed: show more of the paper"
        )
    coverage = float(cv2.contourArea(cv2.convexHull(pixels.astype(np.float32)))) / (size[0] * size[1])
    if coverage < _LEAST_COVERAGE:
        reasons.append(
            f"the paper's lines cover {below(100.0 * coverage, 1)} % of the picture, "
            f"{100.0 * _LEAST_COVERAGE:.0f} % are needed: "
            "use a larger sheet, evenly lit"
        )
    if gross > _LARGEST_GROSS_SHARE:
        reasons.append(
            f"{above(100.0 * gross, 1)} % of the crossings fit no plane, "
            f"the limit is {100.0 * _LARGEST_GROSS_SHARE:.0f} %: "
            "lay the paper flat, and take what is not paper out of the picture"
        )
    return reasons


def _fit_reasons(rms_mm: float, turn_rad: float, bare: PlaneMap) -> list[str]:
    """Say what is wrong with the fit, or with the lens that it rests on."""
    reasons = []
    if bare.intrinsics is not None and not bare.intrinsics.accepted:
        reasons.append("the lens's calibration was itself refused: calibrate the lens again first")
    if rms_mm > _LARGEST_RMS_MM:
        remedy = (
            "lay the paper flat" if bare.intrinsics else "give the lens's calibration, or lay the paper flat"
        )
        reasons.append(
            f"the crossings are {above(rms_mm, 3)} mm off a plane, the limit is {_LARGEST_RMS_MM} mm: {remedy}"
        )
    if turn_rad > _LARGEST_TURN_RAD:
        reasons.append(
            f"the lines are turned by {above(np.rad2deg(turn_rad), 1)} degrees from {bare.insertion!r}, "
            f"the limit is {np.rad2deg(_LARGEST_TURN_RAD):.0f}: lay the paper along the insertion"
        )
    return reasons


def _residual_field(
    pixels: _FloatArray, residuals_mm: _FloatArray, size: tuple[int, int]
) -> tuple[tuple[float | None, ...], ...]:
    """Return the rms residual [mm] in the ninths of the picture, row by row."""
    columns, rows = np.clip((3.0 * (pixels + 0.5) / size).astype(int), 0, 2).T
    field: list[list[float | None]] = [[None] * 3 for _ in range(3)]
    for row in range(3):
        for column in range(3):
            inside = residuals_mm[(rows == row) & (columns == column)]
            if len(inside):
                field[row][column] = float(np.sqrt(np.mean(inside**2)))
    return tuple(tuple(row) for row in field)
