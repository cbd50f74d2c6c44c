"""The course of a dark shaft through a picture, to a fraction of its width: the start of the edge search.

The trace works on optical density, in which uneven light is an additive, slow term, in a picture reduced until the
needle is a few pixels wide. A bar of any direction shows there as the larger eigenvalue of the Hessian. A fan of short
arcs follows the shaft. Each arc is judged by the bars under its whole length, so that a bubble or a weak stretch does
not divert the trace. Where the trace ends, at a wall, a reflection or a weak stretch, the shaft is searched for behind.

In this file the insertion always points to the right (+u): `Orientation` turns pictures and points.
"""

from dataclasses import dataclass
from statistics import median
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.picture import Picture
from labrig.vision.plane import Insertion

FloatArray = NDArray[np.float64]

# Width of a needle in the reduced picture [px]: fewer pixels lose it, more cost time.
_REDUCED_WIDTH_PX = 5.0
# Narrowest needle, and smallest side of a usable reduced picture.
_LEAST_WIDTH_PX = 2.5
_LEAST_SIDE_PX = 8
# Grey levels added before the logarithm, so that the noise of black stays small.
_DARK_OFFSET = 8.0
# A bright stripe on the shaft narrower than this share of its widest diameter is a glint and is filled.
_GLINT = 0.5
# Width of the smoothing in needle diameters: between the best widths for the needle and for its sheath.
_BAR_SIGMA = 0.6
# A sheath wider than this many needle diameters is a bar of its own width; the smoothing for it, in its diameters.
_WIDE_SHEATH = 2.1
_WIDE_SIGMA = 0.35
# A needle without a stated sheath may look thicker than stated by this factor.
_WIDEST = 1.35
# The shaft is searched for this close to the border where it enters, as a straight bar of this length.
_ENTRY_MM = 20.0
_ENTRY_BAR_MM = 4.0
_BEGINNING_MM = 8.0
# A bar must stand out of the picture's own texture by this many standard deviations, and by this density.
_LEAST_SIGNIFICANCE = 6.0
_LEAST_DENSITY = 0.05
# A bar with this share of the strongest response may be a shaft that slants; a weaker one is an old track.
_SLANTING = 0.3
_MAX_CANDIDATES, _MAX_SEEDS = 8, 12
# Least distance between two candidates, in needle diameters.
_APART = 1.5
# The fan: its length, the step after each fan, and the arcs that it tries.
_LOOK_MM = 3.0
_STEP_MM = 1.0
_LOOK_SAMPLES = 10
_TURNS_RAD = np.linspace(-0.24, 0.24, 13)
_CURVATURES_PER_MM = np.array([-0.08, -0.04, 0.0, 0.04, 0.08])
_TURN_PENALTY_PER_RAD2 = 1.39
# Below this share of the shaft's usual response a stretch is weak; a weak stretch of this length ends the trace.
_WEAK = 0.3
_GAP_MM = 2.0
_USUAL_STEPS = 12
# No needle turns as much as this over this length: the trace has gone over to something that crosses the shaft.
_KINK_RAD, _KINK_STEPS = 0.7, 3
# The shaft is searched for again up to this far behind the end, over this length, at this share of its response. Then
# the arcs of that fan, and the last stretch, whose heading it starts with.
_LONGEST_HIDDEN_MM = 10.0
_AGAIN_MM = 4.0
_AGAIN_STEP_MM = 0.5
_AGAIN = 0.3
_AGAIN_TURNS_RAD = np.linspace(-0.16, 0.16, 9)
_AGAIN_CURVATURES_PER_MM = np.linspace(-0.07, 0.07, 29)
_HEADING_MM = 6.0
_MOST_WALLS = 3
# An end is none if a shaft is seen beyond it with the first share of its response, out of the picture's texture, or
# with the second and so much more strongly than at the places so many widths beside it, where lines, tracks and bubbles
# are. Ahead of the tips in 102 photographs of a real needle over ruled paper the share is 0.14 at most, and 1.25 times
# that beside; in 500 drawn pictures 0.11 and 2.6 times, or 0.077 and 3.4 times; of a needle in haze that lets through a
# seventh of it 0.095 and 2.9 times; at two places where the needle leaves a dark holder 0.56 and 0.59.
_GOING_ON, _LEAST_GOING_ON, _STANDS_OUT = 0.2, 0.085, 2.7
_BESIDE = (-8.0, -6.5, -5.0, -3.5, 3.5, 5.0, 6.5, 8.0)


