"""The plane map from one picture of graph paper.

The fit (`plane_fit`) uses all crossings (some thousands), so the map is far better than a single crossing: on drawn
pictures at 15 px/mm crossings scatter by 0.007 mm, and the map is right to 0.001 mm. Only crossings that are off by a
quarter of the line spacing or more are left out. Any other error, from the lens or from paper that is not flat, shows
in the residuals (over the picture: `residual_field_mm`), and these decide whether the map is accepted.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError
from labrig.vision.bend_variations import find_bent_homographies, raise_paper
from labrig.vision.gel_measurement import SeenThrough, measure_gel
from labrig.vision.graph_paper import Crossings, find_crossings
from labrig.vision.intrinsics import Intrinsics, vary_lens
from labrig.vision.picture import Picture, require_size, size_of
from labrig.vision.pitch_check import judge_pitch
from labrig.vision.plane import (
    Bend,
    Insertion,
    PlaneMap,
    Variation,
    apply_homography,
    check_frame,
    find_camera_mm,
    undistort,
)
from labrig.vision.plane_fit import PlaneFit, fit_plane
from labrig.vision.refraction import Gel
from labrig.vision.rounding import round_down, round_up
from labrig.vision.sheet_bend import find_bend
from labrig.vision.steering_frame import SteeringFrame
from labrig.vision.surface import (
    anchor_origin,
    find_gel_depth_mm,
    find_surface_variations,
    fit_sunken_paper,
    judge_tilt,
    require_room,
)

_FloatArray = NDArray[np.float64]

# Limits of an accepted map. The map must be right to 0.02 mm. So many crossings average out their own errors, so this
# residual limits the errors of lens and uneven paper.
_LARGEST_RMS_MM = 0.05
_LEAST_CROSSINGS = 60
_LEAST_COVERAGE = 0.25
_LARGEST_GROSS_SHARE = 0.1
_LARGEST_TURN_RAD = float(np.deg2rad(30.0))
# A crossing further than this from its place, in pitches, is a false detection.
_GROSS = 0.25
# Parts of the picture, columns and rows, in which the paper's unevenness is measured, and its limit.
_PARTS = (6, 4)
_LEAST_IN_A_PART = 8
_LARGEST_UNEVENNESS_MM = 1.0
_LEAST_IN_A_HALF = 8
_LARGEST_PAPER_SIGMA_MM = 10.0
# Printed paper is square within half a percent.
_LARGEST_STRETCH, _LARGEST_SKEW_RAD = 0.02, float(np.deg2rad(1.0))
# Without a lens, what is no square in the middle of the picture may be tilted: by 25 degrees at the most.
_LARGEST_TILTED_STRETCH, _LARGEST_TILTED_SKEW_RAD = 0.12, float(np.deg2rad(7.0))
# A place and two others, along both families of lines.
_AROUND_MM = np.array([(0.0, 0.0), (1e-3, 0.0), (0.0, 1e-3)])
# Side of the blocks of crossings that the hold-out leaves out in turn: the errors of neighbours are correlated.
_BLOCK = 5


def calibrate_plane(
    image: Picture,
    intrinsics: Intrinsics | None,
    pitch_mm: float,
    origin_px: tuple[float, float],
    insertion: Insertion,
    *,
    gel: Gel | None = None,
    through: SeenThrough | None = None,
    paper_sigma_mm: float | None = None,
    telecentric: bool = False,
) -> PlaneMap:
    """Make the map from one picture of graph paper that lies in the steering plane.

    +z runs along the ruled lines nearest to `insertion` in the picture; the origin is exactly `origin_px`, on a
    line or not.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
        As the camera took it, not undistorted.
    intrinsics : Intrinsics or None
        Without them one radial term is fitted with the plane; the rest of the distortion shows in `rms_mm`.
    pitch_mm : float
        Distance between the nearest lines of the paper; heavier ones every 5 or 10 mm do not matter.
    origin_px : (float, float)
        The pixel of (0, 0) mm.
    insertion : "right", "left", "up" or "down"
    gel : Gel, optional
        Corrects for refraction; needs intrinsics, or a telecentric lens.
    through : SeenThrough, optional
        The paper again, through the gel: measures the gel's depth or index, and its tilt.
    paper_sigma_mm : float, optional
        Standard deviation of the paper's height over the needle's plane; needs intrinsics.
    telecentric : bool
        The lens is telecentric: the map is affine, with one radial term, and intrinsics have no meaning.

    Returns
    -------
    PlaneMap
        `accepted` is False, with reasons, if measurements should not rely on it.

    Raises
    ------
    InputError
        If the pitch, the origin or the direction is impossible, intrinsics are given for a telecentric lens, or (as
        PictureError) the picture has another size than the intrinsics.
    CalibrationRefusedError
        If no grid is found, no plane explains it, or the gel would reach the camera.
    """
    size = size_of(image)
    origin, direction = check_frame(origin_px, insertion)
    _check_inputs(pitch_mm, origin, size)
    _check_lens(intrinsics, telecentric, paper_sigma_mm)
    if intrinsics is not None:
        require_size(image, intrinsics.image_size, "the lens's calibration")
    sheet, ideal_origin = _find_sheet(image, intrinsics, pitch_mm, origin, telecentric)
    fit = sheet.fit()
    frame = SteeringFrame(undistort(fit.radial, ideal_origin), direction, fit.homography)
    bare = PlaneMap(
        homography=frame.transform(fit.homography),
        intrinsics=intrinsics,
        origin_px=origin,
        insertion=direction,
        image_size=size,
        mm_per_px=0.0,
        radial=fit.radial,
        telecentric=telecentric,
        paper_sigma_mm=paper_sigma_mm,
    )
    if gel is not None:
        require_room(bare, gel)
    sunken = None
    if gel is not None and gel.paper == "gel":
        sunken = fit_sunken_paper(replace(bare, gel=gel), frame, fit, sheet.paper_mm, sheet.fit_to)
        sheet, fit = replace(sheet, paper_mm=sunken.straight_mm), sunken.fit
    fitted = _add_evidence(bare, sheet, fit, frame)
    if gel is not None and through is not None:
        gel, measured = measure_gel(fitted, gel, through, pitch_mm)
        fitted = replace(fitted, gel_measurement=measured)
    # The gel is measured over the paper, wherever the needle will be, so this comes after it.
    fitted = replace(fitted, variations=(*fitted.variations, *_vary_height(fitted)))
    placed = _add_gel(fitted, gel)
    by_surface = find_surface_variations(placed, sunken, sheet.ideal)
    judged = _judge(
        replace(placed, variations=(*placed.variations, *by_surface)), sheet.found, fit, frame.turn_rad
    )
    reasons = (*judge_pitch(sheet.found, pitch_mm), *judged.reasons)
    return replace(judged, accepted=not reasons, reasons=reasons)


@dataclass(frozen=True, eq=False)
class _Sheet:
    """The crossings in the picture, their ideal pixels (N, 2), and the places (N, 2) to which they are fitted."""

    found: Crossings
    ideal: _FloatArray
    paper_mm: _FloatArray
    gross_mm: float
    lens: Intrinsics | None
    telecentric: bool

    def fit(self, part: NDArray[np.bool_] | slice = slice(None)) -> PlaneFit:
        """Fit the crossings, or a part of them."""
        return fit_plane(
            self.ideal[part],
            self.paper_mm[part],
            self.gross_mm,
            with_radial=self.lens is None,
            affine=self.telecentric,
        )

    def fit_to(self, places_mm: _FloatArray) -> PlaneFit:
        """Fit the crossings to other places (N, 2)."""
        return replace(self, paper_mm=places_mm).fit()


def _add_evidence(bare: PlaneMap, sheet: _Sheet, fit: PlaneFit, frame: SteeringFrame) -> PlaneMap:
    """Return the map with its homography, its uncertainty, and what the crossings say about the paper."""
    odd = _select_odd_blocks(sheet.found)
    fitted = replace(
        bare,
        homography=frame.transform(fit.homography),
        holdout_rms_mm=_measure_holdout_rms(sheet, odd, fit),
        crossing_noise_mm=_measure_crossing_noise(sheet.found, fit),
        variations=_find_variations(sheet, fit, frame),
    )
    bend = _find_bend(fitted, sheet, odd, fit)
    if bend is not None and sheet.lens is not None:
        depth_mm = find_gel_depth_mm(
            fitted, frame, fit, sheet.paper_mm, sheet.ideal, rms_mm=bend.holdout_rms_mm
        )
        bend = replace(bend, gel_depth_mm=depth_mm)
    return replace(fitted, mm_per_px=fitted.mm_per_px_at(fitted.origin_px), bend=bend)


def _add_gel(plane: PlaneMap, gel: Gel | None) -> PlaneMap:
    """Return the map behind a gel, with its origin still at the origin's pixel."""
    if gel is None:
        return plane
    final = anchor_origin(replace(plane, gel=gel))
    return replace(final, mm_per_px=final.mm_per_px_at(final.origin_px))


