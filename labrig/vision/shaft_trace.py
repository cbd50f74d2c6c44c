"""The course of a dark shaft through a picture, to a fraction of its width: the start of the edge search.

The trace works on optical density, in which uneven light is an additive, slow term, in a picture reduced until the
needle is a few pixels wide. A bar of any direction shows there as the larger eigenvalue of the Hessian. A fan of short
arcs follows the shaft. Each arc is judged by the bars under its whole length, so that a bubble or a weak stretch does
not divert the trace.

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
# The shaft is searched for this close to the border where it enters, as a straight bar of this length.
_ENTRY_MM = 20.0
_ENTRY_BAR_MM = 4.0
# A bar must stand out of the picture's own texture by this many standard deviations, and by this density.
_LEAST_SIGNIFICANCE = 6.0
_LEAST_DENSITY = 0.05
# A bar at the entry weaker than this share of the strongest is an old track, not a shaft.
_RIVAL = 0.5
_MAX_CANDIDATES = 4
# Least distance between two candidates, in needle diameters.
_APART = 1.5
# The fan: its length, the step after each fan, and the arcs that it tries.
_LOOK_MM = 3.0
_STEP_MM = 1.0
_LOOK_SAMPLES = 10
_TURNS_RAD = np.linspace(-0.24, 0.24, 13)
_CURVATURES_PER_MM = np.array([-0.08, -0.04, 0.0, 0.04, 0.08])
_TURN_PENALTY = 0.08
# Below this share of the shaft's usual response a stretch is weak; a weak stretch of this length ends the trace.
_WEAK = 0.3
_GAP_MM = 2.0
_USUAL_STEPS = 12


@dataclass(frozen=True)
class Widths:
    """The stated widths of the shaft, in pixels."""

    needle_px: float
    widest_px: float
    px_per_mm: float

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
    strength : float
        Median response of the bar filter along the shaft, an optical density.
    """

    points: FloatArray
    strength: float


@dataclass(frozen=True, eq=False)
class _BarMap:
    """The response of the bar filter at each pixel of the reduced picture."""

    any_direction: NDArray[np.float32]
    along_insertion: NDArray[np.float32]
    factor: int
    px_per_mm: float

    def full_px(self, reduced: NDArray[np.complex128]) -> FloatArray:
        points = np.column_stack((reduced.real, reduced.imag))
        return (points + 0.5) * self.factor - 0.5

    def at(self, places: NDArray[np.complex128]) -> NDArray[np.float32]:
        """Return the response at places u + iv, zero outside the picture."""
        h, w = self.any_direction.shape
        u, v = np.rint(places.real).astype(np.intp), np.rint(places.imag).astype(np.intp)
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
        response = self.any_direction[np.where(inside, v, 0), np.where(inside, u, 0)]
        return np.where(inside, response, np.float32(0.0))


def trace_shafts(picture: Picture, widths: Widths) -> tuple[Trace, ...]:
    """Follow every shaft that enters at the left border of a turned grey picture, strongest first.

    Parameters
    ----------
    picture : ndarray of uint8 (H, W)
        The insertion points right.
    widths : Widths
        Right within a factor of about 1.5.

    Raises
    ------
    MeasurementRefusedError
        If nothing dark and long enters at that border.
    """
    bars = _filter_bars(picture, widths)
    traces = [_trace_from(bars, seed) for seed in _find_seeds(bars, widths.needle_px / bars.factor)]
    return tuple(sorted(traces, key=lambda trace: -trace.strength * np.sqrt(len(trace.points))))


