"""The errors of shafts in pictures, as they are fitted for insertions without pictures.

`python -m tests.benchmarks depth` fits them anew, and compares depths read from pictures with those read from such
shafts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from labrig.devices.rig_file import load_rig
from labrig.runner.sight import load_plane_map
from labrig.runner.virtual_sight import SHAFT_ERRORS, locate_points, measure_arcs, square_distances
from labrig.simulation.description import LensDescription
from labrig.vision.out_of_plane import Perspective
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import ShaftTip

RIG = Path(__file__).parents[2] / "calibration" / "rig-simulated.yaml"
FITTED = range(7000, 7200)
_BLOCK_MM = 3.0
# Widths are compared from so far behind the sheath to so many needle widths before the end.
_FROM_MM, _BEVEL = 4.0, 3.5


@cache
def load_plane() -> PlaneMap:
    """Return the plane map of the simulated rig."""
    return load_plane_map(load_rig(RIG))


@dataclass(frozen=True)
class ShaftResiduals:
    """What a measured shaft is off by: see `ShaftErrors`.

    row, block : variance of the width, as a share, and of its medians over `_BLOCK_MM`; over_mm : compared length.
    """

    row: float
    block: float
    over_mm: float
    taper: float
    rim: float
    length_mm: float


def compare_shaft(end: ShaftTip, path_mm: Sequence[Sequence[float]], lens: LensDescription) -> ShaftResiduals:
    """Return by how much a measured shaft is off the needle that a picture was drawn of."""
    plane = load_plane()
    places_mm, seen_scales = locate_points(np.array(path_mm), lens, plane)
    seen_arcs_mm = measure_arcs(places_mm)
    usual_mm = float(np.median(end.widths_mm))
    counts = (end.arc_mm >= _FROM_MM) & (end.arc_mm < end.length_mm - _BEVEL * usual_mm)
    arcs_mm = end.arc_mm[counts]
    scales = np.interp(arcs_mm * (seen_arcs_mm[-1] / end.length_mm), seen_arcs_mm, seen_scales)
    ratios = end.widths_mm[counts] / scales
    squares = square_distances(end.centre_line_mm[counts], Perspective.of(plane))
    rim, level = np.polyfit(squares, ratios, 1)
    straight = ratios / (1.0 + SHAFT_ERRORS.rim * squares)
    rough = straight / straight.mean() - 1.0
    number = ((arcs_mm - _FROM_MM) / _BLOCK_MM).astype(int)
    blocks = [float(np.median(rough[number == index])) for index in range(int(number.max()))]
    return ShaftResiduals(
        float(np.var(rough)),
        float(np.var(blocks)),
        float(arcs_mm[-1] - arcs_mm[0]),
        float(np.polyfit(arcs_mm / end.length_mm, rough, 1)[0]),
        float(rim / level),
        float(end.length_mm - seen_arcs_mm[-1]),
    )


def fit_errors(residuals: Sequence[ShaftResiduals]) -> dict[str, float]:
    """Return those of the errors of shafts in pictures that do not depend on the last turn, by their names.

    The correlated length is the one with which medians over a block scatter as they do, and the taper what is left of
    that seen without the part that such widths have by chance.
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
    return {
        "width": math.sqrt(row),
        "width_spread": float(np.std(0.5 * np.log(rows))),
        "correlated_mm": correlated_mm,
        "taper_sd": math.sqrt(max(0.0, tapers - float(by_chance))),
        "rim": float(np.mean([residual.rim for residual in residuals])),
        "length_mm": float(np.mean(lengths_mm)),
        "length_sd_mm": float(np.std(lengths_mm)),
    }
