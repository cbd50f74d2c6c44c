"""The evidence for and against a calibrated lens, what its uncertainty leads to, and what to photograph next.

The RMS of the fit never decides: nearly identical photographs can give 0.2 px and a focal length 20 % off. Nor does the
standard deviation of the focal length: an error of it is very nearly a shift of the plane along the axis, and one of
the principal point a small rotation of the camera, and the map of the plane absorbs both. So a lens is judged by what
its covariance leaves in lengths and radii through a plane map that is made with it, over the working area, and by what
it does to the plane's distance.

The uncertainty of each pixel is stated likewise: the rotation and the shift along the axis that fit best over the part
of the picture covered by boards are removed, as in mrcal's maps. On OpenCV's thirteen photographs 0.043 px in the
middle and 0.25 at (100, 100) are left, by the scatter between views; mrcal, which takes corners for independent, gives
0.026 and 0.14.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import MeasurementRefusedError
from labrig.text import round_down, round_up
from labrig.vision.intrinsics import (
    PARAMETERS,
    Intrinsics,
    LensEffect,
    ViewResidual,
    root_of,
    undistort_by_each,
    vary_lens,
)
from labrig.vision.lens_fit import LEAST_VIEWS, Fit, ObservedView

_FloatArray = NDArray[np.float64]

_LEAST_TILT_SPREAD_DEG = 20.0
_LEAST_COVERAGE = 0.35
_LARGEST_HOLDOUT_PX = 1.0
# The working area is the picture inside this margin; a pixel there may be as uncertain as this.
WORKING_MARGIN = 0.15
LARGEST_PROJECTION_SIGMA_PX = 1.0
# Largest standard deviation of a length or a radius, and of the plane's distance, as shares. A distance is no length in
# the plane: it enters with the height of the needle over it and with refraction, which change lengths by some percent,
# so that this share of them is below the first.
_LARGEST_EFFECT, _LARGEST_DISTANCE_EFFECT = 0.002, 0.01
# Arcs by which lengths and radii are judged: radius over the picture's longer side, angle, and places on a grid.
_ARC_RADIUS, _ARC_RAD, _ARC_PLACES = 0.2, np.deg2rad(82.0), (5, 4)
# Columns and rows of the map from corner to corner, and of the grid over which rotation, shift and paper are fitted.
_MAP_SHAPE = (9, 7)
_FIT_SHAPE = (16, 12)
_MIDDLE_MARGIN = 0.25
_LEAST_FITTED = 4
# Poses whose tilts and places (in distances from the camera) differ by less count as one pose.
_SAME_TILT_RAD = np.deg2rad(4.0)
_SAME_PLACE = 0.04


def judge_lens(
    views: Sequence[ObservedView],
    fit: Fit,
    holdout_px: float | None,
    size: tuple[int, int],
    residuals: tuple[ViewResidual, ...],
) -> Intrinsics:
    """Return the fitted lens with its evidence, accepted or with the reasons for refusing it."""
    normals, centres = _find_poses(views, fit)
    spread = float(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0)))
    seen = np.vstack([view.pixels for view in views])
    bare = replace(
        _make_intrinsics(fit, size, residuals),
        holdout_rms_px=float(holdout_px) if holdout_px is not None and np.isfinite(holdout_px) else None,
        coverage=float(cv2.contourArea(cv2.convexHull(seen.astype(np.float32)))) / (size[0] * size[1]),
        different_views=_count_different(normals, centres),
        tilt_spread_deg=float(np.rad2deg(spread)),
    )
    found = replace(bare, projection_sigma_px=_map_projection(bare, seen), effect=measure_effect(bare))
    reasons = (*_judge_poses(found, normals, seen), *_judge_numbers(found))
    return replace(found, accepted=not reasons, reasons=reasons)


def _make_intrinsics(fit: Fit, size: tuple[int, int], residuals: tuple[ViewResidual, ...]) -> Intrinsics:
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = map(float, fit.parameters)
    covariance = fit.lens_covariance
    sigmas = [None] * len(PARAMETERS) if covariance is None else np.sqrt(np.diag(covariance)).tolist()
    return Intrinsics(
        image_size=size,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=(k1, k2, p1, p2, k3),
        sigma=dict(zip(PARAMETERS, sigmas, strict=True)),
        rms_px=fit.rms_px,
        holdout_rms_px=None,
        views=residuals,
        accepted=False,
        reasons=(),
        covariance=None if covariance is None else tuple(map(tuple, covariance.tolist())),
        sigma_from="views" if fit.by_views else "corners",
    )


def _judge_poses(found: Intrinsics, normals: _FloatArray, seen: _FloatArray) -> list[str]:
    """Return what the board's poses lack."""
    reasons = []
    different, spread_deg, coverage = (
        found.different_views or 0,
        found.tilt_spread_deg or 0.0,
        found.coverage or 0.0,
    )
    if different < LEAST_VIEWS:
        reasons.append(
            f"the board was held in {different} pose{'' if different == 1 else 's'} that can be told apart, at least "
            f"{LEAST_VIEWS} are needed: turn it, tilt it and move it between the photographs"
        )
    if spread_deg < _LEAST_TILT_SPREAD_DEG:
        reasons.append(
            f"the board's tilts differ by {round_down(spread_deg, 1)} degrees at most, {_LEAST_TILT_SPREAD_DEG:.0f} "
            f"are needed: tilt it by 30 to 45 degrees, {_describe_missing_tilt(normals)}"
        )
    if coverage < _LEAST_COVERAGE:
        reasons.append(
            f"the boards cover {round_down(100.0 * coverage, 1)} % of the picture, "
            f"{100.0 * _LEAST_COVERAGE:.0f} % are needed: photograph the board near the picture's corners, first "
            f"the {_find_emptiest_corner(seen, found.image_size)} one, or closer"
        )
    return reasons


