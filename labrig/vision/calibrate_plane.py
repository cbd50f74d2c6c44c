"""The plane map from one picture of graph paper whose scale is roughly known.

The fit (`plane_fit`) uses hundreds or thousands of points of the paper's lines, so the map is far better than a single
point. Only points that are off by a quarter of the pitch or more are left out. Any other error, from the lens or from
paper that is not flat, shows in the residuals, and these decide whether the map is accepted.
"""

from dataclasses import dataclass
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError
from labrig.text import round_down, round_up
from labrig.vision.gel import Gel
from labrig.vision.intrinsics import Intrinsics, vary_lens
from labrig.vision.paper import PaperPoints, find_paper
from labrig.vision.picture import Picture, require_size, size_of
from labrig.vision.plane import (
    PICTURE_AXES,
    Insertion,
    PlaneMap,
    Variation,
    apply_homography,
    check_frame,
    find_camera_mm,
    undistort,
)
from labrig.vision.plane_fit import PlaneFit, find_bent_homographies, fit_homography, fit_plane, raise_paper

FloatArray = NDArray[np.float64]

# Limits of an accepted map. The map must be right to 0.02 mm. So many points average out their own errors, so this
# residual limits the errors of lens and uneven paper.
_LARGEST_RMS_MM = 0.05
_LEAST_POINTS = 24
_LEAST_COVERAGE = 0.25
_LARGEST_GROSS_SHARE = 0.1
_LARGEST_TURN_RAD = float(np.deg2rad(30.0))
# A point further than this from its place, in pitches, is a false detection; where lines are close, in so many pixels.
_GROSS, _GROSS_PX = 0.25, 14.0
# Parts of the picture, columns and rows, in which the paper's unevenness is measured, and its limit.
_PARTS = (6, 4)
_LEAST_IN_A_PART = 4
_LARGEST_UNEVENNESS_MM = 1.0
_LEAST_IN_A_HALF = 8
_LARGEST_PAPER_SIGMA_MM = 10.0
# Printed paper is square within half a percent.
_LARGEST_STRETCH, _LARGEST_SKEW_RAD = 0.02, float(np.deg2rad(1.0))
# Without a lens, what is no square in the middle of the picture may be tilted: by 25 degrees at the most.
_LARGEST_TILTED_STRETCH, _LARGEST_TILTED_SKEW_RAD = 0.12, float(np.deg2rad(7.0))
# A place and two others, along both families of lines.
_AROUND_MM = np.array([(0.0, 0.0), (1e-3, 0.0), (0.0, 1e-3)])
# Side of the blocks of windows that the hold-out leaves out in turn: the errors of neighbours are correlated. On a
# sheet of fewer windows the blocks are smaller.
_BLOCK, _SMALL_BLOCK, _MANY = 4, 2, 16
# Neighbouring windows overlap: their noise is correlated by a sixth.
_OVERLAP = 1.0 / 6.0
# The end of the origin's ray moves with the frame; each shift leaves a thousandth of the error.
_MAX_SHIFTS = 6


