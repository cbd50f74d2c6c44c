"""What a picture would show of a needle's shaft, without a picture, for insertions without pictures.

Path and widths are those of perspective, with the errors that the shaft has in rendered pictures. Along the shaft the
error of the width is an Ornstein-Uhlenbeck process; besides, the needle tapers, and looks wider towards the rim of the
picture, and length and end are off. The sizes in `ERRORS` were fitted to 200 pictures of the simulated rig, with the
seeds of `FITTED`. `python -m tests.benchmarks depth` fits them anew, and compares depths read from pictures with those
read from such shafts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from labrig.devices.rig_file import load_rig
from labrig.experiments.shared.rig_view import load_plane_map
from labrig.needle.kinematics import FloatArray
from labrig.simulation.description import LensDescription
from labrig.simulation.lens import camera_place_mm
from labrig.simulation.parallax import see_points
from labrig.vision.error_budget import PlaceErrors
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import ShaftTip

RIG = Path(__file__).parents[2] / "calibration" / "rig-simulated.yaml"
FITTED = range(7000, 7200)
_ROW_MM, _BLOCK_MM = 0.1, 3.0
# Widths are compared from so far behind the sheath to so many needle widths before the end.
_FROM_MM, _BEVEL = 4.0, 3.5


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
    place_sd_mm : float
        Of the end, along each axis.
    """

    width: float
    width_spread: float
    correlated_mm: float
    taper_sd: float
    rim: float
    length_mm: float
    length_sd_mm: float
    place_sd_mm: float


RIM_MM = 50.0
ERRORS = ShaftErrors(0.0050, 0.24, 1.27, 0.003, 0.006, 0.047, 0.085, 0.096)


@dataclass(frozen=True, eq=False)
class SeenPath:
    """A path as seen in the plane, (N, 2), its seen arc lengths, and its seen widths over the true, (N,)."""

    places_mm: FloatArray
    arcs_mm: FloatArray
    scales: FloatArray

    @classmethod
    def of(cls, path_mm: Sequence[Sequence[float]], lens: LensDescription) -> "SeenPath":
        """Return how a path in space (N, 3) is seen."""
        places, scales = see_points(np.array(path_mm), lens)
        steps_mm = np.linalg.norm(np.diff(places, axis=0), axis=1)
        return cls(places, np.concatenate(([0.0], np.cumsum(steps_mm))), scales)

    @property
    def length_mm(self) -> float:
        """The seen length."""
        return float(self.arcs_mm[-1])


@cache
def load_plane() -> PlaneMap:
    """Return the plane map of the simulated rig."""
    return load_plane_map(load_rig(RIG))


def draw_shaft(
    path_mm: Sequence[Sequence[float]],
    lens: LensDescription,
    diameter_mm: float,
    noise: np.random.Generator,
    errors: ShaftErrors = ERRORS,
) -> ShaftTip:
    """Return a shaft as measured in a picture of a needle with this path (N, 3), the sheath's end first."""
    plane, seen = load_plane(), SeenPath.of(path_mm, lens)
    at_mm = np.arange(0.0, seen.length_mm, _ROW_MM)
    places_mm = np.column_stack([np.interp(at_mm, seen.arcs_mm, line) for line in seen.places_mm.T])
    wider = (
        errors.rim * _square_distances(places_mm, lens)
        + noise.normal(0.0, errors.taper_sd) * (at_mm / seen.length_mm - 0.5)
        + _draw_rough(len(at_mm), noise, errors)
    )
    widths_mm = diameter_mm * np.interp(at_mm, seen.arcs_mm, seen.scales) * (1.0 + wider)
    length_mm = seen.length_mm + noise.normal(errors.length_mm, errors.length_sd_mm)
    y, z = seen.places_mm[-1] + noise.normal(0.0, errors.place_sd_mm, 2)
    pixels = plane.to_px(np.array([[y, z]]))[0]
    forward = seen.places_mm[-1] - seen.places_mm[-2]
    return ShaftTip(
        tip_px=(float(pixels[0]), float(pixels[1])),
        tip_mm=(float(y), float(z)),
        heading_rad=math.atan2(*forward),
        length_mm=length_mm,
        width_px=float(np.median(widths_mm)) / plane.mm_per_px,
        centre_line_mm=places_mm,
        centre_line_px=plane.to_px(places_mm),
        arc_mm=at_mm * (length_mm / seen.length_mm),
        widths_mm=widths_mm,
        errors=PlaceErrors(fit_mm=errors.place_sd_mm),
    )


