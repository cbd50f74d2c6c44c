"""What a picture would show of a needle's shaft, without a picture.

Along the shaft the error of the width is an Ornstein-Uhlenbeck process; besides, the needle tapers, and looks wider
towards the rim of the picture, and length and end are off. `python -m tests.benchmarks depth` fits `SHAFT_ERRORS` anew,
and compares depths read from pictures with those read from such shafts.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from labrig.needle.kinematics import FloatArray
from labrig.vision.error_budget import PlaceErrors
from labrig.vision.perspective import Perspective
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import ShaftTip

RIM_MM = 50.0
"""Distance from the camera's foot at which `ShaftErrors.rim` is stated."""

_ROW_MM = 0.1
_END_POINTS = 4


@dataclass(frozen=True)
class ShaftErrors:
    """Errors of a shaft in a picture.

    Attributes
    ----------
    width, width_spread : float
        Standard deviation of the width of a row, as a share of it, and that of its logarithm from picture to picture.
    correlated_mm : float
        Length over which the error of the width decays to 1/e.
    taper_sd : float
        Standard deviation of the change of width from end to end that is not depth, as a share of it.
    rim : float
        By how much it looks wider `RIM_MM` from the camera's foot, as a share; this grows with the squared distance.
    length_mm, length_sd_mm : float
        Of the seen length.
    ends_mm : tuple of (float, float, float)
        Lengths inserted since the bevel was turned, and the mean error of the end there: along the needle, and towards
        the side to which it bends, interpolated in between: a parabola that is fitted to the last stretch does not
        follow a bend that swings over.
    along_sd_mm, across_sd_mm : float
        Standard deviations about that.
    told_mm : float
        Standard deviation of the end's place along each axis, as the picture tells it.
    """

    width: float
    width_spread: float
    correlated_mm: float
    taper_sd: float
    rim: float
    length_mm: float
    length_sd_mm: float
    ends_mm: tuple[tuple[float, float, float], ...]
    along_sd_mm: float
    across_sd_mm: float
    told_mm: float

    def find_end_mm(self, since_turn_mm: float) -> tuple[float, float]:
        """Return the mean error of the end so far after a turn, along the needle and towards its bend."""
        since, along, across = np.transpose(self.ends_mm)
        return float(np.interp(since_turn_mm, since, along)), float(np.interp(since_turn_mm, since, across))


SHAFT_ERRORS = ShaftErrors(
    width=0.0050,
    width_spread=0.24,
    correlated_mm=1.27,
    taper_sd=0.003,
    rim=0.006,
    length_mm=0.047,
    length_sd_mm=0.085,
    ends_mm=(
        (3.0, -0.16, -0.075),
        (5.4, -0.07, 0.010),
        (6.5, 0.01, 0.020),
        (8.0, 0.05, 0.045),
        (10.0, 0.03, 0.030),
    ),
    along_sd_mm=0.045,
    across_sd_mm=0.015,
    told_mm=0.066,
)
"""Widths and lengths are those of 200 pictures of the simulated rig, with the seeds 7000 to 7199; ends are those of the
last pictures in 40 runs of protocols/insertion.yaml, with the seeds 700001 to 700040."""


@dataclass(frozen=True, eq=False)
class SeenPath:
    """A path as seen in the plane, (N, 2), its seen arc lengths, and its seen widths over the true, (N,)."""

    places_mm: FloatArray
    arcs_mm: FloatArray
    scales: FloatArray

    @classmethod
    def of(cls, places_mm: FloatArray, scales: FloatArray) -> "SeenPath":
        """Return a path by where its points are seen (N, 2), and by their scales (N,)."""
        steps_mm = np.linalg.norm(np.diff(places_mm, axis=0), axis=1)
        return cls(places_mm, np.concatenate(([0.0], np.cumsum(steps_mm))), scales)

    @property
    def length_mm(self) -> float:
        """The seen length."""
        return float(self.arcs_mm[-1])


def draw_shaft(
    seen: SeenPath,
    plane: PlaneMap,
    diameter_mm: float,
    since_turn_mm: float,
    noise: np.random.Generator,
    *,
    errors: ShaftErrors = SHAFT_ERRORS,
) -> ShaftTip:
    """Return a shaft as measured in a picture of a needle with this path, the sheath's end first."""
    at_mm = np.arange(0.0, seen.length_mm, _ROW_MM)
    places_mm = np.column_stack([np.interp(at_mm, seen.arcs_mm, line) for line in seen.places_mm.T])
    wider = (
        errors.rim * square_distances(places_mm, Perspective.of(plane))
        + noise.normal(0.0, errors.taper_sd) * (at_mm / seen.length_mm - 0.5)
        + _draw_rough(len(at_mm), noise, errors)
    )
    widths_mm = diameter_mm * np.interp(at_mm, seen.arcs_mm, seen.scales) * (1.0 + wider)
    length_mm = seen.length_mm + noise.normal(errors.length_mm, errors.length_sd_mm)
    y, z = _draw_end(seen, errors.find_end_mm(since_turn_mm), noise, errors)
    pixels = plane.to_px(np.array([[y, z]]))[0]
    forward = seen.places_mm[-1] - seen.places_mm[-2]
    return ShaftTip(
        tip_px=(float(pixels[0]), float(pixels[1])),
        tip_mm=(y, z),
        heading_rad=math.atan2(*forward),
        length_mm=length_mm,
        width_px=float(np.median(widths_mm)) / plane.mm_per_px,
        centre_line_mm=places_mm,
        centre_line_px=plane.to_px(places_mm),
        arc_mm=at_mm * (length_mm / seen.length_mm),
        widths_mm=widths_mm,
        errors=PlaceErrors(fit_mm=errors.told_mm),
    )


def _draw_end(
    seen: SeenPath, mean_mm: tuple[float, float], noise: np.random.Generator, errors: ShaftErrors
) -> tuple[float, float]:
    """Return the end (y, z) of a shaft, read off by the mean along it and towards its bend, and at random."""
    forward = np.diff(seen.places_mm[-_END_POINTS:], axis=0)
    headings_rad = np.arctan2(*forward.T)
    side = math.copysign(1.0, headings_rad[-1] - headings_rad[0])
    along_mm, across_mm = noise.normal(
        (mean_mm[0], side * mean_mm[1]), (errors.along_sd_mm, errors.across_sd_mm)
    )
    sine, cosine = math.sin(headings_rad[-1]), math.cos(headings_rad[-1])
    y, z = seen.places_mm[-1]
    return float(y + along_mm * sine + across_mm * cosine), float(z + along_mm * cosine - across_mm * sine)


def square_distances(places_mm: FloatArray, perspective: Perspective | None) -> FloatArray:
    """Return the squares of the distances of places (N, 2) from the camera's foot over that of `RIM_MM`, (N,)."""
    if perspective is None:
        return np.zeros(len(places_mm))
    return np.asarray(np.sum((places_mm - perspective.foot_mm) ** 2, axis=1) / RIM_MM**2)


def _draw_rough(rows: int, noise: np.random.Generator, errors: ShaftErrors) -> FloatArray:
    """Return the errors of the widths of rows, (rows,)."""
    sd = errors.width * math.exp(errors.width_spread * noise.standard_normal())
    kept = math.exp(-_ROW_MM / errors.correlated_mm)
    drawn = noise.standard_normal(rows) * sd * math.sqrt(1.0 - kept**2)
    drawn[0] = sd * noise.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -kept], drawn))