def _describe_missing_tilt(normals: _FloatArray) -> str:
    """Return the direction in which the boards were tilted least."""
    across, down = np.ptp(normals[:, :2], axis=0)
    return (
        "the left edge towards the camera, then the right"
        if across <= down
        else "the upper edge towards the camera, then the lower"
    )


def _find_emptiest_corner(seen: _FloatArray, size: tuple[int, int]) -> str:
    """Return the corner of the picture that is furthest from any corner of a board."""
    names = ("upper left", "upper right", "lower left", "lower right")
    corners = picture_grid(size, (2, 2))
    away = [float(np.linalg.norm(seen - corner, axis=1).min()) for corner in corners]
    return names[int(np.argmax(away))]


def _find_poses(views: Sequence[ObservedView], fit: Fit) -> tuple[_FloatArray, _FloatArray]:
    """Return each board's normal towards the camera and its centre [mm], each (N, 3)."""
    turns = [np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64) for pose in fit.poses]
    posed = zip(turns, views, fit.poses[:, 3:], strict=True)
    centres = np.array([turn @ view.board.mean(axis=0) + shift for turn, view, shift in posed])
    normals = np.array([turn[:, 2] for turn in turns])
    away = np.sum(normals * centres, axis=1) > 0.0
    return np.where(away[:, None], -normals, normals), centres


def _count_different(normals: _FloatArray, centres: _FloatArray) -> int:
    """Count poses; poses of nearly the same tilt and place count as one."""
    kept: list[int] = []
    for index, (normal, centre) in enumerate(zip(normals, centres, strict=True)):
        same_tilt = normals[kept] @ normal > np.cos(_SAME_TILT_RAD)
        same_place = np.linalg.norm(centres[kept] - centre, axis=1) < _SAME_PLACE * np.linalg.norm(centre)
        if not (same_tilt & same_place).any():
            kept.append(index)
    return len(kept)


def _judge_numbers(found: Intrinsics) -> list[str]:
    """Return which numbers of the calibration are not good enough."""
    reasons = _judge_effect(found)
    holdout = found.holdout_rms_px
    if holdout is None or holdout > _LARGEST_HOLDOUT_PX:
        known = "cannot be checked" if holdout is None else f"are predicted to {round_up(holdout, 2)} px"
        reasons.append(
            f"views left out of the fit {known}, the limit is {_LARGEST_HOLDOUT_PX:.2f} px: "
            "add sharp views, and check that the board is flat"
        )
    try:
        found.undistort_px(picture_grid(found.image_size, (33, 25)))
        reasons += _judge_projection(found)
    except MeasurementRefusedError:
        reasons.append(
            "the lens model folds inside the picture: photograph the board near the picture's edges"
        )
    return reasons


