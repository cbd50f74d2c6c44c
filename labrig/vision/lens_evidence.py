"""The evidence for and against a calibrated lens, and what to photograph next.

The RMS of the fit never decides: nearly identical photographs can give 0.2 px and a focal length 20 % off. The decision
rests on the number of different poses, their tilts, the share of the picture that they cover, the standard deviation
of the focal lengths, the uncertainty of pixels over the working area, and the error in predicting photographs that were
left out. Of random subsets of 3, 5 and 8 of OpenCV's thirteen photographs, the limits on poses, focal length and
prediction accept 7, 61 and 97 %. The worst focal length among these is 0.5, 0.75 and 0.4 % off; without the limits it
is 2.8, 1.35 and 0.4 % off.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.bundle import FREE, PARAMETERS, Fit, ObservedView
from labrig.vision.intrinsics import Intrinsics, ViewResidual
from labrig.vision.projection import picture_grid, projection_map_px, projection_sigma_px
from labrig.vision.rounding import round_down, round_up

_FloatArray = NDArray[np.float64]

LEAST_DIFFERENT_VIEWS = 3
# Limits of an accepted calibration.
_LEAST_TILT_SPREAD_RAD = np.deg2rad(20.0)
_LEAST_COVERAGE = 0.35
_LARGEST_SIGMA_SHARE = 0.002
_LARGEST_HOLDOUT_PX = 1.0
# The working area is the picture inside this margin; a pixel there may be as uncertain as this.
WORKING_MARGIN = 0.15
_WORKING_SHAPE = (9, 7)
LARGEST_PROJECTION_SIGMA_PX = 1.0
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
    bare = replace(
        _make_intrinsics(fit, size, residuals),
        holdout_rms_px=_finite_or_none(holdout_px),
        coverage=_measure_coverage(views, size),
        different_views=_count_different(normals, centres),
        tilt_spread_deg=float(np.rad2deg(spread)),
    )
    seen = np.vstack([view.pixels for view in views])
    found = replace(bare, projection_sigma_px=projection_map_px(bare, seen))
    reasons = (*_judge_poses(found, normals, seen), *_judge_numbers(found, seen))
    return replace(found, accepted=not reasons, reasons=reasons)


def _make_intrinsics(fit: Fit, size: tuple[int, int], residuals: tuple[ViewResidual, ...]) -> Intrinsics:
    fx, fy, cx, cy, k1, k2, p1, p2, k3, skew = map(float, fit.parameters)
    return Intrinsics(
        image_size=size,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=(k1, k2, p1, p2, k3),
        sigma=_list_sigmas(fit),
        rms_px=fit.rms_px,
        holdout_rms_px=None,
        views=residuals,
        accepted=False,
        reasons=(),
        skew=skew,
        covariance=None
        if fit.covariance is None
        else tuple(tuple(map(float, row)) for row in fit.covariance),
    )


def _list_sigmas(fit: Fit) -> dict[str, float | None]:
    """Return the standard deviation of each parameter of the model."""
    names = [PARAMETERS[index] for index in FREE[fit.model]]
    if fit.covariance is None:
        return dict.fromkeys(names)
    return {
        name: float(np.sqrt(fit.covariance[index, index]))
        for name, index in zip(names, FREE[fit.model], strict=True)
    }


def _finite_or_none(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def _judge_poses(found: Intrinsics, normals: _FloatArray, seen: _FloatArray) -> list[str]:
    """Return what the board's poses lack."""
    reasons = []
    if (found.different_views or 0) < LEAST_DIFFERENT_VIEWS:
        reasons.append(
            f"the board was held in {_count(found.different_views or 0, 'pose')} that can be told apart, at least "
            f"{LEAST_DIFFERENT_VIEWS} are needed: turn it, tilt it and move it between the photographs"
        )
    spread_deg, least_deg = found.tilt_spread_deg or 0.0, float(np.rad2deg(_LEAST_TILT_SPREAD_RAD))
    if spread_deg < least_deg:
        reasons.append(
            f"the board's tilts differ by {round_down(spread_deg, 1)} degrees at most, {least_deg:.0f} are needed: "
            f"tilt it by 30 to 45 degrees, {_describe_missing_tilt(normals)}"
        )
    coverage = found.coverage or 0.0
    if coverage < _LEAST_COVERAGE:
        reasons.append(
            f"the boards cover {round_down(100.0 * coverage, 1)} % of the picture, "
            f"{100.0 * _LEAST_COVERAGE:.0f} % are needed: photograph the board near the picture's corners, first "
            f"the {_find_emptiest_corner(seen, found.image_size)} one, or closer"
        )
    return reasons


