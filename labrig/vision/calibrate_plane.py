"""The plane map from one picture of graph paper whose scale is roughly known.

The map is a homography, and one radial term without a known lens, by least squares over hundreds or thousands of
points of the paper's lines. A point a quarter of a pitch or more off is a false detection and is left out. Any other
error, from the lens or from paper that is not flat, shows in the residuals, and these decide whether the map is
accepted. Blocks of neighbouring points are left out in turn: what the rest predicts for them is the hold-out error, and
how the map moves its covariance (a jackknife over blocks, because uneven paper displaces neighbours alike).

Paper at a height h above the needle's plane appears where that plane lies at p + (p - c) h / D, for a camera at the
distance D above the point c of the plane (plane and parallax). A bent sheet shows in the residuals, but the homography
absorbs most of the bend and is then wrong by as much. A second fit that includes the bend measures this error. If it
explains residuals, the maps with and without the bend count as one standard deviation apart. So do the heights of the
sheet, because the needle's plane may lie anywhere among them. In rendered pictures with paper bent by 0.4 mm the 95 %
intervals of the radius contained the truth in 58 of 100 without these variations, and in 40 of 40 with them.
"""

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from labrig.errors import CalibrationRefusedError, InputError, MeasurementRefusedError
from labrig.text import round_down, round_up
from labrig.vision.gel import Gel
from labrig.vision.intrinsics import Intrinsics, measure_rms, vary_lens
from labrig.vision.paper import PaperPoints, find_paper
from labrig.vision.picture import Picture, require_size, size_of
from labrig.vision.plane import (
    PICTURE_AXES,
    Insertion,
    PlaneMap,
    Radial,
    Variation,
    VariationGroup,
    apply_homography,
    check_frame,
    find_camera_mm,
    undistort,
)

FloatArray = NDArray[np.float64]

# Limits of an accepted map. The map must be right to 0.02 mm. So many points average out their own errors, so this
# distance from flat limits the errors of lens and uneven paper: rms over parts of the picture, columns and rows of
# them, in which so many points have their median. Of folded paper many points fit no plane.
LARGEST_OFF_MM, _PARTS, _LEAST_IN_A_PART = 0.05, (6, 4), 4
_LARGEST_GROSS_SHARE = 0.1
_LEAST_POINTS, _LEAST_COVERAGE = 24, 0.25
_LARGEST_TURN_RAD = float(np.deg2rad(30.0))
# Printed paper is square within half a percent.
_LARGEST_STRETCH, _LARGEST_SKEW_RAD = 0.02, float(np.deg2rad(1.0))
# A point further than this from its place, in pitches, is a false detection; where lines are close, in so many pixels.
_GROSS, _GROSS_PX = 0.25, 14.0
# Side of a block of windows whose errors are correlated, smaller on a sheet of fewer windows, and about how many groups
# of blocks are left out in turn.
_BLOCK, _SMALL_BLOCK, _MANY, _GROUPS, _STEP = 4, 2, 16, 24, 5
# Fits after each of which points further off than so many medians are left out, and the fewest points of a fit.
_REFITS, _OUTLIER, _LEAST_FITTED = 5, 4.0, 6
# Errors count in full up to this share of a gross one while a radial term is fitted.
_FULL = 0.1
# A bend that explains less than this share of the squared residuals is noise; height of a trial bend, as a share of the
# camera's distance.
_LEAST_EXPLAINED, _TRIAL = 0.03, 1e-3
# The end of the origin's ray moves with the frame; each shift leaves a thousandth of the error.
_SHIFTS = 6


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
        raise _needs_lens_error()
    if intrinsics is not None:
        require_size(image, intrinsics.image_size, "the lens's calibration")
    try:
        found = find_paper(image, pitch_mm * px_per_mm)
        ideal, ideal_origin = undistort(intrinsics, found.pixels), undistort(intrinsics, np.array([origin]))
    except MeasurementRefusedError as refusal:
        raise CalibrationRefusedError(refusal.message, refusal.hint) from refusal
    gross_mm = _GROSS * pitch_mm * max(1.0, _GROSS_PX / found.spacing_px)
    middle = None if intrinsics else (0.5 * (size[0] - 1), 0.5 * (size[1] - 1))
    fit = fit_plane(ideal, found.lines * float(pitch_mm), gross_mm, middle)
    turn, turn_rad = _find_turn(fit.homography, undistort(fit.radial, ideal_origin), direction)
    plane = PlaneMap(
        homography=turn @ fit.homography,
        intrinsics=intrinsics,
        origin_px=origin,
        insertion=direction,
        image_size=size,
        mm_per_px=1.0,
        radial=fit.radial,
        gel=gel,
        paper_sigma_mm=paper_sigma_mm,
        points=len(fit.ideal),
        rms_mm=measure_rms(fit.errors_mm),
    )
    plane = _anchor(plane)
    pixels, groups = found.pixels[fit.kept], _number_groups(found.cells[fit.kept])
    others, holdout_mm = fit.leave_out(groups)
    variations = [
        *(_vary(plane, turn @ other) for other in (*others, *_vary_paper(fit, intrinsics, paper_sigma_mm))),
        *(
            _vary(plane, turn @ fit_homography(lens.undistort_px(pixels), fit.places_mm), lens)
            for lens in ([] if intrinsics is None else vary_lens(intrinsics))
        ),
        *(_vary(plane, plane.matrix, gel=other) for other in ([] if gel is None else gel.vary())),
    ]
    flatness_mm, reasons = _judge(plane, found, fit, turn_rad)
    return plane.change(
        mm_per_px=plane.mm_per_px_at(origin),
        variations=tuple(variations),
        holdout_rms_mm=holdout_mm,
        flatness_mm=flatness_mm,
        accepted=not reasons,
        reasons=tuple(reasons),
    )


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


