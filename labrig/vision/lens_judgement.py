"""The evidence for and against a calibrated lens, what its uncertainty leads to, and what to photograph next.

The RMS of the fit never decides: nearly identical photographs can give 0.2 px and a focal length 20 % off. Nor does the
standard deviation of the focal length: an error of it is very nearly a shift of the plane along the axis, and one of
the principal point a small rotation of the camera, and the map of the plane absorbs both. So a lens is judged by what
its covariance leaves in lengths and radii through a plane map that is made with it, over the working area, and by what
it does to the plane's distance.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.text import round_down, round_up
from labrig.vision.intrinsics import PARAMETERS, BoardWarp, Intrinsics, LensEffect, measure_rms, vary_lens
from labrig.vision.lens_fit import LENS, Fit, Selection

_FloatArray = NDArray[np.float64]

_LEAST_TILT_SPREAD_DEG = 20.0
LEAST_COVERAGE = 0.35
LARGEST_HOLDOUT_PX = 1.0
# Of more bad views than this share of all, the rest is no evidence.
_LARGEST_BAD_SHARE = 1.0 / 3.0
# The working area is the picture inside this margin.
_WORKING_MARGIN = 0.15
# Largest standard deviation of a length or a radius, and of the plane's distance, as shares. A distance is no length in
# the plane: it enters with the height of the needle over it and with refraction, which change lengths by some percent,
# so that this share of them is below the first.
LARGEST_EFFECT, LARGEST_DISTANCE_EFFECT = 0.002, 0.01
# Arcs by which lengths and radii are judged: radius over the picture's longer side, angle, and places on a grid.
_ARC_RADIUS, _ARC_RAD, _ARC_PLACES = 0.2, np.deg2rad(82.0), (5, 4)
# Columns and rows of the paper's points.
_PAPER_SHAPE = (16, 12)


def judge_lens(selection: Selection, size: tuple[int, int], prior_mm: float) -> Intrinsics:
    """Return the fitted lens with its evidence, accepted or with the reasons for refusing it.

    `prior_mm` is the standard deviation of the board's warp before the views are seen.
    """
    fit = selection.fit
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = map(float, fit.shared[:LENS])
    covariance = None if fit.covariance is None else fit.covariance[:LENS, :LENS]
    sigmas = [None] * LENS if covariance is None else np.sqrt(np.diag(covariance)).tolist()
    seen = np.vstack([view.pixels for view in fit.views])
    normals, away = _find_normals(fit)
    bare = Intrinsics(
        image_size=size,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=(k1, k2, p1, p2, k3),
        sigma=dict(zip(PARAMETERS, sigmas, strict=True)),
        rms_px=measure_rms(np.vstack(fit.errors_px())),
        holdout_rms_px=selection.holdout_px,
        views=selection.residuals,
        accepted=False,
        reasons=(),
        covariance=None if covariance is None else tuple(map(tuple, covariance.tolist())),
        coverage=float(cv2.contourArea(cv2.convexHull(seen.astype(np.float32)))) / (size[0] * size[1]),
        board_warp=_describe_warp(fit, prior_mm, away),
    )
    found = replace(bare, effect=measure_effect(bare))
    reasons = (*_judge_views(found, normals), *_judge_effect(found), *_judge_model(found))
    return replace(found, accepted=not reasons, reasons=reasons)


def _find_normals(fit: Fit) -> tuple[_FloatArray, bool]:
    """Return each board's normal towards the camera (V, 3), and whether z of most boards points away from it."""
    turns = [np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64) for pose in fit.poses]
    posed = zip(turns, fit.views, fit.poses[:, 3:], strict=True)
    away = np.sign([turn[:, 2] @ (turn @ view.board.mean(axis=0) + shift) for turn, view, shift in posed])
    return -away[:, None] * np.array([turn[:, 2] for turn in turns]), bool(np.median(away) > 0.0)


def _describe_warp(fit: Fit, prior_mm: float, away: bool) -> BoardWarp:
    """Return the fitted warp in mm; `away` if z of the board points away from the camera."""
    warp = fit.shared[LENS:]
    sigma = np.ones_like(warp) if fit.covariance is None else np.sqrt(np.diag(fit.covariance)[LENS:])
    row, column = np.broadcast_to((-1.0 if away else 1.0) * prior_mm * warp, 2).tolist()
    sigma_row, sigma_column = np.broadcast_to(prior_mm * sigma, 2).tolist()
    return BoardWarp(row, column, sigma_row, sigma_column, prior_mm)


