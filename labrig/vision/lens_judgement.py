"""The evidence for and against a calibrated lens, what its uncertainty leads to, and what to photograph next.

The RMS of the fit never decides: nearly identical photographs can give 0.2 px and a focal length 20 % off. Nor does the
standard deviation of the focal length: an error of it is very nearly a shift of the plane along the axis, and one of
the principal point a small rotation of the camera, and the map of the plane absorbs both. So a lens is judged by what
its covariance leaves in lengths and radii through a plane map that is made with it, over the working area, and by what
it does to the plane's distance.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.text import round_down, round_up
from labrig.vision.intrinsics import (
    PARAMETERS,
    Intrinsics,
    LensEffect,
    ViewResidual,
    undistort_by_each,
    vary_lens,
)
from labrig.vision.lens_fit import Fit, ObservedView

_FloatArray = NDArray[np.float64]

_LEAST_TILT_SPREAD_DEG = 20.0
_LEAST_COVERAGE = 0.35
_LARGEST_HOLDOUT_PX = 1.0
# The working area is the picture inside this margin.
_WORKING_MARGIN = 0.15
# Largest standard deviation of a length or a radius, and of the plane's distance, as shares. A distance is no length in
# the plane: it enters with the height of the needle over it and with refraction, which change lengths by some percent,
# so that this share of them is below the first.
_LARGEST_EFFECT, _LARGEST_DISTANCE_EFFECT = 0.002, 0.01
# Arcs by which lengths and radii are judged: radius over the picture's longer side, angle, and places on a grid.
_ARC_RADIUS, _ARC_RAD, _ARC_PLACES = 0.2, np.deg2rad(82.0), (5, 4)
# Columns and rows of the paper's points.
_PAPER_SHAPE = (16, 12)


def judge_lens(
    views: Sequence[ObservedView],
    fit: Fit,
    holdout_px: float | None,
    size: tuple[int, int],
    residuals: tuple[ViewResidual, ...],
) -> Intrinsics:
    """Return the fitted lens with its evidence, accepted or with the reasons for refusing it."""
    normals = _find_normals(views, fit)
    spread = float(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0)))
    seen = np.vstack([view.pixels for view in views])
    bare = replace(
        _make_intrinsics(fit, size, residuals),
        holdout_rms_px=float(holdout_px) if holdout_px is not None and np.isfinite(holdout_px) else None,
        coverage=float(cv2.contourArea(cv2.convexHull(seen.astype(np.float32)))) / (size[0] * size[1]),
    )
    found = replace(bare, effect=measure_effect(bare))
    reasons = (*_judge_poses(found, float(np.rad2deg(spread)), normals, seen), *_judge_numbers(found))
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


def _judge_poses(found: Intrinsics, spread_deg: float, normals: _FloatArray, seen: _FloatArray) -> list[str]:
    """Return what the board's poses lack."""
    reasons, coverage = [], found.coverage or 0.0
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


def _find_normals(views: Sequence[ObservedView], fit: Fit) -> _FloatArray:
    """Return each board's normal towards the camera (V, 3)."""
    turns = [np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64) for pose in fit.poses]
    posed = zip(turns, views, fit.poses[:, 3:], strict=True)
    away = np.array(
        [turn[:, 2] @ (turn @ view.board.mean(axis=0) + shift) > 0.0 for turn, view, shift in posed]
    )
    normals = np.array([turn[:, 2] for turn in turns])
    return np.where(away[:, None], -normals, normals)


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
    paper = picture_grid(lens.image_size, _PAPER_SHAPE, _WORKING_MARGIN)
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
        room = np.maximum((1.0 - 2.0 * _WORKING_MARGIN) * np.array(size) - np.ptp(bent, axis=0), 0.0)
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
