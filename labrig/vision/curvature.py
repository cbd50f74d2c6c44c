"""The radius of a needle's bend from one picture, with an interval whose coverage was measured.

The radius is fitted over a declared window of arc length that leaves out the bevel and the first millimetres behind
the sheath, over which the hinges close. Residuals along an edge are correlated over a millimetre or more, so the
interval does not count rows. The window is cut into longer blocks, the mean influence of a block's rows on the fit is
one observation, and Student's t allows for the small number of blocks (batch means; Flegal and Jones 2010, Annals of
Statistics 38:1034). The uncertainty of lens and plane map (`PlaneMap.variations`) moves all blocks together and is
added to the variance, and so is what light from one side may have done to the edges (`shaft_edges`): the circles with
and without that shift count as one standard deviation apart, as far as the shifts stand out of those in even light. The
bevel's roll is added if it is known (`out_of_plane`). The degrees of freedom are Welch's and Satterthwaite's.
`ErrorBudget` lists the parts.

In 6,000 drawn pictures, three of four with a lamp beside the needle, the interval held the truth in 97.1 % at radii of
20 to 30 mm, 95.7 % at 30 to 40 mm and 94.8 % at 40 to 60 mm (`LABRIG_BENCHMARK_TIMES=100 python -m tests.benchmarks
coverage`).
Without the part of the light it did so in 88, 82 and 79 % (900 pictures).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, InstanceOf
from scipy.special import stdtrit

from labrig.errors import MeasurementRefusedError
from labrig.protocol.model import Conflict, Model, NonNegativeMm, PositiveMm
from labrig.protocol.sections import AnalysisWindow, limit_conflict
from labrig.text import round_down
from labrig.vision.circle import Circle, fit_circle
from labrig.vision.error_budget import LEAST_LIGHT_SHIFT_PX, ErrorBudget, propagate_map
from labrig.vision.out_of_plane import BendingPlane, combine_turns
from labrig.vision.picture import Mask, Picture, require_size
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft import Shaft, locate_shaft
from labrig.vision.shaft_tip import budget_tip
from labrig.vision.sheath import measure_heading

FloatArray = NDArray[np.float64]
Bend = Literal["+y", "-y"]

# Length of a block: longer than the correlation of the residuals, and about the spacing of the needle's hinges.
_BLOCK_MM = 3.0
# Fewest blocks for Student's t; this also bounds the window from below.
_LEAST_BLOCKS = 5
_CONFIDENCE = 0.95
# In even light the median measured shift of the centre line is below the first [px]: 0.002 to 0.011 px in drawn
# pictures, and up to 0.025 px among bubbles. The second is the share of a shift that stays unexplained in a block; with
# it the interval of radii above 40 mm, of which more blocks see, holds the truth as often as it says.
_NOISE_SHIFT_PX, _UNEXPLAINED = 0.01, 0.2
# Number of points of the window at which shifts common to all rows are propagated.
_SYSTEMATIC_POINTS = 40
# A row lies on the circle if it is off by no more than this share of the needle's diameter. At least this share of the
# rows must, and the rms must stay below this share of that distance.
_LARGEST_RESIDUAL = 0.1
_LEAST_ON_CIRCLE = 0.75
_LARGEST_RMS = 0.5
# Two pictures show the same needle if so many of the one's rows, of which every tenth is looked at, lie within this
# length of the other's centre line. Where the other's is longer by more than the last, the one has lost the needle.
_MOST_ROWS, _EVERY_ROW, _SAME_LINE_MM, _FAR_BEYOND_MM = 0.9, 10, 0.3, 10.0


class CurvatureSettings(AnalysisWindow):
    """What a radius is measured with: the window of a protocol, and the diameters of needle and sheath.

    The needle's is right within a factor of about 1.5. That of the sheath is None if the picture shows none, and the
    needle enters from the border. The window is at least 15 mm long, which the interval needs. `roll_sd_deg` is None
    if it is not known.
    """

    needle_diameter_mm: PositiveMm = 1.2
    sheath_diameter_mm: PositiveMm | None = 2.0
    window_start_mm: NonNegativeMm = 4.0
    window_end_mm: NonNegativeMm = 2.0
    min_window_mm: PositiveMm = 15.0
    max_radius_sigma_mm: PositiveMm = 0.5
    roll_sd_deg: float | None = Field(None, ge=0, le=30)  # type: ignore[assignment] # a protocol always states it

    @property
    def roll_sd_rad(self) -> float | None:
        """Standard deviation of the bevel's roll out of the plane of the map."""
        return None if self.roll_sd_deg is None else math.radians(self.roll_sd_deg)

    def conflicts(self) -> Iterator[Conflict]:
        """Yield that of a sheath in which the needle has no room."""
        if self.sheath_diameter_mm is not None and self.sheath_diameter_mm <= self.needle_diameter_mm:
            yield limit_conflict(
                "sheath_diameter_mm", self.sheath_diameter_mm, "needle_diameter_mm", self.needle_diameter_mm
            )