@dataclass(frozen=True)
class Widths:
    """The stated diameters of needle and sheath, and what they are in pixels; the sheath is None if none is shown."""

    needle_mm: float
    sheath_mm: float | None
    px_per_mm: float

    @property
    def needle_px(self) -> float:
        """Width of the needle."""
        return self.needle_mm * self.px_per_mm

    @property
    def widest_px(self) -> float:
        """Width of the widest part of the shaft, as far as it may be off."""
        return max(self.sheath_mm or 0.0, _WIDEST * self.needle_mm) * self.px_per_mm

    @property
    def glint_px(self) -> float:
        """Width of the widest glint on the shaft."""
        return _GLINT * self.widest_px


@dataclass(frozen=True)
class Orientation:
    """Turns a picture until the insertion points right, by exchanging and reversing axes: nothing is resampled.

    Attributes
    ----------
    insertion : "right", "left", "up" or "down"
    extent : int
        Size of the picture along the insertion [px].
    """

    insertion: Insertion
    extent: int

    @classmethod
    def of(cls, image: Picture, insertion: Insertion) -> Self:
        """Return the orientation for a picture."""
        return cls(insertion, image.shape[1] if insertion in {"right", "left"} else image.shape[0])

    def picture(self, image: Picture) -> Picture:
        """Return the turned picture."""
        turned = image.T if self.insertion in {"down", "up"} else image
        return np.ascontiguousarray(turned[:, ::-1] if self.insertion in {"left", "up"} else turned)

    def original_px(self, points: FloatArray) -> FloatArray:
        """Return points (N, 2) of the turned picture as pixels of the original."""
        along, across = points[:, 0], points[:, 1]
        if self.insertion in {"left", "up"}:
            along = self.extent - 1 - along
        return np.column_stack((across, along) if self.insertion in {"down", "up"} else (along, across))


@dataclass(frozen=True, eq=False)
class Trace:
    """A shaft's course.

    Attributes
    ----------
    points : ndarray (N, 2)
        Pixels (u, v) of the turned picture about a millimetre apart, from the entry to the end.
    responses : ndarray (N,)
        Response of the bar filter at these points, an optical density.
    strength : float
        Median response from the place on at which the shaft was first seen.
    hidden_mm : float
        Longest stretch over which the shaft is not seen.
    """

    points: FloatArray
    responses: FloatArray
    strength: float
    hidden_mm: float

    @property
    def weight(self) -> float:
        """Return how likely this is the shaft: it grows with strength and length."""
        return self.strength * float(np.sqrt(len(self.points)))