def _check_lens(intrinsics: Intrinsics | None, telecentric: bool, paper_sigma_mm: float | None) -> None:
    if telecentric and intrinsics is not None:
        raise InputError(
            "intrinsics describe a lens with perspective, not a telecentric one",
            "give the intrinsics, or say that the lens is telecentric",
        )
    if paper_sigma_mm is not None and intrinsics is None:
        raise InputError(
            "what the paper's height changes needs the camera's intrinsics",
            "a telecentric lens sees no height" if telecentric else "calibrate them first: --intrinsics FILE",
        )
    if paper_sigma_mm is not None and not 0.0 <= paper_sigma_mm <= _LARGEST_PAPER_SIGMA_MM:
        raise InputError(
            f"the standard deviation of the paper's height is {paper_sigma_mm:g} mm, and must be from 0 to "
            f"{_LARGEST_PAPER_SIGMA_MM:g}",
            "measure how far the paper lies above or below the needle",
        )


def _check_inputs(pitch_mm: float, origin: tuple[float, float], size: tuple[int, int]) -> None:
    if not (np.isfinite(pitch_mm) and pitch_mm > 0.0):
        raise InputError(f"pitch is {pitch_mm} mm, not a positive number", "measure ten lines with a ruler")
    if not (0.0 <= origin[0] <= size[0] - 1 and 0.0 <= origin[1] <= size[1] - 1):
        raise InputError(
            f"origin ({origin[0]:g}, {origin[1]:g}) px is outside the picture of {size[0]} x {size[1]}",
            "give a pixel of the picture",
        )