@dataclass(frozen=True, eq=False)
class CentreLine:
    """A needle's centre line, from the entry to the tip.

    Attributes
    ----------
    mm, px : ndarray (N, 2)
        Columns (y, z) and (u, v).
    window : (int, int)
        First and end row of the part that is fitted.
    """

    mm: FloatArray
    px: FloatArray
    window: tuple[int, int]


class CurvatureMeasurement(Model):
    """The measurement of the needle's bend in one picture; unknown values are None.

    Attributes
    ----------
    found : bool
        Whether shaft and tip were located.
    accepted : bool
        Whether the radius meets the conditions.
    reason : str or None
        Why it is refused, as a sentence with value and limit.
    radius_mm, radius_ci95_mm, sigma_radius_mm : float, (float, float), float, or None
        Also set for a fitted radius that is not accepted.
    sigma_calibration_mm : float or None
        The part of `sigma_radius_mm` due to lens, plane map and surface: common to all pictures through them.
    radius_budget_mm, tip_budget_mm : ErrorBudget or None
        What the standard deviations of the radius (`sigma_radius_mm`) and of the needle's tip consist of.
    centre_mm : (float, float) or None
        Centre of the circle, (y, z).
    tip_mm, sheath_tip_mm, entry_mm : (float, float) or None
        (y, z). The entry is the sheath's tip. Without a stated sheath it is where the needle enters the picture, and
        the sheath's tip is None. The needle's tip is the end of its centre line.
    sheath_heading_rad : float or None
        Heading of the sheath; None if too little of it is visible.
    tip_px : (float, float) or None
        (u, v).
    arc_length_mm : float or None
        From the entry to the tip.
    residual_rms_mm : float or None
        Distance of the centre line from the circle.
    bend : "+y", "-y" or None
    line : CentreLine or None
        Its centre line, which is in no document.
    """

    found: bool
    accepted: bool
    reason: str | None
    radius_mm: float | None = None
    radius_ci95_mm: tuple[float, float] | None = None
    sigma_radius_mm: float | None = None
    sigma_calibration_mm: float | None = None
    radius_budget_mm: ErrorBudget | None = None
    centre_mm: tuple[float, float] | None = None
    tip_mm: tuple[float, float] | None = None
    tip_px: tuple[float, float] | None = None
    tip_budget_mm: ErrorBudget | None = None
    sheath_tip_mm: tuple[float, float] | None = None
    sheath_heading_rad: float | None = None
    entry_mm: tuple[float, float] | None = None
    arc_length_mm: float | None = None
    residual_rms_mm: float | None = None
    bend: Bend | None = None
    line: InstanceOf[CentreLine] | None = Field(default=None, exclude=True, repr=False)

    @classmethod
    def refuse(cls, reason: str) -> Self:
        """Return that of a picture in which no needle is measured."""
        return cls(found=False, accepted=False, reason=reason)