def _require_room(plane: PlaneMap) -> None:
    """Refuse a gel that would reach the camera."""
    if plane.gel is None:
        return
    height_mm, depth_mm = float(plane.camera_mm()[2]), plane.gel.height_mm()
    if depth_mm >= height_mm:
        raise CalibrationRefusedError(
            f"the gel's depth is {depth_mm:.4g} mm, and the camera is only {round_down(height_mm, 0)} mm above "
            "the paper",
            "measure from the gel's surface to the needle, in mm",
        )


def _needs_lens_error() -> InputError:
    return InputError(
        "a gel's refraction and the paper's height need the camera's intrinsics",
        "calibrate them first: --intrinsics FILE",
    )


def _find_turn(homography: FloatArray, origin: FloatArray, insertion: Insertion) -> tuple[FloatArray, float]:
    """Return the turn (3, 3) from the paper's axes to the steering plane's, and the lines' angle off the insertion.

    +z is along the lines that are nearest to the insertion, at the origin's ideal pixel (1, 2).
    """
    place = apply_homography(homography, origin)[0]
    ahead = apply_homography(np.linalg.inv(homography), place + 1e-3 * np.eye(2)) - origin
    # Cosines in the picture between +y, +z (rows) and the paper's two axes (columns).
    along = np.array(PICTURE_AXES[insertion]) @ (ahead / np.linalg.norm(ahead, axis=1)[:, None]).T
    z_line = int(np.argmax(np.abs(along[1])))
    turn = np.eye(3)
    turn[:2, :2] = 0.0
    for row, line in ((0, 1 - z_line), (1, z_line)):
        turn[row, line] = np.sign(along[row, line])
    return turn, float(np.arccos(np.clip(np.abs(along[1, z_line]), 0.0, 1.0)))


def _anchor(plane: PlaneMap) -> PlaneMap:
    """Return a map moved in its plane until the ray of the origin's pixel ends at (0, 0).

    Raises
    ------
    CalibrationRefusedError
        If the gel would reach the camera.
    """
    _require_room(plane)
    for _ in range(1 if plane.gel is None else _SHIFTS):
        shift = np.eye(3)
        shift[:2, 2] = -plane.to_mm([plane.origin_px])[0]
        plane = plane.change(homography=shift @ plane.matrix)
    return plane


def _vary(
    plane: PlaneMap, homography: FloatArray, lens: Intrinsics | None = None, gel: Gel | None = None
) -> Variation:
    """Return a variation by another homography, and another lens or gel if one is given; the origin keeps its pixel."""
    moved = _anchor(
        plane.change(homography=homography, intrinsics=lens or plane.intrinsics, gel=gel or plane.gel)
    )
    group: VariationGroup = "lens" if lens else "surface" if gel else "plane"
    return Variation(
        homography=moved.homography, group=group, lens=None if lens is None else lens.parameters(), gel=gel
    )


