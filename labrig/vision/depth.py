"""How far a needle's end is out of the plane, from the traces that depth leaves in a picture.

- Width: what is farther away looks thinner. Along the shaft the apparent width tells how x changes; its absolute value
  tells nothing, since edges look as wide as light and lens make them.
- Length: the arc length that is seen, against the length that was inserted. Where the needle runs away from the
  camera's foot, depth shortens it; a lean shortens it too, and so does slip, which is not known.

Both are combined with what is known before, the covariance of the places along the needle. Where they contradict it the
needle has left the plane, or something else is wrong: what is known before does not hold then, and the picture alone
says where the end is.

Widths tell something in even light before a plain ground. In the 85 shared photographs of real needles, 6 to 7 px wide
before ruled paper, they scatter by 4 to 8 % and change by 10 % from end to end in a way that is not depth. Such widths
are left out.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.vision.perspective import Perspective
from labrig.vision.shaft_tip import ShaftTip

FloatArray = NDArray[np.float64]

# Length over which a width is the median of its rows, and what is left out at the sheath and, in diameters, at the
# bevel: smoothing along the shaft makes the last three millimetres look 1 to 4 % wider.
_BLOCK_MM, _FROM_MM, _BEVEL = 3.0, 4.0, 3.5
_LEAST_BLOCKS, _LEAST_ROWS = 6, 6
# Scatter of these widths and what neighbours have in common, measured on 60 pictures of simulated needles of 12 px:
# 0.5 % of the width. _TAPER is that of a change of width along the whole needle that is not depth, such as light that
# differs from end to end. Widths that scatter by more than _MOST are left out.
_WIDTH_PX, _IN_COMMON, _TAPER, _MOST = 0.06, 0.4, 0.003, 0.015
# Standard deviation of the share of the inserted length by which the tip lags behind, and of the ends' places [mm].
_SLIP, _ENDS_MM = 0.01, 0.1
# Places so far out of the plane, as a standard deviation, when nothing is known before.
_ANYWHERE_MM = 30.0
# So many standard deviations are a contradiction. In `python -m tests.benchmarks depth` with 100 pictures a row, 1 of
# 495 alarmed where what was told is true; of 99 needles more than 3 mm out, where 0.9 mm were told, 77 did.
_CONTRADICTS = 3.0
_ROUNDS = 4
_TINY_MM2 = 1e-9


@dataclass(frozen=True)
class Depth:
    """How far the end of a needle is out of the plane.

    Attributes
    ----------
    x_mm, sd_mm : float
        By all that is known.
    picture_x_mm, picture_sd_mm : float
        By the picture alone.
    contradicts : bool
        Whether picture and what was known before contradict each other; `x_mm` is then the picture's.
    """

    x_mm: float
    sd_mm: float
    picture_x_mm: float
    picture_sd_mm: float
    contradicts: bool


@dataclass(frozen=True, eq=False)
class _Traces:
    """What is seen (M,), how it depends on the places along the needle (M, N + 2), and its covariance (M, M).

    The last two columns are a common scale of all widths, and their taper.
    """

    seen: FloatArray
    slopes: FloatArray
    covariance: FloatArray


def measure_depth(
    end: ShaftTip, perspective: Perspective, inserted_mm: float, at_mm: FloatArray, covariance_mm2: FloatArray
) -> Depth | None:
    """Return how far the end of a needle is out of the plane; None if its widths do not tell.

    Parameters
    ----------
    end : ShaftTip
    perspective : Perspective
    inserted_mm : float
        Length of the needle beyond the sheath.
    at_mm : ndarray (N,)
        Arc lengths from the sheath to the end, rising.
    covariance_mm2 : ndarray (N, N)
        Of the places out of the plane there, before the picture is looked at.
    """
    width = _trace_width(end, perspective, at_mm)
    if width is None:
        return None
    length = _LengthTrace.of(end, perspective, inserted_mm, at_mm)
    before = covariance_mm2 + _TINY_MM2 * np.eye(len(at_mm))
    share = at_mm / at_mm[-1]
    # A needle that wanders or is bent away: x rises with the square of the length and faster.
    bent = share**2 * (3.0 - share) / 2.0
    anywhere = before + _ANYWHERE_MM**2 * np.outer(bent, bent)
    known = _update(width, length, before, _Places(np.zeros(len(at_mm)), before))
    picture = _update(width, length, anywhere, known)
    contradicts = abs(picture.end_mm) > _CONTRADICTS * math.hypot(
        picture.end_sd_mm, math.sqrt(covariance_mm2[-1, -1])
    )
    told = picture if contradicts else known
    return Depth(told.end_mm, told.end_sd_mm, picture.end_mm, picture.end_sd_mm, contradicts)


def _trace_width(end: ShaftTip, perspective: Perspective, at_mm: FloatArray) -> _Traces | None:
    """Return the widths along the shaft over their median, less one; None for too few, or if they scatter too much."""
    usual_mm = float(np.median(end.widths_mm))
    last_mm = end.length_mm - _BEVEL * usual_mm
    number = ((end.arc_mm - _FROM_MM) / _BLOCK_MM).astype(int)
    counts = (end.arc_mm >= _FROM_MM) & (end.arc_mm < last_mm)
    blocks = [counts & (number == index) for index in range(int(number.max()) + 1)]
    blocks = [block for block in blocks if block.sum() >= _LEAST_ROWS]
    if len(blocks) < _LEAST_BLOCKS:
        return None
    places = np.array([end.arc_mm[block].mean() for block in blocks]) * (at_mm[-1] / end.length_mm)
    widths = np.array([np.median(end.widths_mm[block]) for block in blocks]) / usual_mm
    # The second differences of a smooth change are small: they show the scatter, less what neighbours have in common.
    scatter = math.sqrt(
        float(np.mean(np.diff(widths, 2) ** 2)) / (6.0 - 8.0 * _IN_COMMON + 2.0 * _IN_COMMON**2)
    )
    sd = max(scatter, _WIDTH_PX / end.width_px)
    if sd > _MOST:
        return None
    common = _IN_COMMON ** (np.abs(np.subtract.outer(places, places)) / _BLOCK_MM)
    slopes = np.zeros((len(places), len(at_mm) + 2))
    for column, unit in enumerate(np.eye(len(at_mm))):
        slopes[:, column] = -np.interp(places, at_mm, unit) / perspective.height_mm
    slopes[:, -2], slopes[:, -1] = 1.0, places / at_mm[-1] - 0.5
    return _Traces(widths - 1.0, slopes, sd**2 * common)


@dataclass(frozen=True, eq=False)
class _LengthTrace:
    """The seen length less the inserted one [mm], its variance, and how it depends on the places along the needle (N,).

    steps_mm (N - 1,) : between these places; a lean shortens what is seen by half its square.
    """

    seen_mm: float
    variance: float
    slopes: FloatArray
    steps_mm: FloatArray

    @classmethod
    def of(
        cls, end: ShaftTip, perspective: Perspective, inserted_mm: float, at_mm: FloatArray
    ) -> "_LengthTrace":
        """Return the trace of a needle's length."""
        arc_mm = end.arc_mm * (at_mm[-1] / end.length_mm)
        nodes = np.column_stack([np.interp(at_mm, arc_mm, line) for line in end.centre_line_mm.T])
        steps_mm, chords = np.diff(at_mm), np.diff(nodes, axis=0)
        along = chords / np.maximum(np.linalg.norm(chords, axis=1), 1e-9)[:, None]
        outwards = np.sum((nodes[:-1] + 0.5 * chords - perspective.foot_mm) * along, axis=1)
        slopes = np.zeros(len(at_mm))
        slopes[:-1] += (-0.5 * steps_mm + outwards) / perspective.height_mm
        slopes[1:] += (-0.5 * steps_mm - outwards) / perspective.height_mm
        variance = (_SLIP * inserted_mm) ** 2 + _ENDS_MM**2
        return cls(end.length_mm - inserted_mm, variance, slopes, steps_mm)

    def linearise(self, places_mm: FloatArray, covariance: FloatArray) -> tuple[float, FloatArray]:
        """Return what is expected to be seen [mm] at these places, uncertain as they are, and its slopes there (N,)."""
        rises = np.diff(places_mm)
        spread = np.diff(np.diff(covariance, axis=0), axis=1).diagonal()
        lost_mm = 0.5 * float(np.sum((rises**2 + spread) / self.steps_mm))
        slopes = self.slopes.copy()
        slopes[:-1] += rises / self.steps_mm
        slopes[1:] -= rises / self.steps_mm
        return float(self.slopes @ places_mm) - lost_mm, slopes


