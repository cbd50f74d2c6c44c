"""How far uneven light may have shifted the shaft's centre line, estimated from the picture itself.

An edge is where the grey value is half way between the shaft's core and the gel (`shaft_edges`). Where a lamp beside
the needle, a glint or a shadow brightens one edge's own surroundings, that place moves, and the other edge stays: the
centre line shifts across the needle. All rows shift alike, so the scatter along the needle does not show it.

The steepest rise of an edge depends on the levels beside it and on nothing further away. The mean rise, weighted with
its square so that noise counts little, is a second place of the edge. It is taken from the mean profile of a stretch
of the shaft, because that of a row is too noisy. In rendered pictures lit from one side the distance between the two
middles of the edges followed the true shift with a correlation of 0.95 (180 pictures), and left 0.004 of 0.011 mm rms
unexplained.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.vision.shaft_edges import Edges, FloatArray

# In even light the median measured shift of the centre line is 0.002 to 0.011 px in drawn pictures, and up to 0.025 px
# among bubbles [px].
_NOISE_PX = 0.02
# The centre line is corrected by the first share of the shift that all rows have in common. Of drawn needles the true
# shift is 0.6 of the measured one if the steel is brighter at one edge, and 1.0 to 1.15 under a lamp: the second share
# stays uncertain.
_CORRECTED, _UNCERTAIN = 0.8, 0.3
# Length over which the profile is averaged, and reach and step of the profile on either side of an edge [px].
_STRETCH_MM = 3.0
_REACH_PX = 3.0
_STEP_PX = 0.25


@dataclass(frozen=True, eq=False)
class LightShift:
    """By how much [px] rows are corrected for uneven light, and by how much (N,) it may still shift them."""

    corrected: float
    left: FloatArray


def split_light_shift(shift: FloatArray) -> LightShift:
    """Split measured shifts (N,) into what the centre line is corrected by and what stays uncertain.

    What all rows have in common, as far as it stands out of noise, is the light; how it differs from row to row is as
    likely a bubble, and is not corrected.
    """
    common = float(np.median(shift))
    common *= common**2 / (common**2 + _NOISE_PX**2)
    return LightShift(_CORRECTED * common, shift - (1.0 - _UNCERTAIN) * common)


def measure_light_shift(
    strip: NDArray[np.float32], edges: Edges, rows: NDArray[np.bool_], px_per_mm: float
) -> FloatArray:
    """Return by how much (N,) [px] the edges' steepest rises lie aside of their half levels, on average of both.

    It is positive towards the right edge, constant over each stretch, and zero in rows that are not selected.

    Parameters
    ----------
    strip : ndarray of float32 (N, 2 K + 1)
    edges : Edges
        Of that strip.
    rows : ndarray of bool (N,)
        Rows of the needle.
    """
    chosen = np.flatnonzero(rows)
    stretch = ((chosen - chosen[0]) / (_STRETCH_MM * px_per_mm)).astype(np.intp)
    # The last stretch is seldom a whole one, so it belongs to the one before it.
    stretch = np.minimum(stretch, max(int(stretch[-1]) - 1, 0))
    stretch = np.unique(stretch, return_inverse=True)[1]
    left, right = (
        _find_rise(_average_profile(strip[chosen], offsets[chosen], side, stretch))
        for side, offsets in ((-1, edges.left), (1, edges.right))
    )
    shift = np.zeros(len(strip))
    shift[chosen] = (0.5 * (right - left))[stretch]
    return shift


def _average_profile(
    strip: NDArray[np.float32], offsets: FloatArray, side: int, stretch: NDArray[np.intp]
) -> FloatArray:
    """Return the mean grey values (S, P) of each stretch from inside to outside of its edge."""
    aside = np.arange(-_REACH_PX, _REACH_PX + 0.5 * _STEP_PX, _STEP_PX)
    last = strip.shape[1] - 1
    columns = np.clip(last // 2 + offsets[:, None] + side * aside, 0.0, last)
    lower = np.minimum(columns.astype(np.intp), last - 1)
    part, row = columns - lower, np.arange(len(strip))[:, None]
    values = strip[row, lower] * (1.0 - part) + strip[row, lower + 1] * part
    firsts = np.flatnonzero(np.diff(stretch, prepend=-1))
    return np.asarray(np.add.reduceat(values, firsts, axis=0) / np.bincount(stretch)[:, None])


def _find_rise(profiles: FloatArray) -> FloatArray:
    """Return where (S,) [px] profiles (S, P) rise, from the place in their middle outwards."""
    weights = np.maximum(np.diff(profiles, axis=1), 0.0) ** 2
    places = np.linspace(-_REACH_PX + 0.5 * _STEP_PX, _REACH_PX - 0.5 * _STEP_PX, weights.shape[1])
    return np.asarray(weights @ places / np.maximum(weights.sum(axis=1), np.finfo(float).tiny))