def calibrate_plane(
    image: Picture,
    intrinsics: Intrinsics | None,
    pitch_mm: float,
    origin_px: tuple[float, float],
    insertion: Insertion,
    *,
    px_per_mm: float,
    gel: Gel | None = None,
    paper_sigma_mm: float | None = None,
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
    px_per_mm : float
        The scale of the picture, to a fifth: a lens's focal length over the distance of the paper, for instance.
    gel : Gel, optional
        Corrects for refraction; needs intrinsics.
    paper_sigma_mm : float, optional
        Standard deviation of the paper's height over the needle's plane; needs intrinsics.

    Returns
    -------
    PlaneMap
        `accepted` is False, with reasons, if measurements should not rely on it.

    Raises
    ------
    InputError
        If the pitch, the scale, the origin or the direction is impossible, a gel or a height is stated without
        intrinsics, or (as PictureError) the picture has another size than the intrinsics.
    CalibrationRefusedError
        If the lines are not found at that scale, no plane explains them, or the gel would reach the camera.
    """
    size = size_of(image)
    origin, direction = check_frame(origin_px, insertion)
    _check_inputs(pitch_mm, px_per_mm, origin, size)
    if intrinsics is None and (gel is not None or paper_sigma_mm is not None):
        raise InputError(
            "a gel's refraction and the paper's height need the camera's intrinsics",
            "calibrate them first: --intrinsics FILE",
        )
    if intrinsics is not None:
        require_size(image, intrinsics.image_size, "the lens's calibration")
    try:
        found = find_paper(image, pitch_mm * px_per_mm)
        ideal, ideal_origin = undistort(intrinsics, found.pixels), undistort(intrinsics, np.array([origin]))
    except MeasurementRefusedError as refusal:
        raise CalibrationRefusedError(refusal.message, refusal.hint) from refusal
    gross_mm = _GROSS * pitch_mm * max(1.0, _GROSS_PX / found.spacing_px)
    middle = 0.5 * (size[0] - 1), 0.5 * (size[1] - 1)
    sheet = _Sheet(found, ideal, found.lines * float(pitch_mm), gross_mm, intrinsics, middle)
    fit = sheet.fit()
    frame = _SteeringFrame(undistort(fit.radial, ideal_origin), direction, fit.homography)
    flat = PlaneMap(
        homography=frame.transform(fit.homography),
        intrinsics=intrinsics,
        origin_px=origin,
        insertion=direction,
        image_size=size,
        mm_per_px=1.0,
        radial=fit.radial,
        paper_sigma_mm=paper_sigma_mm,
        variations=_find_variations(sheet, fit, frame),
    )
    flat = flat.change(variations=(*flat.variations, *_vary_height(flat)))
    return _judge(_add_gel(flat, gel), sheet, fit, frame.turn_rad)


def find_px_per_mm(lens: Intrinsics, distance_mm: float) -> float:
    """Return the scale at a distance from the camera, roughly.

    Raises
    ------
    InputError
        If the distance is not positive.
    """
    if not distance_mm > 0.0:
        raise InputError(
            f"the camera's distance is {distance_mm} mm, not a positive number", "measure it with a tape"
        )
    return float(np.sqrt(lens.fx * lens.fy)) / distance_mm


@dataclass(frozen=True, eq=False)
class _Sheet:
    """The points of the paper, their ideal pixels (N, 2), and the places (N, 2) to which they are fitted.

    `middle_px` is the picture's middle, about which the radial term of an unknown lens is fitted.
    """

    found: PaperPoints
    ideal: FloatArray
    paper_mm: FloatArray
    gross_mm: float
    lens: Intrinsics | None
    middle_px: tuple[float, float]

    def fit(self, part: NDArray[np.bool_] | slice = slice(None)) -> PlaneFit:
        """Fit the points, or a part of them."""
        about = None if self.lens is not None else self.middle_px
        return fit_plane(self.ideal[part], self.paper_mm[part], self.gross_mm, about)

    def number_blocks(self) -> NDArray[np.int64]:
        """Return the column and row (N, 2) of each point's block of neighbours."""
        many = int(np.ptp(self.found.cells, axis=0).min()) >= _MANY
        return np.asarray(self.found.cells // (_BLOCK if many else _SMALL_BLOCK))


class _SteeringFrame:
    """The steering plane frame: `origin` (1, 2) in ideal pixels, +z along the lines nearest to the insertion.

    The fitted homography decides once which lines these are; its variations share that frame.
    """

    def __init__(self, origin: FloatArray, insertion: Insertion, homography: FloatArray) -> None:
        self._origin = origin
        place = apply_homography(homography, origin)[0]
        ahead = apply_homography(np.linalg.inv(homography), place + 1e-3 * np.eye(2)) - origin
        lines = ahead / np.linalg.norm(ahead, axis=1)[:, None]
        # Cosines in the picture between +y, +z (rows) and the paper's two axes (columns).
        along = np.array(PICTURE_AXES[insertion], dtype=np.float64) @ lines.T
        z_line = int(np.argmax(np.abs(along[1])))
        self.turn = np.zeros((2, 2))
        for row, line in ((0, 1 - z_line), (1, z_line)):
            self.turn[row, line] = np.sign(along[row, line])
        self.turn_rad = float(np.arccos(np.clip(np.abs(along[1, z_line]), 0.0, 1.0)))

    def transform(self, homography: FloatArray) -> FloatArray:
        """Return the homography from ideal pixels to the frame."""
        change = np.eye(3)
        change[:2, :2] = self.turn
        change[:2, 2] = -self.turn @ apply_homography(homography, self._origin)[0]
        return np.asarray(change @ homography)


def _check_inputs(
    pitch_mm: float, px_per_mm: float, origin: tuple[float, float], size: tuple[int, int]
) -> None:
    for name, value, unit in (("pitch", pitch_mm, "mm"), ("scale", px_per_mm, "px/mm")):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(
                f"{name} is {value} {unit}, not a positive number", "measure ten lines with a ruler"
            )
    if not (0.0 <= origin[0] <= size[0] - 1 and 0.0 <= origin[1] <= size[1] - 1):
        raise InputError(
            f"origin ({origin[0]:g}, {origin[1]:g}) px is outside the picture of {size[0]} x {size[1]}",
            "give a pixel of the picture",
        )


def _find_variations(sheet: _Sheet, fit: PlaneFit, frame: _SteeringFrame) -> tuple[Variation, ...]:
    """Return the variations of the map: by the points' noise, by the lens, and by the bend of the paper."""
    lens, kept = sheet.lens, fit.kept
    blocks = np.unique(sheet.number_blocks()[kept], axis=0, return_inverse=True)[1].ravel()
    pixels, places = sheet.found.pixels[kept], sheet.paper_mm[kept]
    by_lens = []
    for moved in [] if lens is None else vary_lens(lens):
        homography = fit_homography(moved.undistort_px(pixels), places)
        by_lens.append(_vary(frame, homography, moved.parameters()))
    ideal = fit.paper_px(undistort(lens, pixels))
    # Without a lens, the foot of the camera is taken to be the middle of the paper.
    foot = (
        apply_homography(fit.homography, ideal.mean(axis=0)[None])[0]
        if lens is None
        else find_camera_mm(fit.homography, lens)[:2]
    )
    by_paper = (*fit.vary_homography(blocks), *find_bent_homographies(ideal, places, foot))
    return (*(_vary(frame, homography) for homography in by_paper), *by_lens)


def _vary(frame: _SteeringFrame, homography: FloatArray, lens: tuple[float, ...] | None = None) -> Variation:
    """Return a variation of the plane, or of the lens if one is given."""
    moved: Any = frame.transform(homography)
    return Variation(homography=moved, group="plane" if lens is None else "lens", lens=lens)


def _vary_height(plane: PlaneMap) -> tuple[Variation, ...]:
    """Return the map with the paper above the needle's plane by a standard deviation; the origin keeps its pixel."""
    sigma_mm = plane.paper_sigma_mm
    if sigma_mm is not None and not 0.0 <= sigma_mm <= _LARGEST_PAPER_SIGMA_MM:
        raise InputError(
            f"the standard deviation of the paper's height is {sigma_mm:g} mm, and must be from 0 to "
            f"{_LARGEST_PAPER_SIGMA_MM:g}",
            "measure how far the paper lies above or below the needle",
        )
    if not sigma_mm:
        return ()
    raised: Any = raise_paper(plane.matrix, sigma_mm / float(plane.camera_mm()[2]), np.zeros(2))
    return (Variation(homography=raised, group="plane"),)


def _add_gel(plane: PlaneMap, gel: Gel | None) -> PlaneMap:
    """Return the map behind a gel, with its variations by the gel's standard deviations.

    Raises
    ------
    CalibrationRefusedError
        If the gel would reach the camera.
    """
    if gel is None:
        return plane.change(mm_per_px=plane.mm_per_px_at(plane.origin_px))
    height_mm = float(plane.camera_mm()[2])
    if max(other.height_mm() for other in (gel, *gel.vary())) >= height_mm:
        raise CalibrationRefusedError(
            f"the gel's depth is {gel.height_mm():.4g} mm, and the camera is only {round_down(height_mm, 0)} mm above "
            "the paper",
            "measure from the gel's surface to the needle, in mm",
        )
    placed = anchor_origin(plane.change(gel=gel))
    by_gel = [
        Variation(
            homography=anchor_origin(placed.change(gel=moved, variations=())).homography,
            group="surface",
            gel=moved,
        )
        for moved in gel.vary()
    ]
    placed = placed.change(variations=(*placed.variations, *by_gel))
    return placed.change(mm_per_px=placed.mm_per_px_at(placed.origin_px))


def anchor_origin(plane: PlaneMap) -> PlaneMap:
    """Return a map through a gel, moved in its plane until the ray of the origin's pixel ends at (0, 0)."""
    shift = np.eye(3)
    for _ in range(_MAX_SHIFTS):
        moved = plane.change(homography=shift @ plane.matrix, variations=())
        shift[:2, 2] -= moved.to_mm([plane.origin_px])[0]
    variations: list[Any] = [
        {**dict(variation), "homography": shift @ np.array(variation.homography)}
        for variation in plane.variations
    ]
    return plane.change(homography=shift @ plane.matrix, variations=tuple(variations))


def _judge(plane: PlaneMap, sheet: _Sheet, fit: PlaneFit, turn_rad: float) -> PlaneMap:
    """Return the map with its evidence and the verdict."""
    size = plane.image_size or (1, 1)
    pixels, off = sheet.found.pixels[fit.kept], fit.residuals_mm[fit.kept]
    rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    flatness, where = _measure_flatness(pixels, off, size)
    reasons = [
        *_judge_paper(pixels, sheet.found.window_px, float(np.mean(~fit.kept)), size),
        *_judge_flatness(flatness, where),
        *_judge_fit(plane, sheet, fit, rms),
        *_judge_frame(plane, fit, turn_rad),
    ]
    return plane.change(
        flatness_mm=flatness,
        rms_mm=rms,
        holdout_rms_mm=_measure_holdout_rms(sheet, fit),
        points=len(pixels),
        accepted=not reasons,
        reasons=tuple(reasons),
    )


def _measure_holdout_rms(sheet: _Sheet, fit: PlaneFit) -> float | None:
    """Return the rms error [mm] of each half of the paper, in alternate blocks, through the map of the other half."""
    odd = sheet.number_blocks().sum(axis=1) % 2 == 1
    halves = odd & fit.kept, ~odd & fit.kept
    if min(half.sum() for half in halves) < _LEAST_IN_A_HALF:
        return None
    errors = [
        sheet.fit(other).paper_mm(sheet.ideal[half]) - sheet.paper_mm[half]
        for half, other in (halves, halves[::-1])
    ]
    return float(np.sqrt(np.mean(np.sum(np.vstack(errors) ** 2, axis=1))))


def _measure_noise(found: PaperPoints, fit: PlaneFit) -> float:
    """Return the rms noise of single points [mm], by the differences of neighbours."""
    off = np.full((*(found.cells.max(axis=0) + 1), 2), np.nan)
    off[tuple(found.cells[fit.kept].T)] = fit.residuals_mm[fit.kept]
    steps = np.concatenate([np.sum(np.diff(off, axis=axis) ** 2, axis=2).ravel() for axis in (0, 1)])
    steps = steps[np.isfinite(steps)]
    return float(np.sqrt(0.5 * np.mean(steps) / (1.0 - _OVERLAP))) if len(steps) else 0.0


def _judge_paper(pixels: FloatArray, window_px: float, gross: float, size: tuple[int, int]) -> list[str]:
    """Return what the paper in the picture lacks."""
    reasons = []
    if len(pixels) < _LEAST_POINTS:
        reasons.append(
            f"{len(pixels)} points of ruled lines, {_LEAST_POINTS} are needed: show more of the paper"
        )
    seen = np.concatenate([pixels + 0.5 * window_px * np.array(way) for way in product((-1, 1), repeat=2)])
    coverage = float(cv2.contourArea(cv2.convexHull(seen.astype(np.float32)))) / (size[0] * size[1])
    if coverage < _LEAST_COVERAGE:
        reasons.append(
            f"the paper's lines cover {round_down(100.0 * coverage, 1)} % of the picture, "
            f"{100.0 * _LEAST_COVERAGE:.0f} % are needed: use a larger sheet, evenly lit"
        )
    if gross > _LARGEST_GROSS_SHARE:
        reasons.append(
            f"the paper is not flat: {round_up(100.0 * gross, 1)} % of its points fit no plane, "
            f"the limit is {100.0 * _LARGEST_GROSS_SHARE:.0f} %: "
            "lay the paper flat, and take what is not paper out of the picture"
        )
    return reasons


def _measure_flatness(
    pixels: FloatArray, off_mm: FloatArray, size: tuple[int, int]
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


def _judge_fit(plane: PlaneMap, sheet: _Sheet, fit: PlaneFit, rms_mm: float) -> list[str]:
    """Return the faults of the fit, or of the lens that it relies on."""
    reasons = []
    if plane.intrinsics is not None and not plane.intrinsics.accepted:
        reasons.append("the lens's calibration was itself refused: calibrate the lens again first")
    # Where lines are close in the picture, single points are uncertain; that averages out, and is no fault.
    off_mm = float(np.sqrt(max(rms_mm**2 - _measure_noise(sheet.found, fit) ** 2, 0.0)))
    if off_mm > _LARGEST_RMS_MM:
        remedy = (
            "lay the paper flat" if plane.intrinsics else "give the lens's calibration, or lay the paper flat"
        )
        reasons.append(
            f"the lines are {round_up(off_mm, 3)} mm off a plane, the limit is {_LARGEST_RMS_MM} mm: {remedy}"
        )
    return reasons


def _judge_frame(plane: PlaneMap, fit: PlaneFit, turn_rad: float) -> list[str]:
    """Return what is wrong with the shape of the grid, and with its direction."""
    reasons = []
    stretch, skew_rad = _measure_squareness(fit, plane)
    known = plane.intrinsics is not None
    most_stretch = _LARGEST_STRETCH if known else _LARGEST_TILTED_STRETCH
    most_skew_rad = _LARGEST_SKEW_RAD if known else _LARGEST_TILTED_SKEW_RAD
    if stretch > most_stretch or skew_rad > most_skew_rad:
        through = " through the lens" if known else ""
        reasons.append(
            f"the lines are no square grid{through}: {round_up(100.0 * stretch, 1)} % longer one way, "
            f"{round_up(np.rad2deg(skew_rad), 1)} degrees off a right angle: show graph paper, and give the "
            "calibration of this camera's lens"
        )
    if turn_rad > _LARGEST_TURN_RAD:
        reasons.append(
            f"the lines are turned by {round_up(np.rad2deg(turn_rad), 1)} degrees from {plane.insertion!r}, "
            f"the limit is {np.rad2deg(_LARGEST_TURN_RAD):.0f}: lay the paper along the insertion"
        )
    return reasons


def _measure_squareness(fit: PlaneFit, plane: PlaneMap) -> tuple[float, float]:
    """Return how much longer the grid is one way, as a share, and its angle off a right one.

    A calibrated lens has no freedom for either: they would be the tilt of the sheet. Without a lens both are those in
    the middle of the picture.
    """
    if plane.intrinsics is not None:
        across, along = np.linalg.solve(plane.intrinsics.camera_matrix(), np.linalg.inv(fit.homography))[
            :, :2
        ].T
    else:
        middle_mm = fit.paper_mm(0.5 * np.array([plane.image_size or (1, 1)], dtype=np.float64))
        around = apply_homography(np.linalg.inv(fit.homography), middle_mm + _AROUND_MM)
        across, along = around[1:] - around[0]
    lengths = float(np.linalg.norm(across)), float(np.linalg.norm(along))
    cosine = float(across @ along) / (lengths[0] * lengths[1])
    return max(lengths) / min(lengths) - 1.0, abs(float(np.arcsin(np.clip(cosine, -1.0, 1.0))))