@dataclass(frozen=True, eq=False)
class BarMap:
    """The response of the bar filter at each pixel of the reduced picture.

    `straight` is the mean response of straight bars along the insertion, and `least` what stands out of the texture.
    """

    any_direction: NDArray[np.float32]
    straight: NDArray[np.float32]
    least: float
    factor: int
    needle_px: float
    widest_px: float
    px_per_mm: float

    def full_px(self, reduced: NDArray[np.complex128]) -> FloatArray:
        """Return pixels (N, 2) of the picture at places u + iv of the reduced one."""
        return (np.column_stack((reduced.real, reduced.imag)) + 0.5) * self.factor - 0.5

    def reduced(self, points: FloatArray) -> NDArray[np.complex128]:
        """Return the places u + iv in the reduced picture of pixels (N, 2)."""
        return np.asarray(((points + 0.5) / self.factor - 0.5) @ np.array([1.0, 1.0j]))

    def at(self, places: NDArray[np.complex128]) -> NDArray[np.float32]:
        """Return the response at places u + iv, zero outside the picture."""
        u, v = places.real.astype(np.float32), places.imag.astype(np.float32)
        read = cv2.remap(self.any_direction, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(read, dtype=np.float32).reshape(places.shape)


def trace_shafts(bars: BarMap, *, from_border: bool = True) -> tuple[Trace, ...]:
    """Follow every shaft that enters at the left border of a turned picture, strongest first.

    With `from_border` False, a shaft may begin anywhere.

    Raises
    ------
    MeasurementRefusedError
        If nothing dark and long enters at that border.
    """
    means, least = bars.straight, bars.least
    reach = round(min(means.shape[1], (_ENTRY_MM if from_border else np.inf) * bars.px_per_mm))
    seeds = _find_seeds(bars, means[:, :reach], least)
    if not seeds:
        raise MeasurementRefusedError(
            "nothing dark and straight enters the picture: the best bar has an optical density of "
            f"{max(float(means[:, :reach].max()), 0.0):.3f}, and {least:.3f} is needed to stand out"
        )
    # In the row of a needle may also lie another shaft's beginning.
    beginnings = _find_seeds(bars, means[:, : round(_BEGINNING_MM * bars.px_per_mm)], least)
    traces: list[Trace] = []
    for seed in (*seeds, *beginnings):
        if len(traces) < _MAX_CANDIDATES and not any(_passes(bars, trace, seed) for trace in traces):
            traces.append(_trace_from(bars, seed))
    return tuple(sorted(traces, key=lambda trace: -trace.weight))


def _passes(bars: BarMap, trace: Trace, seed: complex) -> bool:
    """Return whether a trace runs over a place of the reduced picture."""
    away = trace.points - bars.full_px(np.array([seed]))
    return bool(np.hypot(*away.T).min() < bars.widest_px * bars.factor)


def tell_too_thin(needle_px: float) -> str:
    """Return why a needle of so many pixels cannot be measured; empty if it can."""
    wide = f"the needle is {needle_px:.2g} pixels wide, and {_LEAST_WIDTH_PX} is the least"
    seen = needle_px >= _LEAST_WIDTH_PX
    return "" if seen else f"{wide}: use a closer view, or correct needle.diameter_mm"


def filter_bars(picture: Picture, widths: Widths) -> BarMap:
    """Return how much each place of a turned grey picture looks like a bar of the stated widths.

    Parameters
    ----------
    picture : ndarray of uint8 (H, W)
        The insertion points right.
    widths : Widths
        Right within a factor of about 1.5.

    Raises
    ------
    MeasurementRefusedError
        If needle or picture has too few pixels.
    """
    if unseen := tell_too_thin(widths.needle_px):
        raise MeasurementRefusedError(unseen)
    factor = max(1, round(widths.needle_px / _REDUCED_WIDTH_PX))
    h, w = (side // factor for side in picture.shape)
    if min(h, w) < _LEAST_SIDE_PX:
        size = f"{picture.shape[1]} x {picture.shape[0]} pixels"
        raise MeasurementRefusedError(f"the picture is {size}, too few to show a needle")
    whole = picture[: h * factor, : w * factor]
    reduced = cv2.resize(whole, (w, h), interpolation=cv2.INTER_AREA) if factor > 1 else whole
    glint = int(np.ceil(widths.glint_px / factor)) | 1
    reduced = cv2.morphologyEx(reduced, cv2.MORPH_OPEN, np.ones((glint, glint), np.uint8))
    density = -np.log(reduced.astype(np.float32) + np.float32(_DARK_OFFSET))
    needle_px, widest_px = widths.needle_px / factor, widths.widest_px / factor
    ridge, along = _find_bars(density, _BAR_SIGMA * needle_px)
    if widest_px > _WIDE_SHEATH * needle_px:
        wide_ridge, wide_along = _find_bars(density, _WIDE_SIGMA * widest_px)
        ridge, along = np.maximum(ridge, wide_ridge), np.maximum(along, wide_along)
    px_per_mm = widths.px_per_mm / factor
    means, least = _average_bars(along, px_per_mm)
    return BarMap(ridge, means, least, factor, needle_px, widest_px, px_per_mm)


def _find_bars(density: NDArray[np.float32], sigma: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the response to bars of any direction and to bars along the insertion."""
    across, along, mixed = _differentiate_twice(density, sigma)
    mean, half = 0.5 * (across + along), 0.5 * (across - along)
    ridge = np.asarray(cv2.magnitude(half, mixed), dtype=np.float32) - mean
    return np.maximum(ridge, 0.0), -across


def _differentiate_twice(density: NDArray[np.float32], sigma: float) -> tuple[NDArray[np.float32], ...]:
    """Return the second derivatives (across, along, mixed) of the smoothed picture, times sigma squared."""
    half = int(np.ceil(3.5 * sigma))
    x = np.arange(-half, half + 1) / sigma
    smooth = np.exp(-0.5 * x**2)
    smooth /= smooth.sum()
    first, second = -x * smooth, (x**2 - 1.0) * smooth
    second -= second.mean()
    return tuple(
        np.asarray(cv2.sepFilter2D(density, cv2.CV_32F, u, v, borderType=cv2.BORDER_REFLECT), np.float32)
        for u, v in ((smooth, second), (second, smooth), (first, first))
    )


def _average_bars(along: NDArray[np.float32], px_per_mm: float) -> tuple[NDArray[np.float32], float]:
    """Return the mean response of straight bars along the insertion, and the least one that stands out."""
    length = max(3, round(_ENTRY_BAR_MM * px_per_mm))
    means = np.asarray(cv2.blur(along, (length, 1), borderType=cv2.BORDER_REFLECT), dtype=np.float32)
    # Averages less than a bar's length apart say much the same.
    noise = 1.4826 * float(np.median(np.abs(means[:, :: max(1, length // 4)])))
    return means, max(_LEAST_DENSITY, _LEAST_SIGNIFICANCE * noise)


def _find_seeds(bars: BarMap, means: NDArray[np.float32], least: float) -> list[complex]:
    """Return places in the middle of straight bars, strongest first."""
    entry = means.max(axis=1)
    least = max(least, _SLANTING * float(entry.max()))
    apart = max(2, round(_APART * bars.needle_px))
    seeds: list[complex] = []
    while len(seeds) < _MAX_SEEDS and entry.max() >= least:
        row = int(entry.argmax())
        seeds.append(complex(float(means[row].argmax()), row))
        entry[max(0, row - apart) : row + apart + 1] = 0.0
    return seeds


def _trace_from(bars: BarMap, seed: complex) -> Trace:
    back, back_responses = _follow(bars, seed, np.pi)
    places, responses = _follow(bars, seed, 0.0)
    hidden_px = 0.0
    for _ in range(_MOST_WALLS):
        again = _find_again(bars, places, responses)
        if again is None:
            break
        start, heading = again
        behind, behind_responses = _follow(bars, start, heading)
        hidden_px = max(hidden_px, abs(start - places[-1]))
        places, responses = np.concatenate((places, behind)), np.concatenate((responses, behind_responses))
    return Trace(
        bars.full_px(np.concatenate((back[:0:-1], places))),
        np.concatenate((back_responses[:0:-1], responses)),
        float(np.median(responses)),
        hidden_px / bars.px_per_mm,
    )


def _find_again(
    bars: BarMap, places: NDArray[np.complex128], responses: FloatArray
) -> tuple[complex, float] | None:
    """Return place and heading at which a shaft goes on; None if it does not."""
    last = places[-int(_HEADING_MM / _STEP_MM) :]
    if len(last) < _AGAIN_MM / _STEP_MM:
        return None
    heading = float(np.angle(last[-1] - last[len(last) // 2]))
    place, turned, share = _look_ahead(bars, last[-1], heading, float(np.median(responses[-_USUAL_STEPS:])))
    return (place, turned) if share >= _AGAIN else None


def _look_ahead(bars: BarMap, last: complex, heading: float, usual: float) -> tuple[complex, float, float]:
    """Return where ahead of a place a shaft is seen best over some length, its heading, and its share of a response."""
    samples = np.arange(_AGAIN_STEP_MM, _LONGEST_HIDDEN_MM + _AGAIN_MM, _AGAIN_STEP_MM)
    arcs, turns, curvatures = _make_arcs(
        _AGAIN_TURNS_RAD, _AGAIN_CURVATURES_PER_MM / bars.px_per_mm, samples * bars.px_per_mm
    )
    seen = np.minimum(bars.at(last + arcs * np.exp(1j * heading)) / max(usual, 1e-9), 1.0)
    count = round(_AGAIN_MM / _AGAIN_STEP_MM)
    sums = np.cumsum(np.pad(seen, ((0, 0), (1, 0))), axis=1)
    means = (sums[:, count:] - sums[:, :-count]) / count
    arc, first = np.unravel_index(int(np.argmax(means)), means.shape)
    turned = heading + turns[arc] + curvatures[arc] * samples[first] * bars.px_per_mm
    return complex(last + arcs[arc, first] * np.exp(1j * heading)), float(turned), float(means[arc, first])


def measure_beyond(bars: BarMap, tip: FloatArray, before: FloatArray) -> tuple[float, float]:
    """Return how strongly a shaft is seen to go on beyond its end, and how strongly where nothing goes on, at most.

    Each is the response over some length ahead, as a share of that before the end: the median over `before` (N, 2), the
    last places of the shaft in the turned picture; `tip` (2,) is the end. What lies beside it has nothing of the shaft.
    """
    last = bars.reduced(before)
    heading = float(np.angle(last[-1] - last[0]))
    usual, end = float(np.median(bars.at(last))), complex(bars.reduced(tip[None])[0])
    aside = 1j * np.exp(1j * heading) * bars.widest_px
    _, _, ahead = _look_ahead(bars, end, heading, usual)
    if ahead <= _LEAST_GOING_ON:
        return ahead, _LEAST_GOING_ON
    beside = (_look_ahead(bars, end + widths * aside, heading, usual)[2] for widths in _BESIDE)
    most = max(_LEAST_GOING_ON, _STANDS_OUT * max(beside))
    return ahead, min(most, _GOING_ON) if ahead * usual >= bars.least else most


def _make_arcs(
    turns: FloatArray, curvatures: FloatArray, lengths: FloatArray
) -> tuple[NDArray[np.complex128], FloatArray, FloatArray]:
    """Return the points of arcs (K, M) that leave along +u, their turns (K,) and curvatures (K,) [1/px]."""
    turns, curvatures = (a.ravel() for a in np.meshgrid(turns, curvatures))
    headings = turns[:, None] + 0.5 * curvatures[:, None] * lengths
    return lengths * np.exp(1j * headings), turns, curvatures


def _follow(bars: BarMap, seed: complex, heading: float) -> tuple[NDArray[np.complex128], FloatArray]:
    """Follow the shaft from `seed` until it ends; return places (N,) and responses (N,). Outside there is none."""
    lengths = np.linspace(0.0, _LOOK_MM * bars.px_per_mm, _LOOK_SAMPLES + 1)[1:]
    arcs, turns, curvatures = _make_arcs(_TURNS_RAD, _CURVATURES_PER_MM / bars.px_per_mm, lengths)
    penalty = _TURN_PENALTY_PER_RAD2 * turns**2
    step = _STEP_MM * bars.px_per_mm
    place, places = seed, [seed]
    usual = float(bars.at(np.array([seed]))[0])
    responses, headings = [usual], [heading]
    last_strong = 0
    for _ in range(int(2 * sum(bars.any_direction.shape) / step)):
        seen = np.minimum(bars.at(place + arcs * np.exp(1j * heading)), 1.5 * usual)
        best = int(np.argmax(seen.sum(axis=1) / max(_LOOK_SAMPLES * usual, 1e-9) - penalty))
        turned = heading + turns[best]
        place = place + step * np.exp(1j * (turned + 0.5 * curvatures[best] * step))
        heading = turned + curvatures[best] * step
        places.append(place)
        headings.append(heading)
        if abs(heading - headings[max(len(headings) - 1 - _KINK_STEPS, 0)]) > _KINK_RAD:
            break
        responses.append(float(bars.at(np.array([place]))[0]))
        if responses[-1] >= _WEAK * usual:
            last_strong = len(places) - 1
        elif (len(places) - 1 - last_strong) * _STEP_MM >= _GAP_MM:
            break
        usual = median(responses[-_USUAL_STEPS:])
    return np.array(places[: last_strong + 1]), np.array(responses[: last_strong + 1])