@dataclass(frozen=True, eq=False)
class _Places:
    """Places out of the plane along the needle [mm], (N,), and their covariance (N, N)."""

    mean_mm: FloatArray
    covariance: FloatArray

    @property
    def end_mm(self) -> float:
        """The end's place."""
        return float(self.mean_mm[-1])

    @property
    def end_sd_mm(self) -> float:
        """Its standard deviation."""
        return math.sqrt(max(0.0, float(self.covariance[-1, -1])))


def _update(width: _Traces, length: _LengthTrace, before: FloatArray, near: _Places) -> _Places:
    """Return the places after both traces, by Gauss-Newton steps from places near by.

    A needle towards the camera's foot looks as long at two depths, since depth shortens what a lean lengthens. So the
    steps start at what is known.
    """
    count = len(before)
    prior = np.zeros((count + 2, count + 2))
    prior[:count, :count] = before
    prior[-2, -2], prior[-1, -1] = 1.0, _TAPER**2
    places = near
    noise = np.diag(np.full(len(width.seen) + 1, length.variance))
    noise[:-1, :-1] = width.covariance
    for _ in range(_ROUNDS):
        expected_mm, slopes = length.linearise(places.mean_mm, places.covariance)
        rows = np.vstack((width.slopes, np.concatenate((slopes, np.zeros(2)))))
        seen = np.append(width.seen, length.seen_mm - expected_mm + slopes @ places.mean_mm)
        spread = rows @ prior @ rows.T + noise
        gain = np.linalg.solve(spread, rows @ prior).T
        covariance = prior - gain @ rows @ prior
        places = _Places((gain @ seen)[:count], covariance[:count, :count])
    return places