def measure_curvature(
    image: Picture, plane: PlaneMap, settings: CurvatureSettings, *, mask: Mask | None = None
) -> CurvatureMeasurement:
    """Measure the radius of the needle's bend in one picture.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) grey or (H, W, 3) blue-green-red
        The needle is darker than the gel.
    plane : PlaneMap
        From a calibration, or `PlaneMap.from_scale` for rectified pictures.
    settings : CurvatureSettings
    mask : ndarray of bool (H, W), optional
        Pixels that are not the needle.

    Returns
    -------
    CurvatureMeasurement
        A measurement that cannot be made is refused in it, with the reason.

    Raises
    ------
    InputError
        If the picture has another size than the plane was calibrated for.
    """
    require_size(image, plane.image_size, "the plane map")
    try:
        shaft = locate_shaft(
            image, plane, settings.needle_diameter_mm, settings.sheath_diameter_mm, mask=mask
        )
    except MeasurementRefusedError as refusal:
        return CurvatureMeasurement.refuse(_make_sentence(refusal))
    entry, tip = (_pair(point) for point in plane.to_mm(np.vstack((shaft.entry_px, shaft.tip_px))))
    ends_mm = (settings.window_start_mm, shaft.length_mm - settings.window_end_mm)
    first, end = np.searchsorted(shaft.arc_mm, ends_mm).tolist()
    window = (first, max(first, end))
    located = CurvatureMeasurement(
        found=True,
        accepted=False,
        reason=None,
        line=CentreLine(shaft.centre_mm, shaft.centre_px, window),
        tip_mm=tip,
        tip_px=_pair(shaft.tip_px),
        tip_budget_mm=budget_tip(shaft, plane, settings.roll_sd_rad),
        sheath_tip_mm=entry if shaft.sheathed else None,
        sheath_heading_rad=measure_heading(shaft.sheath_mm),
        entry_mm=entry,
        arc_length_mm=shaft.length_mm,
    )
    try:
        return located.model_copy(update=_fit_circle(window, shaft, plane, settings))
    except MeasurementRefusedError as refusal:
        return located.model_copy(update={"reason": _make_sentence(refusal)})


def refuse_cut_short(film: Sequence[CurvatureMeasurement]) -> list[CurvatureMeasurement]:
    """Return the measurements of successive pictures; those that lost the needle are refused.

    Where the pictures before and after show the same centre line, and both show it go on far beyond the end of this
    one, its end is none.
    """
    kept = list(film)
    for number, (before, one, after) in enumerate(zip(film, film[1:], film[2:], strict=False), start=1):
        beyond_mm = min(_go_on_mm(one, before), _go_on_mm(one, after))
        if beyond_mm > _FAR_BEYOND_MM:
            reason = (
                f"The needle is lost after {one.arc_length_mm:.1f} mm: the pictures before and after this one show it "
                f"go on for {beyond_mm:.1f} mm, and {_FAR_BEYOND_MM:g} mm is the most."
            )
            kept[number] = CurvatureMeasurement.refuse(reason)
    return kept


def _go_on_mm(one: CurvatureMeasurement, other: CurvatureMeasurement) -> float:
    """Return by how much another picture's needle is longer, if it is the same; 0 if not."""
    if one.line is None or other.line is None:
        return 0.0
    line, longer = one.line.mm[::_EVERY_ROW], other.line.mm
    away_mm = np.linalg.norm(line[:, None] - longer[None], axis=2).min(axis=1)
    same = float(np.quantile(away_mm, _MOST_ROWS)) <= _SAME_LINE_MM
    return (other.arc_length_mm or 0.0) - (one.arc_length_mm or 0.0) if same else 0.0