def _number_groups(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number (N,) of the group of each window: blocks of neighbours take turns."""
    many = int(np.ptp(cells, axis=0).min()) >= _MANY
    columns, rows = (cells // (_BLOCK if many else _SMALL_BLOCK)).T
    return np.asarray((columns + _STEP * rows) % _GROUPS)


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """The fit of points to the paper.

    Attributes
    ----------
    homography : ndarray (3, 3)
        From ideal pixels to paper [mm]; its last number is 1.
    radial : Radial or None
    kept : ndarray of bool (N,)
        Points that are not false detections.
    gross : float
        Share of the points that are.
    ideal, places_mm : ndarray (M, 2)
        Ideal pixels of the points that are kept, and their places on the paper.
    errors_mm : ndarray (M, 2)
        From these places to where the map puts them.
    """

    homography: FloatArray
    radial: Radial | None
    kept: NDArray[np.bool_]
    gross: float
    ideal: FloatArray
    places_mm: FloatArray
    errors_mm: FloatArray

    def paper_mm(self, px: FloatArray) -> FloatArray:
        """Return the places on the paper (N, 2) [mm] of ideal pixels, or of the picture's with a radial term."""
        return apply_homography(self.homography, undistort(self.radial, px))

    def leave_out(self, groups: NDArray[np.int64]) -> tuple[list[FloatArray], float]:
        """Leave out groups of points in turn, of which `groups` (M,) has the numbers.

        Returns homographies whose squared differences from this one add up to its covariance (the jackknife), and the
        rms error of the points that were left out [mm].
        """
        numbers, moves, errors = np.unique(groups), [], []
        for number in numbers:
            out = groups == number
            found = fit_homography(self.ideal[~out], self.places_mm[~out])
            moves.append((found - self.homography).ravel())
            errors.append(apply_homography(found, self.ideal[out]) - self.places_mm[out])
        # The principal axes add up to the same covariance.
        _, lengths, axes = np.linalg.svd(
            np.sqrt(1.0 - 1.0 / len(numbers)) * np.array(moves), full_matrices=False
        )
        axes = axes[lengths > 0.0] * lengths[lengths > 0.0, None]
        return [self.homography + move.reshape(3, 3) for move in axes], measure_rms(np.vstack(errors))


def fit_plane(
    px: FloatArray, paper_mm: FloatArray, gross_mm: float, radial_about: tuple[float, float] | None = None
) -> PlaneFit:
    """Fit points at pixels (N, 2) to their places on paper (N, 2) [mm].

    Parameters
    ----------
    px : ndarray (N, 2)
        Ideal pixels; with `radial_about`, the picture's own.
    gross_mm : float
        A point that is further off is a false detection.
    radial_about : (float, float), optional
        Pixel near the centre of one radial term that is fitted as well.

    Raises
    ------
    CalibrationRefusedError
        If no plane explains the points.
    """
    radial = None if radial_about is None else _fit_radial(px, paper_mm, gross_mm, np.array(radial_about))
    ideal = undistort(radial, px)
    homography, kept = _sample_homography(ideal, paper_mm, gross_mm)
    for _ in range(_REFITS):
        homography = fit_homography(ideal[kept], paper_mm[kept])
        errors_mm = apply_homography(homography, ideal) - paper_mm
        off_mm = np.hypot(*errors_mm.T)
        kept = off_mm <= min(gross_mm, _OUTLIER * float(np.median(off_mm)))
    gross = float(np.mean(off_mm >= gross_mm))
    return PlaneFit(homography, radial, kept, gross, ideal[kept], paper_mm[kept], errors_mm[kept])


def _sample_homography(
    px: FloatArray, paper_mm: FloatArray, gross_mm: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return a homography for most points, and which they are (N,)."""
    if len(px) < _LEAST_FITTED:
        raise _no_plane_error()
    # OpenCV's sampling has a fixed seed of its own.
    found, inside = cv2.findHomography(px, paper_mm, cv2.RANSAC, gross_mm)
    if found is None:
        raise _no_plane_error()
    return np.asarray(found, dtype=np.float64), np.ravel(inside) > 0


def _fit_radial(px: FloatArray, paper_mm: FloatArray, gross_mm: float, about: FloatArray) -> Radial:
    """Return the radial term that is fitted together with a homography.

    Its centre may leave the pixel that it is about, because pictures are cropped. A weak prior holds it there: a
    distance of half a diagonal costs as much as one point's error.
    """
    half = 0.5 * float(np.linalg.norm(np.ptp(px, axis=0)))
    normal, scale_mm = (px - about) / half, _FULL * gross_mm
    start, _ = _sample_homography(normal, paper_mm, gross_mm)

    def residuals(values: FloatArray) -> FloatArray:
        aside = normal - values[9:]
        ideal = values[9:] + aside / (1.0 + values[8] * np.sum(aside**2, axis=1))[:, None]
        off = apply_homography(np.append(values[:8], 1.0).reshape(3, 3), ideal) - paper_mm
        return np.concatenate((off.ravel(), scale_mm * values[9:]))

    first = np.append(start.ravel()[:8], [0.0, 0.0, 0.0])
    k, *centre = least_squares(residuals, first, loss="soft_l1", f_scale=scale_mm, x_scale="jac").x[8:]
    u, v = (about + half * np.array(centre)).tolist()
    return Radial(centre_px=(u, v), k_per_px2=float(k) / half**2)


def fit_homography(px: FloatArray, paper_mm: FloatArray) -> FloatArray:
    """Return the least-squares homography (3, 3) from pixels (N, 2) to places (N, 2).

    Raises
    ------
    CalibrationRefusedError
        If there is none: the points lie on one line, for instance.
    """
    found = cv2.findHomography(px, paper_mm)[0] if len(px) >= _LEAST_FITTED else None
    if found is None:
        raise _no_plane_error()
    return np.asarray(found, dtype=np.float64)


def _no_plane_error() -> CalibrationRefusedError:
    return CalibrationRefusedError(
        "no plane explains the printed grid", "lay the paper flat and fill the picture with it"
    )


def find_bent_homographies(px: FloatArray, paper_mm: FloatArray, foot_mm: FloatArray) -> list[FloatArray]:
    """Return other homographies that the bend of the paper allows; none if the paper shows no bend.

    Parameters
    ----------
    px : ndarray (N, 2)
        Ideal pixels of the crossings.
    paper_mm : ndarray (N, 2)
        Their places on the paper.
    foot_mm : ndarray (2,)
        The point of the paper's plane under the camera.
    """
    heights = _bend_shapes(paper_mm)
    away = paper_mm - foot_mm
    flat, left = _fit(px, paper_mm)
    trials = [_fit(px, paper_mm + _TRIAL * away * height[:, None])[1] for height in heights.T]
    design = np.column_stack([(trial - left) / _TRIAL for trial in trials])
    coefficients = -np.linalg.lstsq(design, left, rcond=None)[0]
    height = heights @ coefficients
    bent, rest = _fit(px, paper_mm + away * height[:, None])
    if float(rest @ rest) > (1.0 - _LEAST_EXPLAINED) * float(left @ left):
        return []
    return [bent, raise_paper(flat, float(np.std(height)), foot_mm)]


def raise_paper(homography: FloatArray, share: float, foot_mm: FloatArray) -> FloatArray:
    """Return the homography to the needle's plane, if the paper lies above it by a share of the camera's height."""
    raised = np.eye(3)
    raised[:2] = np.column_stack(((1.0 + share) * np.eye(2), -share * foot_mm))
    return np.asarray(raised @ homography)


def _bend_shapes(paper_mm: FloatArray) -> FloatArray:
    """Return the heights (N, 3) of a sheet bent along each axis and diagonally, without level and slope."""
    normal = (paper_mm - paper_mm.mean(axis=0)) / np.ptp(paper_mm, axis=0).max()
    a, b = normal.T
    bends = np.column_stack((a * a, a * b, b * b))
    plane = np.column_stack((a, b, np.ones(len(a))))
    return np.asarray(bends - plane @ np.linalg.lstsq(plane, bends, rcond=None)[0])


def _fit(px: FloatArray, paper_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares homography and its residuals (2 N,)."""
    found = fit_homography(px, paper_mm)
    return found, (apply_homography(found, px) - paper_mm).ravel()


def _vary_paper(fit: PlaneFit, lens: Intrinsics | None, paper_sigma_mm: float | None) -> list[FloatArray]:
    """Return other homographies that the bend of the paper and its height allow."""
    # Without a lens, the foot of the camera is taken to be the middle of the paper.
    foot = (
        fit.paper_mm(fit.ideal.mean(axis=0)[None])[0]
        if lens is None
        else find_camera_mm(fit.homography, lens)
    )
    others = find_bent_homographies(fit.ideal, fit.places_mm, foot[:2])
    if paper_sigma_mm:
        others.append(raise_paper(fit.homography, paper_sigma_mm / float(foot[2]), foot[:2]))
    return others


def _judge(plane: PlaneMap, found: PaperPoints, fit: PlaneFit, turn_rad: float) -> tuple[float, list[str]]:
    """Return the paper's deviation from flat [mm], and the reasons for refusing the map."""
    size, lens = plane.image_size or (1, 1), plane.intrinsics
    pixels = found.pixels[fit.kept]
    coverage = _measure_coverage(pixels, found.window_px, size)
    off_mm, flatness_mm, (u, v) = _measure_flatness(pixels, fit.errors_mm, size)
    reasons = []
    if plane.points < _LEAST_POINTS:
        reasons.append(
            f"{plane.points} points of ruled lines, {_LEAST_POINTS} are needed: show more of the paper"
        )
    if coverage < _LEAST_COVERAGE:
        reasons.append(
            f"the printed grid covers {round_down(100.0 * coverage, 1)} % of the picture, "
            f"{100.0 * _LEAST_COVERAGE:.0f} % are needed: use a larger sheet, evenly lit"
        )
    if fit.gross > _LARGEST_GROSS_SHARE:
        reasons.append(
            f"the paper is not flat: {round_up(100.0 * fit.gross, 1)} % of its points fit no plane, the limit is "
            f"{100.0 * _LARGEST_GROSS_SHARE:.0f} %: lay the paper flat, and take what is not paper out of the picture"
        )
    if off_mm > LARGEST_OFF_MM:
        reasons.append(
            f"the lines are {round_up(off_mm, 3)} mm off a plane, most around ({u:.0f}, {v:.0f}) px, the limit is "
            f"{LARGEST_OFF_MM} mm: {'' if lens else 'give the calibration of the lens, or '}lay the paper flat"
        )
    if lens is not None:
        reasons += _judge_lens(lens, fit.homography)
    if turn_rad > _LARGEST_TURN_RAD:
        reasons.append(
            f"the lines are turned by {round_up(np.rad2deg(turn_rad), 1)} degrees from {plane.insertion!r}, "
            f"the limit is {np.rad2deg(_LARGEST_TURN_RAD):.0f}: lay the paper along the insertion"
        )
    return flatness_mm, reasons


def _measure_coverage(pixels: FloatArray, window_px: float, size: tuple[int, int]) -> float:
    """Return the share of the picture that the windows around pixels cover."""
    corners = np.concatenate([pixels + 0.5 * window_px * np.array(way) for way in product((-1, 1), repeat=2)])
    return float(cv2.contourArea(cv2.convexHull(corners.astype(np.float32)))) / (size[0] * size[1])


def _measure_flatness(
    pixels: FloatArray, errors_mm: FloatArray, size: tuple[int, int]
) -> tuple[float, float, FloatArray]:
    """Return the median errors of the parts of the picture, rms and largest [mm], and the middle of the worst [px]."""
    columns, rows = np.clip((np.array(_PARTS) * (pixels + 0.5) / size).astype(int), 0, np.array(_PARTS) - 1).T
    part = rows * _PARTS[0] + columns
    inside = [part == number for number in np.unique(part)]
    inside = [points for points in inside if points.sum() >= _LEAST_IN_A_PART] or [part >= 0]
    off_mm = np.array([np.hypot(*np.median(errors_mm[points], axis=0)) for points in inside])
    middle = pixels[inside[int(np.argmax(off_mm))]].mean(axis=0)
    return float(np.sqrt(np.mean(off_mm**2))), float(off_mm.max()), middle


def _judge_lens(lens: Intrinsics, homography: FloatArray) -> list[str]:
    """Return the faults of the lens: refused itself, or not that of this camera, as the shape of the grid shows.

    A calibrated lens has no freedom for the shape: it would be the tilt of the sheet.
    """
    across, along = np.linalg.solve(lens.camera_matrix(), np.linalg.inv(homography))[:, :2].T
    lengths = float(np.linalg.norm(across)), float(np.linalg.norm(along))
    stretch = max(lengths) / min(lengths) - 1.0
    skew_rad = abs(float(np.arcsin(np.clip(across @ along / (lengths[0] * lengths[1]), -1.0, 1.0))))
    reasons = []
    if not lens.accepted:
        reasons.append("the lens's calibration was itself refused: calibrate the lens again first")
    if stretch > _LARGEST_STRETCH or skew_rad > _LARGEST_SKEW_RAD:
        reasons.append(
            f"the lines are no square grid through the lens: {round_up(100.0 * stretch, 1)} % longer one way, "
            f"{round_up(np.rad2deg(skew_rad), 1)} degrees off a right angle: show graph paper, and give the "
            "calibration of this camera's lens"
        )
    return reasons