def _find_sheet(
    image: Picture,
    intrinsics: Intrinsics | None,
    pitch_mm: float,
    origin: tuple[float, float],
    telecentric: bool,
) -> tuple[_Sheet, _FloatArray]:
    """Return the paper's crossings, and the ideal pixel of the origin (1, 2)."""
    try:
        found = find_crossings(image)
        ideal, ideal_origin = undistort(intrinsics, found.pixels), undistort(intrinsics, np.array([origin]))
    except MeasurementRefusedError as refusal:
        raise CalibrationRefusedError(refusal.message, refusal.hint) from refusal
    paper = np.asarray(found.indices * float(pitch_mm), dtype=np.float64)
    gross_mm = _GROSS * found.step * pitch_mm
    return _Sheet(found, ideal, paper, gross_mm, intrinsics, telecentric), ideal_origin


def _select_odd_blocks(found: Crossings) -> NDArray[np.bool_]:
    """Return whether each crossing (N,) is in an odd block of a chessboard pattern."""
    return np.asarray((found.indices // (_BLOCK * found.step)).sum(axis=1) % 2 == 1)


def _measure_crossing_noise(found: Crossings, fit: PlaneFit) -> float | None:
    """Return the rms noise of single crossings [mm]; neighbours differ by sqrt(2) times as much."""
    cells = (found.indices - found.indices.min(axis=0)) // found.step
    off = np.full((*(cells.max(axis=0) + 1), 2), np.nan)
    off[tuple(cells[fit.kept].T)] = fit.residuals_mm[fit.kept]
    steps = np.concatenate([np.sum(np.diff(off, axis=axis) ** 2, axis=2).ravel() for axis in (0, 1)])
    steps = steps[np.isfinite(steps)]
    return float(np.sqrt(0.5 * np.mean(steps))) if len(steps) else None


def _find_bend(bare: PlaneMap, sheet: _Sheet, odd: NDArray[np.bool_], fit: PlaneFit) -> Bend | None:
    """Return the sheet's bend, with its height if the lens is known; a telecentric lens does not see heights."""
    if bare.crossing_noise_mm is None or bare.telecentric:
        return None
    camera = None if sheet.lens is None else find_camera_mm(fit.homography, sheet.lens)
    return find_bend(
        fit, sheet.ideal, sheet.found.pixels, odd, noise_mm=bare.crossing_noise_mm, camera_mm=camera
    )


def _measure_holdout_rms(sheet: _Sheet, odd: NDArray[np.bool_], fit: PlaneFit) -> float | None:
    """Return the rms error [mm] of each half of the paper, in alternate blocks, through the map of the other half."""
    if min((odd & fit.kept).sum(), (~odd & fit.kept).sum()) < _LEAST_IN_A_HALF:
        return None
    errors = []
    for half, other in ((odd & fit.kept, ~odd & fit.kept), (~odd & fit.kept, odd & fit.kept)):
        errors.append(sheet.fit(other).paper_mm(sheet.ideal[half]) - sheet.paper_mm[half])
    return float(np.sqrt(np.mean(np.sum(np.vstack(errors) ** 2, axis=1))))


def _find_variations(sheet: _Sheet, fit: PlaneFit, frame: SteeringFrame) -> tuple[Variation, ...]:
    """Return the variations of the map: by the crossings' noise, by the lens, and by the bend of the paper."""
    found, lens = sheet.found, sheet.lens
    blocks = np.unique(found.indices[fit.kept] // (_BLOCK * found.step), axis=0, return_inverse=True)[
        1
    ].ravel()
    pixels, places = found.pixels[fit.kept], sheet.paper_mm[fit.kept]
    by_lens = []
    for moved in [] if lens is None else vary_lens(lens):
        homography = np.asarray(cv2.findHomography(moved.undistort_px(pixels), places)[0], dtype=np.float64)
        by_lens.append(Variation(frame.transform(homography), moved.parameters(), "lens"))
    bent = []
    if not sheet.telecentric:
        ideal = fit.paper_px(undistort(lens, pixels))
        bent = find_bent_homographies(ideal, places, _find_foot_mm(fit.homography, lens, ideal))
    by_noise, by_bend = (
        [Variation(frame.transform(homography), None, "plane") for homography in homographies]
        for homographies in (fit.vary_homography(blocks), bent)
    )
    return (*by_noise, *by_lens, *by_bend)


def _vary_height(plane: PlaneMap) -> tuple[Variation, ...]:
    """Return the map with the paper above the needle's plane by a standard deviation; the origin keeps its pixel."""
    if not plane.paper_sigma_mm:
        return ()
    share = plane.paper_sigma_mm / float(plane.camera_mm()[2])
    return (Variation(raise_paper(plane.homography, share, np.zeros(2)), None, "plane"),)


def _find_foot_mm(homography: _FloatArray, lens: Intrinsics | None, ideal: _FloatArray) -> _FloatArray:
    """Return the point of the paper (2,) [mm] under the camera; without a lens, the middle of the crossings."""
    if lens is None:
        return np.asarray(apply_homography(homography, ideal.mean(axis=0)[None])[0])
    return find_camera_mm(homography, lens)[:2]


def _judge(bare: PlaneMap, found: Crossings, fit: PlaneFit, turn_rad: float) -> PlaneMap:
    size = bare.image_size or (1, 1)
    pixels, off = found.pixels[fit.kept], fit.residuals_mm[fit.kept]
    residuals = np.hypot(*off.T)
    rms = float(np.sqrt(np.mean(residuals**2)))
    flatness, where = _measure_flatness(pixels, off, size)
    reasons = (
        *_judge_paper(pixels, float(np.mean(~fit.kept)), size),
        *_judge_flatness(flatness, where),
        *_judge_fit(rms, turn_rad, bare, fit),
        *judge_tilt(bare),
    )
    return replace(
        bare,
        flatness_mm=flatness,
        rms_mm=rms,
        worst_mm=float(residuals.max()),
        residual_field_mm=_map_residuals(pixels, residuals, size),
        crossings=len(pixels),
        reasons=reasons,
    )


def _judge_paper(pixels: _FloatArray, gross: float, size: tuple[int, int]) -> list[str]:
    """Return what the paper in the picture lacks."""
    reasons = []
    if len(pixels) < _LEAST_CROSSINGS:
        reasons.append(
            f"{len(pixels)} crossings of ruled lines, {_LEAST_CROSSINGS} are needed: show more of the paper"
        )
    coverage = float(cv2.contourArea(cv2.convexHull(pixels.astype(np.float32)))) / (size[0] * size[1])
    if coverage < _LEAST_COVERAGE:
        reasons.append(
            f"the paper's lines cover {round_down(100.0 * coverage, 1)} % of the picture, "
            f"{100.0 * _LEAST_COVERAGE:.0f} % are needed: use a larger sheet, evenly lit"
        )
    if gross > _LARGEST_GROSS_SHARE:
        reasons.append(
            f"the paper is not flat: {round_up(100.0 * gross, 1)} % of the crossings fit no plane, "
            f"the limit is {100.0 * _LARGEST_GROSS_SHARE:.0f} %: "
            "lay the paper flat, and take what is not paper out of the picture"
        )
    return reasons


def _measure_flatness(
    pixels: _FloatArray, off_mm: _FloatArray, size: tuple[int, int]
) -> tuple[float, tuple[float, float]]:
    """Return the largest median residual [mm] of a part of the picture, and the middle of that part [px]."""
    columns, rows = np.clip((np.array(_PARTS) * (pixels + 0.5) / size).astype(int), 0, np.array(_PARTS) - 1).T
    part = rows * _PARTS[0] + columns
    worst, where = 0.0, (0.0, 0.0)
    for number in np.unique(part):
        inside = part == number
        mean = float(np.hypot(*np.median(off_mm[inside], axis=0)))
        if inside.sum() >= _LEAST_IN_A_PART and mean > worst:
            u, v = pixels[inside].mean(axis=0)
            worst, where = mean, (float(u), float(v))
    return worst, where


def _judge_flatness(flatness_mm: float, where: tuple[float, float]) -> list[str]:
    """Return where the paper is bent or folded."""
    if flatness_mm <= _LARGEST_UNEVENNESS_MM:
        return []
    reason = (
        f"the paper is not flat: around ({where[0]:.0f}, {where[1]:.0f}) px it is {round_up(flatness_mm, 2)} mm from "
        f"where flat paper would be, the limit is {_LARGEST_UNEVENNESS_MM} mm: glue it to a plate, without folds"
    )
    return [reason]


def _judge_fit(rms_mm: float, turn_rad: float, bare: PlaneMap, fit: PlaneFit) -> list[str]:
    """Return the faults of the fit, or of the lens that it relies on."""
    reasons = []
    if bare.intrinsics is not None and not bare.intrinsics.accepted:
        reasons.append("the lens's calibration was itself refused: calibrate the lens again first")
    # Where lines are close in the picture, single crossings are uncertain; that averages out, and is no fault.
    off_mm = float(np.sqrt(max(rms_mm**2 - (bare.crossing_noise_mm or 0.0) ** 2, 0.0)))
    if off_mm > _LARGEST_RMS_MM:
        if bare.telecentric:
            remedy = "lay the paper flat; if lines run together in the picture, the lens is not telecentric"
        elif bare.bend is not None and bare.bend.gel_depth_mm is not None:
            remedy = "lay the paper flat, or say that it lies in the gel"
        elif bare.intrinsics:
            remedy = "lay the paper flat"
        else:
            remedy = "give the lens's calibration, or lay the paper flat"
        reasons.append(
            f"the crossings are {round_up(off_mm, 3)} mm off a plane, the limit is {_LARGEST_RMS_MM} mm: {remedy}"
        )
    stretch, skew_rad = _measure_squareness(fit, bare)
    known = bare.telecentric or bare.intrinsics is not None
    most_stretch = _LARGEST_STRETCH if known else _LARGEST_TILTED_STRETCH
    most_skew_rad = _LARGEST_SKEW_RAD if known else _LARGEST_TILTED_SKEW_RAD
    if stretch > most_stretch or skew_rad > most_skew_rad:
        remedy = (
            "turn the telecentric lens to face the paper"
            if bare.telecentric
            else "show graph paper, and give the calibration of this camera's lens"
        )
        through = " through the lens" if known else ""
        reasons.append(
            f"the lines are no square grid{through}: {round_up(100.0 * stretch, 1)} % longer one way, "
            f"{round_up(np.rad2deg(skew_rad), 1)} degrees off a right angle: {remedy}"
        )
    if turn_rad > _LARGEST_TURN_RAD:
        reasons.append(
            f"the lines are turned by {round_up(np.rad2deg(turn_rad), 1)} degrees from {bare.insertion!r}, "
            f"the limit is {np.rad2deg(_LARGEST_TURN_RAD):.0f}: lay the paper along the insertion"
        )
    return reasons


def _measure_squareness(fit: PlaneFit, bare: PlaneMap) -> tuple[float, float]:
    """Return how much longer the grid is one way, as a share, and its angle off a right one.

    A calibrated lens has no freedom for either: they would be the tilt of the sheet. Through a telecentric lens a tilt
    shortens the grid one way. Without a lens both are those in the middle of the picture.
    """
    if bare.telecentric:
        across, along = np.linalg.inv(fit.homography)[:2, :2].T
    elif bare.intrinsics is not None:
        across, along = np.linalg.solve(bare.intrinsics.camera_matrix(), np.linalg.inv(fit.homography))[
            :, :2
        ].T
    else:
        middle_mm = fit.paper_mm(0.5 * np.array([bare.image_size or (1, 1)], dtype=np.float64))
        around = apply_homography(np.linalg.inv(fit.homography), middle_mm + _AROUND_MM)
        across, along = around[1:] - around[0]
    lengths = float(np.linalg.norm(across)), float(np.linalg.norm(along))
    cosine = float(across @ along) / (lengths[0] * lengths[1])
    return max(lengths) / min(lengths) - 1.0, abs(float(np.arcsin(np.clip(cosine, -1.0, 1.0))))


def _map_residuals(
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