def _filter_bars(picture: Picture, widths: Widths) -> _BarMap:
    if widths.needle_px < _LEAST_WIDTH_PX:
        raise MeasurementRefusedError(
            f"the needle is {widths.needle_px:.1f} pixels wide, and {_LEAST_WIDTH_PX} is the least: use a closer view"
        )
    factor = max(1, round(widths.needle_px / _REDUCED_WIDTH_PX))
    h, w = (side // factor for side in picture.shape)
    if min(h, w) < _LEAST_SIDE_PX:
        raise MeasurementRefusedError(
            f"the picture is {picture.shape[1]} x {picture.shape[0]} pixels, too few to show a needle"
        )
    whole = picture[: h * factor, : w * factor]
    reduced = cv2.resize(whole, (w, h), interpolation=cv2.INTER_AREA) if factor > 1 else whole
    glint = int(np.ceil(widths.glint_px / factor)) | 1
    reduced = cv2.morphologyEx(reduced, cv2.MORPH_OPEN, np.ones((glint, glint), np.uint8))
    density = -np.log(reduced.astype(np.float32) + np.float32(_DARK_OFFSET))
    across, along, mixed = _differentiate_twice(density, _BAR_SIGMA * widths.needle_px / factor)
    mean, half = 0.5 * (across + along), 0.5 * (across - along)
    ridge = np.sqrt(half * half + mixed * mixed) - mean
    return _BarMap(np.maximum(ridge, 0.0), -across, factor, widths.px_per_mm / factor)


def _differentiate_twice(density: NDArray[np.float32], sigma: float) -> tuple[NDArray[np.float32], ...]:
    """Return the second derivatives (across, along, mixed) of the smoothed picture, times sigma squared."""
    half = int(np.ceil(3.5 * sigma))
    x = np.arange(-half, half + 1)
    smooth = np.exp(-0.5 * (x / sigma) ** 2)
    smooth /= smooth.sum()
    first = -x / sigma * smooth
    second = ((x / sigma) ** 2 - 1.0) * smooth
    second -= second.mean()
    kernels = ((smooth, second), (second, smooth), (first, first))
    return tuple(
        np.asarray(
            cv2.sepFilter2D(density, cv2.CV_32F, kx, ky, borderType=cv2.BORDER_REFLECT), dtype=np.float32
        )
        for kx, ky in kernels
    )


def _find_seeds(bars: _BarMap, needle_px: float) -> list[complex]:
    """Return places in the middle of straight bars near the border, strongest first."""
    length = max(3, round(_ENTRY_BAR_MM * bars.px_per_mm))
    reach = min(bars.along_insertion.shape[1], round(_ENTRY_MM * bars.px_per_mm))
    means = cv2.blur(bars.along_insertion, (length, 1), borderType=cv2.BORDER_REFLECT)
    least = max(_LEAST_DENSITY, _LEAST_SIGNIFICANCE * 1.4826 * float(np.median(np.abs(means))))
    entry = means[:, :reach].max(axis=1)
    apart = max(2, round(_APART * needle_px))
    seeds: list[complex] = []
    strongest = max(float(entry.max()), 0.0)
    while len(seeds) < _MAX_CANDIDATES:
        row = int(entry.argmax())
        if entry[row] < max(least, _RIVAL * strongest):
            break
        seeds.append(complex(float(means[row, :reach].argmax()), row))
        entry[max(0, row - apart) : row + apart + 1] = 0.0
    if not seeds:
        raise MeasurementRefusedError(
            "nothing dark and straight enters the picture: the best bar has an optical density of "
            f"{strongest:.3f}, and {least:.3f} is needed to stand out"
        )
    return seeds


def _trace_from(bars: _BarMap, seed: complex) -> Trace:
    back, _ = _follow(bars, seed, np.pi)
    forth, response = _follow(bars, seed, 0.0)
    places = np.concatenate((back[:0:-1], forth))
    return Trace(bars.full_px(places), float(np.median(response)))


def _make_fan(px_per_mm: float) -> tuple[NDArray[np.complex128], NDArray[np.float64], NDArray[np.float64]]:
    """Return the points of the arcs (K, M) for a heading along +u, their turns (K,) and curvatures (K,) [1/px]."""
    turns, curvatures = (a.ravel() for a in np.meshgrid(_TURNS_RAD, _CURVATURES_PER_MM / px_per_mm))
    lengths = np.linspace(0.0, _LOOK_MM * px_per_mm, _LOOK_SAMPLES + 1)[1:]
    headings = turns[:, None] + 0.5 * curvatures[:, None] * lengths
    return lengths * np.exp(1j * headings), turns, curvatures


def _follow(bars: _BarMap, seed: complex, heading: float) -> tuple[NDArray[np.complex128], FloatArray]:
    """Follow the shaft from `seed` until it ends or leaves the picture; return places (N,) and responses (N,)."""
    arcs, turns, curvatures = _make_fan(bars.px_per_mm)
    penalty = _TURN_PENALTY * (turns / _TURNS_RAD[-1]) ** 2
    step = _STEP_MM * bars.px_per_mm
    h, w = bars.any_direction.shape
    place, places = seed, [seed]
    usual = float(bars.at(np.array([seed]))[0])
    responses = [usual]
    last_strong = 0
    for _ in range(int(2 * (w + h) / step)):
        seen = np.minimum(bars.at(place + arcs * np.exp(1j * heading)), 1.5 * usual)
        best = int(np.argmax(seen.mean(axis=1) / max(usual, 1e-9) - penalty))
        turned = heading + turns[best]
        place = place + step * np.exp(1j * (turned + 0.5 * curvatures[best] * step))
        heading = turned + curvatures[best] * step
        if not (-0.5 <= place.real <= w - 0.5 and -0.5 <= place.imag <= h - 0.5):
            break
        places.append(place)
        responses.append(float(bars.at(np.array([place]))[0]))
        if responses[-1] >= _WEAK * usual:
            last_strong = len(places) - 1
        elif (len(places) - 1 - last_strong) * _STEP_MM >= _GAP_MM:
            break
        usual = median(responses[-_USUAL_STEPS:])
    return np.array(places[: last_strong + 1]), np.array(responses[: last_strong + 1])