def _judge_effect(found: Intrinsics) -> list[str]:
    """Return what of lengths, radii and distances the lens leaves too uncertain."""
    effect = found.effect
    if effect is None:
        return [
            "the views do not determine the lens: photograph the board in more poses, tilted by 45 degrees"
        ]
    limits = (
        ("lengths in the plane", effect.length, _LARGEST_EFFECT),
        ("radii", effect.radius, _LARGEST_EFFECT),
        ("the distance from the camera to the plane", effect.distance, _LARGEST_DISTANCE_EFFECT),
    )
    return [
        f"the calibration makes {what} uncertain by {round_up(100.0 * share, 2)} %, the limit is {100.0 * most:g} %: "
        "photograph the board closer, so that it fills the picture, and tilted by 45 degrees"
        for what, share, most in limits
        if not share <= most
    ]


def _judge_projection(found: Intrinsics) -> list[str]:
    """Return where in the working area the lens is too uncertain."""
    if found.projection_sigma_px is None:
        return []
    inner = np.array(found.projection_sigma_px)[1:-1, 1:-1]
    places = picture_grid(found.image_size, _MAP_SHAPE).reshape(*_MAP_SHAPE[::-1], 2)[1:-1, 1:-1]
    worst = np.unravel_index(np.argmax(inner), inner.shape)
    if inner[worst] <= LARGEST_PROJECTION_SIGMA_PX:
        return []
    u, v = places[worst]
    reason = (
        f"the lens is uncertain by {round_up(inner[worst], 2)} px at ({u:.0f}, {v:.0f}), the limit is "
        f"{LARGEST_PROJECTION_SIGMA_PX:.2f} px: photograph the board there, so close that it fills that part"
    )
    return [reason]


def measure_effect(lens: Intrinsics) -> LensEffect | None:
    """Return what a lens's uncertainty does to measurements through a plane map made with it; None if it is unknown.

    The plane lies square before the camera, and paper in it covers the working area. For one standard deviation along
    each axis of the covariance the map is fitted anew, and its errors are read off arcs of 0.2 of the picture's longer
    side, bent four ways: the change of their chords and of the circles through them, rms over the working area. Near
    its edge an error is up to four times as large; each measurement states its own.
    """
    if lens.covariance is None:
        return None
    arcs = _draw_arcs(lens.image_size)
    paper = picture_grid(lens.image_size, _FIT_SHAPE, WORKING_MARGIN)
    places = np.vstack((paper, arcs.reshape(-1, 2)))
    try:
        lenses = vary_lens(lens)
        true = lens.undistort_px(places)
        seen = undistort_by_each(lenses, places)
    except MeasurementRefusedError:
        return None
    effects = []
    for varied, ideal in zip(lenses, seen, strict=True):
        homography, _ = cv2.findHomography(ideal[: len(paper)], true[: len(paper)])
        if homography is None:
            return None
        mapped = np.asarray(cv2.perspectiveTransform(ideal[:, None], homography), np.float64).reshape(-1, 2)
        scale = np.sqrt(abs(np.linalg.det(homography[:2, :2])))
        distance = scale * np.sqrt(varied.fx * varied.fy / (lens.fx * lens.fy)) - 1.0
        effects.append((*_compare_arcs(true[len(paper) :], mapped[len(paper) :], arcs.shape), distance))
    variances = [np.mean(np.sum(np.square(part), axis=0)) for part in zip(*effects, strict=True)]
    return LensEffect(*(float(np.sqrt(variance)) for variance in variances))


def _draw_arcs(size: tuple[int, int]) -> _FloatArray:
    """Return the pixels (A, N, 2) of arcs in the working area, bent towards all four sides."""
    radius = _ARC_RADIUS * max(size)
    turn = np.linspace(-0.5, 0.5, 21) * _ARC_RAD
    arc = radius * np.column_stack((np.sin(turn), np.cos(turn) - 1.0))
    arcs = []
    for quarter in range(4):
        bent = arc @ np.linalg.matrix_power(np.array([[0.0, 1.0], [-1.0, 0.0]]), quarter)
        bent -= 0.5 * (bent.min(axis=0) + bent.max(axis=0))
        room = np.maximum((1.0 - 2.0 * WORKING_MARGIN) * np.array(size) - np.ptp(bent, axis=0), 0.0)
        axes = [np.linspace(-0.5, 0.5, count) * side for count, side in zip(_ARC_PLACES, room, strict=True)]
        middles = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 1, 2) + 0.5 * (np.array(size) - 1.0)
        arcs.append(middles + bent)
    return np.concatenate(arcs)