def _judge_views(found: Intrinsics, normals: _FloatArray) -> list[str]:
    """Return what the views lack: agreement, tilts, and places in the picture."""
    reasons, coverage = [], found.coverage or 0.0
    bad = [view.image for view in found.views if not view.used]
    spread_deg = float(np.rad2deg(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0))))
    if len(bad) > _LARGEST_BAD_SHARE * len(found.views):
        reasons.append(
            f"{len(bad)} of {len(found.views)} views contradict the others and were left out, at most a third may be "
            f"({', '.join(bad)}): photograph the board on a stiff plate, held still and sharp, with one camera, zoom "
            "and focus fixed"
        )
    if spread_deg < _LEAST_TILT_SPREAD_DEG:
        reasons.append(
            f"the board's tilts differ by {round_down(spread_deg, 1)} degrees at most, {_LEAST_TILT_SPREAD_DEG:.0f} "
            "are needed: tilt it by 30 to 45 degrees, each edge towards the camera in turn"
        )
    if coverage < LEAST_COVERAGE:
        reasons.append(
            f"the boards cover {round_down(100.0 * coverage, 1)} % of the picture, "
            f"{100.0 * LEAST_COVERAGE:.0f} % are needed: photograph the board near the picture's corners, or closer"
        )
    return reasons


def _judge_model(found: Intrinsics) -> list[str]:
    """Return whether the lens predicts views that were left out, and has an inverse all over the picture."""
    reasons, holdout = [], found.holdout_rms_px
    if holdout is None or holdout > LARGEST_HOLDOUT_PX:
        known = "cannot be checked" if holdout is None else f"are predicted to {round_up(holdout, 2)} px"
        reasons.append(
            f"views held out of the fit {known}, the limit is {LARGEST_HOLDOUT_PX:.2f} px: "
            "add sharp views, and check that the board is flat"
        )
    try:
        found.undistort_px(_list_grid(found.image_size, (33, 25)))
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
        ("lengths in the plane", effect.length, LARGEST_EFFECT),
        ("radii", effect.radius, LARGEST_EFFECT),
        ("the distance from the camera to the plane", effect.distance, LARGEST_DISTANCE_EFFECT),
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
    paper = _list_grid(lens.image_size, _PAPER_SHAPE, _WORKING_MARGIN)
    lenses = [lens, *vary_lens(lens)]
    try:
        seen = [each.undistort_px(np.vstack((paper, arcs.reshape(-1, 2)))) for each in lenses]
    except MeasurementRefusedError:
        return None
    measured = []
    for each, ideal in zip(lenses, seen, strict=True):
        homography = cv2.findHomography(ideal[: len(paper)], seen[0][: len(paper)])[0]
        if homography is None:
            return None
        mapped = cv2.perspectiveTransform(ideal[None, len(paper) :], homography)
        lines = np.asarray(mapped, dtype=np.float64).reshape(arcs.shape)
        chords = np.linalg.norm(lines[:, -1] - lines[:, 0], axis=1)
        distance = np.sqrt(abs(np.linalg.det(homography[:2, :2])) * each.fx * each.fy)
        measured.append((chords, _fit_radii(lines), distance))
    parts = (np.array(part) for part in zip(*measured, strict=True))
    return LensEffect(
        *(float(np.sqrt(np.mean(np.sum((part[1:] / part[0] - 1.0) ** 2, axis=0)))) for part in parts)
    )


def _draw_arcs(size: tuple[int, int]) -> _FloatArray:
    """Return the pixels (A, N, 2) of arcs in the working area, bent towards all four sides."""
    turn = np.linspace(-0.5, 0.5, 21) * _ARC_RAD
    arc = _ARC_RADIUS * max(size) * np.column_stack((np.sin(turn), np.cos(turn)))
    arcs = []
    for bent in (arc, arc[:, ::-1], -arc, -arc[:, ::-1]):
        half = 0.5 * np.ptp(bent, axis=0)
        room = np.maximum((1.0 - 2.0 * _WORKING_MARGIN) * np.array(size) - 2.0 * half, 0.0)
        corner = 0.5 * (np.array(size) - 1.0 - room) - half - bent.min(axis=0)
        arcs.append(bent + (corner + _list_grid((2, 2), _ARC_PLACES) * room)[:, None])
    return np.concatenate(arcs)


def _fit_radii(arcs: _FloatArray) -> _FloatArray:
    """Return the radii (A,) of the circles through points (A, N, 2) that are very nearly on them."""
    centred = arcs - arcs.mean(axis=1, keepdims=True)
    design = np.concatenate((2.0 * centred, np.ones_like(centred[..., :1])), axis=2)
    found = (np.linalg.pinv(design) @ np.sum(centred**2, axis=2)[..., None])[..., 0]
    return np.asarray(np.sqrt(found[:, 2] + np.sum(found[:, :2] ** 2, axis=1)))


def _list_grid(size: tuple[int, int], shape: tuple[int, int], margin: float = 0.0) -> _FloatArray:
    """Return pixels (columns * rows, 2), evenly spaced from corner to corner, inside a margin (a share)."""
    axes = (np.linspace(margin, 1.0 - margin, count) for count in shape)
    return np.asarray(np.stack(np.meshgrid(*axes), axis=2).reshape(-1, 2) * (np.array(size) - 1.0))