def _fit_circle(
    window: tuple[int, int], shaft: Shaft, plane: PlaneMap, settings: CurvatureSettings
) -> dict[str, Any]:
    """Return what the circle through a window of rows says. Raises MeasurementRefusedError if there is none."""
    rows = slice(*window)
    points, arc_mm = shaft.centre_mm[rows], shaft.arc_mm[rows]
    length_mm = float(arc_mm[-1] - arc_mm[0]) if len(arc_mm) else 0.0
    least_mm = max(settings.min_window_mm, _LEAST_BLOCKS * _BLOCK_MM)
    if length_mm < least_mm:
        raise MeasurementRefusedError(
            f"of {shaft.length_mm:.1f} mm of needle {length_mm:.2f} mm lie in the window for the radius, which leaves "
            f"out at least {settings.window_start_mm:g} mm at the entry and {settings.window_end_mm:g} mm at the tip, "
            f"and {least_mm:g} mm is the least"
        )
    try:
        circle = fit_circle(points)
        influences, gain = _measure_blocks(circle, points, arc_mm)
    except MeasurementRefusedError as refusal:
        raise refusal.reword(
            f"no circle fits the {length_mm:.1f} mm in the window: {refusal.message}"
        ) from refusal
    systematic = _find_systematic(circle, shaft, rows, plane, gain=gain, roll_sd_rad=settings.roll_sd_rad)
    budget, ci95 = _estimate_uncertainty(circle.radius, influences, gain, systematic)
    reason = _judge_circle(circle, points, budget.total, settings)
    ahead, aside = points[len(points) // 4] - points[0], np.asarray(circle.centre) - points[0]
    return {
        "accepted": reason is None,
        "reason": reason,
        "radius_mm": circle.radius,
        "radius_ci95_mm": ci95,
        "sigma_radius_mm": budget.total,
        "sigma_calibration_mm": budget.calibration,
        "radius_budget_mm": budget,
        "centre_mm": circle.centre,
        "residual_rms_mm": circle.residual_rms,
        "bend": "+y" if ahead[1] * aside[0] - ahead[0] * aside[1] > 0.0 else "-y",
    }


def _find_directions(circle: Circle, points: FloatArray) -> FloatArray:
    """Return the unit vectors (N, 2) from the circle's centre to points."""
    offsets = points - np.asarray(circle.centre)
    return np.asarray(offsets / np.hypot(*offsets.T)[:, None])


def _weigh_radius(directions: FloatArray) -> FloatArray:
    """Return by how much the radius grows (N,) for a shift of each point outwards; also for nearly straight arcs."""
    return np.asarray(np.linalg.pinv(np.column_stack((directions, np.ones(len(directions)))))[2])


def _measure_blocks(circle: Circle, points: FloatArray, arc_mm: FloatArray) -> tuple[FloatArray, float]:
    """Return what blocks of arc length say about the radius of a circle through points (N, 2) at arc lengths (N,).

    Returns
    -------
    influences : ndarray (B,)
        The mean influence of the rows of each block [mm]. A bubble at an edge is an outlier of the fit and has none,
        but the fewer rows are left, the larger is theirs. A block without a single inlier is no bubble, and its mean
        residual counts whole.
    gain : float
        By how much the radius changes if each block is shifted by 1 mm, in or out at random (rms).
    """
    along = arc_mm - arc_mm[0]
    block = np.minimum((along / _BLOCK_MM).astype(int), int(along[-1] / _BLOCK_MM) - 1)
    sizes = np.bincount(block)
    seen = sizes > 0
    if seen.sum() < _LEAST_BLOCKS:
        raise MeasurementRefusedError(
            f"the edges are seen in {seen.sum()} blocks of {_BLOCK_MM:g} mm, and {_LEAST_BLOCKS} are the least"
        )
    columns = (
        *_find_directions(circle, points).T,
        circle.influences,
        circle.residuals(points),
        circle.inliers,
    )
    y, z, influences, residuals, inliers = (
        np.bincount(block, column)[seen] / sizes[seen] for column in columns
    )
    gain = float(np.linalg.norm(_weigh_radius(np.column_stack((y, z)))))
    return np.where(inliers > 0.0, influences, residuals), gain


def _find_systematic(
    circle: Circle, shaft: Shaft, rows: slice, plane: PlaneMap, *, gain: float, roll_sd_rad: float | None
) -> ErrorBudget:
    """Return the error budget of the radius without the fit."""
    count = rows.stop - rows.start
    sample = rows.start + np.linspace(0, count - 1, min(count, _SYSTEMATIC_POINTS)).astype(int)
    here, px = shaft.centre_mm[sample], shaft.centre_px[sample]
    directions = _find_directions(circle, here)
    weights = _weigh_radius(directions)

    def change(shifts: FloatArray) -> float:
        return float(weights @ np.sum(directions * shifts, axis=1))

    mapped = plane.to_mm(px)
    # The measured shifts count as far as their median stands out of what noise shows in even light. A share of them
    # stays unexplained, in each block another one.
    typical_mm = float(np.median(np.hypot(*shaft.light_shift_mm[rows].T)))
    seen = typical_mm**2 / (typical_mm**2 + (_NOISE_SHIFT_PX * plane.mm_per_px) ** 2)
    by_light_mm = seen * change(shaft.light_shift_mm[sample])
    least_mm = LEAST_LIGHT_SHIFT_PX * plane.mm_per_px
    roll = None
    # Without the camera's place the perspective is not known, which is most of what a roll does.
    if roll_sd_rad is not None and plane.intrinsics is not None:
        bending = BendingPlane.of(shaft.entry_px, shaft.arc_mm, shaft.centre_mm, plane)
        roll = combine_turns(
            *(change(bending.unroll(here, turn) - here) for turn in (roll_sd_rad, -roll_sd_rad))
        )
    return ErrorBudget(
        **propagate_map(plane, px, lambda places: change(places - mapped)),
        roll=roll,
        lighting=float(np.linalg.norm([by_light_mm, _UNEXPLAINED * typical_mm * gain, least_mm])),
    )


def _estimate_uncertainty(
    radius_mm: float, influences: FloatArray, gain: float, systematic: ErrorBudget
) -> tuple[ErrorBudget, tuple[float, float] | None]:
    """Return the radius' error budget, and its 95 % interval unless it is unbounded.

    The degrees of freedom of the systematic part count as infinite. With few blocks Welch's and Satterthwaite's formula
    then gives a shorter interval than the blocks alone, so that of the blocks is the least. The interval is symmetric
    in the curvature, which is nearly normal even if the radius is not.
    """
    freedom = len(influences) - 3
    random = float(gain * np.linalg.norm(influences) / np.sqrt(freedom))
    budget = systematic.model_copy(update={"fit": random})
    sigma = budget.total
    effective = freedom * (sigma / random) ** 4 if random else np.inf
    quantile = 0.5 + 0.5 * _CONFIDENCE
    half_mm = max(stdtrit(effective, quantile) * sigma, stdtrit(freedom, quantile) * random)
    reach = float(half_mm) / radius_mm
    ci95 = (radius_mm / (1.0 + reach), radius_mm / (1.0 - reach)) if reach < 1.0 else None
    return budget, ci95


def _judge_circle(
    circle: Circle, points: FloatArray, sigma_mm: float, settings: CurvatureSettings
) -> str | None:
    """Return why the radius is refused, or None."""
    share = (settings.max_radius_sigma_percent or 0.0) / 100.0
    if sigma_mm > max(settings.max_radius_sigma_mm, share * circle.radius):
        relative = f" or {100.0 * share:g} % of it" if share else ""
        return (
            f"The standard deviation of the radius is {sigma_mm:.2f} mm, and {settings.max_radius_sigma_mm:g} mm"
            f"{relative} is the most: the arc is too gentle, too short or too rough."
        )
    largest_mm = _LARGEST_RESIDUAL * settings.needle_diameter_mm
    on_circle = float(np.mean(np.abs(circle.residuals(points)) <= largest_mm))
    if on_circle < _LEAST_ON_CIRCLE:
        return (
            f"{round_down(100.0 * on_circle, 1)} % of the centre line lies within {largest_mm:.2f} mm of one circle, "
            f"and {100.0 * _LEAST_ON_CIRCLE:.0f} % is the least."
        )
    if circle.residual_rms > _LARGEST_RMS * largest_mm:
        return (
            f"The centre line is {circle.residual_rms:.3f} mm (rms) off the circle, and "
            f"{_LARGEST_RMS * largest_mm:.3f} mm is the most."
        )
    return None


def _make_sentence(refusal: MeasurementRefusedError) -> str:
    message = refusal.message.rstrip(".")
    return f"{message[:1].upper()}{message[1:]}."


def _pair(point: FloatArray) -> tuple[float, float]:
    return float(point[0]), float(point[1])