def _square_distances(places_mm: FloatArray, lens: LensDescription) -> FloatArray:
    """Return the squares of the distances of places (N, 2) from the camera's foot over that of `RIM_MM`, (N,)."""
    _, *foot = camera_place_mm(lens)
    return np.asarray(np.sum((places_mm - foot) ** 2, axis=1) / RIM_MM**2)


def _draw_rough(rows: int, noise: np.random.Generator, errors: ShaftErrors) -> FloatArray:
    """Return the errors of the widths of rows, (rows,)."""
    sd = errors.width * math.exp(errors.width_spread * noise.standard_normal())
    kept = math.exp(-_ROW_MM / errors.correlated_mm)
    drawn = noise.standard_normal(rows) * sd * math.sqrt(1.0 - kept**2)
    drawn[0] = sd * noise.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -kept], drawn))


@dataclass(frozen=True)
class ShaftResiduals:
    """What a measured shaft is off by: see `ShaftErrors`.

    row, block : variance of the width, as a share, and of its medians over `_BLOCK_MM`; over_mm : compared length;
    end_mm : along the needle.
    """

    row: float
    block: float
    over_mm: float
    taper: float
    rim: float
    length_mm: float
    end_mm: float


def compare_shaft(end: ShaftTip, path_mm: Sequence[Sequence[float]], lens: LensDescription) -> ShaftResiduals:
    """Return by how much a measured shaft is off the needle that a picture was drawn of."""
    seen = SeenPath.of(path_mm, lens)
    usual_mm = float(np.median(end.widths_mm))
    counts = (end.arc_mm >= _FROM_MM) & (end.arc_mm < end.length_mm - _BEVEL * usual_mm)
    arcs_mm = end.arc_mm[counts]
    scales = np.interp(arcs_mm * (seen.length_mm / end.length_mm), seen.arcs_mm, seen.scales)
    ratios = end.widths_mm[counts] / scales
    squares = _square_distances(end.centre_line_mm[counts], lens)
    rim, level = np.polyfit(squares, ratios, 1)
    straight = ratios / (1.0 + ERRORS.rim * squares)
    rough = straight / straight.mean() - 1.0
    number = ((arcs_mm - _FROM_MM) / _BLOCK_MM).astype(int)
    blocks = [float(np.median(rough[number == index])) for index in range(int(number.max()))]
    along = seen.places_mm[-1] - seen.places_mm[-4]
    along = along / np.linalg.norm(along)
    off_mm = np.array(end.tip_mm) - seen.places_mm[-1]
    return ShaftResiduals(
        float(np.var(rough)),
        float(np.var(blocks)),
        float(arcs_mm[-1] - arcs_mm[0]),
        float(np.polyfit(arcs_mm / end.length_mm, rough, 1)[0]),
        float(rim / level),
        end.length_mm - seen.length_mm,
        float(off_mm @ along),
    )


def fit_errors(residuals: Sequence[ShaftResiduals]) -> ShaftErrors:
    """Return the errors of shafts in pictures by what measured ones are off by.

    The correlated length is the one with which medians over a block scatter as they do, and the taper what is left of
    that seen without the part that such widths have by chance. The end counts along the needle only: across it the map
    of the plane is off, which is calibrated and not read.
    """
    rows = np.array([residual.row for residual in residuals])
    row, block = float(rows.mean()), float(np.mean([residual.block for residual in residuals]))
    lengths = np.linspace(0.05, 10.0, 400)
    ratio = lengths / _BLOCK_MM
    averaged = 2.0 * ratio * (1.0 - ratio * -np.expm1(-1.0 / ratio))
    correlated_mm = float(np.interp(block / row, averaged, lengths))
    by_chance = 24.0 * row * correlated_mm * np.mean([1.0 / residual.over_mm for residual in residuals])
    tapers = float(np.var([residual.taper for residual in residuals]))
    lengths_mm = [residual.length_mm for residual in residuals]
    return ShaftErrors(
        math.sqrt(row),
        float(np.std(0.5 * np.log(rows))),
        correlated_mm,
        math.sqrt(max(0.0, tapers - float(by_chance))),
        float(np.mean([residual.rim for residual in residuals])),
        float(np.mean(lengths_mm)),
        float(np.std(lengths_mm)),
        float(np.std([residual.end_mm for residual in residuals])),
    )