def _compare_arcs(
    true: _FloatArray, mapped: _FloatArray, shape: tuple[int, ...]
) -> tuple[_FloatArray, _FloatArray]:
    """Return the relative changes (A,) of the chords of arcs, and of the circles through them."""
    true, mapped = true.reshape(shape), mapped.reshape(shape)
    chords, changed = (np.linalg.norm(arcs[:, -1] - arcs[:, 0], axis=1) for arcs in (true, mapped))
    radii, other = (np.array([_fit_radius(arc) for arc in arcs]) for arcs in (true, mapped))
    return changed / chords - 1.0, other / radii - 1.0


def _fit_radius(arc: _FloatArray) -> float:
    """Return the radius of the circle through points (N, 2) that are very nearly on one."""
    centred = arc - arc.mean(axis=0)
    design = np.column_stack((2.0 * centred, np.ones(len(arc))))
    y, z, rest = np.linalg.lstsq(design, np.sum(centred**2, axis=1), rcond=None)[0]
    return float(np.sqrt(rest + y * y + z * z))


def picture_grid(size: tuple[int, int], shape: tuple[int, int], margin: float = 0.0) -> _FloatArray:
    """Return pixels (columns * rows, 2), row by row, evenly spaced from corner to corner, inside a margin (a share)."""
    axes = (
        np.linspace(margin * (extent - 1), (1.0 - margin) * (extent - 1), count)
        for extent, count in zip(size, shape, strict=True)
    )
    return np.column_stack([axis.ravel() for axis in np.meshgrid(*axes)])


def projection_sigma_px(lens: Intrinsics, px: ArrayLike, seen_px: ArrayLike) -> _FloatArray:
    """Return the standard deviation (N,) of the pixels of fixed directions [px], both axes together.

    Parameters
    ----------
    px : array_like (N, 2)
        Pixels of the directions.
    seen_px : array_like (M, 2)
        Rotation and shift are fitted inside the hull of these pixels.

    Raises
    ------
    MeasurementRefusedError
        If the lens has no covariance, or its model has no inverse in the picture.
    """
    if lens.covariance is None:
        raise MeasurementRefusedError(
            "the views do not determine the lens", "photograph the board in more poses"
        )
    wanted = np.asarray(px, dtype=np.float64)
    rays = lens.directions(np.vstack((wanted, _choose_fit_px(lens.image_size, seen_px))))
    # A flat scene at distance one; its shift along the axis is the sixth derivative, sideways shifts are rotations.
    slopes = lens.project(rays / rays[:, 2:])[1]
    camera, moves = slopes[:, [0, 1, 2, 5]], slopes[:, 6:] @ root_of(np.array(lens.covariance))
    fitted = slice(2 * len(wanted), None)
    compensation = np.linalg.lstsq(camera[fitted], moves[fitted], rcond=None)[0]
    left = (moves - camera @ compensation)[: 2 * len(wanted)]
    return np.asarray(np.sqrt(np.sum(left**2, axis=1).reshape(-1, 2).sum(axis=1)))


def _map_projection(lens: Intrinsics, seen_px: _FloatArray) -> tuple[tuple[float, ...], ...] | None:
    """Return the uncertainty over the picture, 7 rows of 9 places from corner to corner; None if it is unknown."""
    try:
        sigma = projection_sigma_px(lens, picture_grid(lens.image_size, _MAP_SHAPE), seen_px)
    except MeasurementRefusedError:
        return None
    return tuple(map(tuple, sigma.reshape(_MAP_SHAPE[1], _MAP_SHAPE[0]).tolist()))


def _choose_fit_px(size: tuple[int, int], seen_px: ArrayLike) -> _FloatArray:
    """Return the pixels (N, 2) over which rotation and shift are fitted."""
    hull = cv2.convexHull(np.asarray(seen_px, dtype=np.float32))
    grid = picture_grid(size, _FIT_SHAPE)
    kept = [cv2.pointPolygonTest(hull, (float(u), float(v)), measureDist=False) >= 0.0 for u, v in grid]
    return grid[kept] if sum(kept) >= _LEAST_FITTED else picture_grid(size, _FIT_SHAPE, _MIDDLE_MARGIN)