def _count(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"


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
    width, height = size
    corners = {
        "upper left": (0.0, 0.0),
        "upper right": (width - 1.0, 0.0),
        "lower left": (0.0, height - 1.0),
        "lower right": (width - 1.0, height - 1.0),
    }
    return max(corners, key=lambda name: float(np.linalg.norm(seen - corners[name], axis=1).min()))


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


def _measure_coverage(views: Sequence[ObservedView], size: tuple[int, int]) -> float:
    """Return the share of the picture inside the convex hull of all corners."""
    corners = np.vstack([view.pixels for view in views]).astype(np.float32)
    return float(cv2.contourArea(cv2.convexHull(corners))) / (size[0] * size[1])


def _judge_focal_lengths(found: Intrinsics) -> list[str]:
    """Return which focal length is too uncertain."""
    focal = {"fx": found.fx, "fy": found.fy}
    limits = {name: _LARGEST_SIGMA_SHARE * value for name, value in focal.items()}
    sigmas = {name: found.sigma[name] for name in focal}
    named = [
        f"{name} is unknown" if sigma is None else f"{name} is {round_up(sigma, 2)} px"
        for name, sigma in sigmas.items()
        if sigma is None or sigma > limits[name]
    ]
    if not named:
        return []
    reason = (
        f"the standard deviation of {', that of '.join(named)}, the limit is {round_down(min(limits.values()), 2)} px "
        f"({100.0 * _LARGEST_SIGMA_SHARE:g} %): photograph the board closer, so that it fills the picture, "
        "and tilted by 45 degrees"
    )
    return [reason]


def _judge_numbers(found: Intrinsics, seen: _FloatArray) -> list[str]:
    """Return which numbers of the calibration are not good enough."""
    reasons = _judge_focal_lengths(found)
    holdout = found.holdout_rms_px
    if holdout is None or holdout > _LARGEST_HOLDOUT_PX:
        known = "cannot be checked" if holdout is None else f"are predicted to {round_up(holdout, 2)} px"
        reasons.append(
            f"views left out of the fit {known}, the limit is {_LARGEST_HOLDOUT_PX:.2f} px: "
            "add sharp views, and check that the board is flat"
        )
    if not _is_invertible(found):
        reasons.append(
            "the lens model folds inside the picture: photograph the board near the picture's edges"
        )
    else:
        reasons += _judge_projection(found, seen)
    return reasons


def _judge_projection(found: Intrinsics, seen: _FloatArray) -> list[str]:
    """Return where in the working area the lens is too uncertain."""
    places = picture_grid(found.image_size, _WORKING_SHAPE, WORKING_MARGIN)
    try:
        sigma = projection_sigma_px(found, places, seen)
    except MeasurementRefusedError as refusal:
        return [f"{refusal.message}: {refusal.hint}"]
    worst = int(np.argmax(sigma))
    if sigma[worst] <= LARGEST_PROJECTION_SIGMA_PX:
        return []
    u, v = places[worst]
    reason = (
        f"the lens is uncertain by {round_up(sigma[worst], 2)} px at ({u:.0f}, {v:.0f}), the limit is "
        f"{LARGEST_PROJECTION_SIGMA_PX:.2f} px: photograph the board there, so close that it fills that part"
    )
    return [reason]


def _is_invertible(found: Intrinsics) -> bool:
    width, height = found.image_size
    along, down = np.linspace(-0.5, width - 0.5, 33), np.linspace(-0.5, height - 0.5, 25)
    try:
        found.undistort_px(np.column_stack([axis.ravel() for axis in np.meshgrid(along, down)]))
    except MeasurementRefusedError:
        return False
    return True
