"""The shaft straightened into a strip, its two edges in every row of it, and how far uneven light shifts them.

The rows of a strip lie a pixel apart along the shaft, its columns across it. A curved needle thus becomes a straight
bar, which can be smoothed along its length without distortion, and its edges are found in all rows at once. A grey
opening fills glints: bright stripes too narrow to be gel. An edge is where the grey value is half way between the
shaft's dark core and the gel on that side; the search runs from outside inwards, so that uneven light hardly moves the
edge. By how much is estimated from the picture itself: where a lamp beside the needle, a glint or a shadow brightens
one edge's own surroundings, that place moves, and the other edge stays: the centre line shifts across the needle. All
rows shift alike, so the scatter along the needle does not show it.

The steepest rise of an edge depends on the levels beside it and on nothing further away. The mean rise, weighted with
its square so that noise counts little, is a second place of the edge. It is taken from the mean profile of a stretch of
the shaft, because that of a row is too noisy. In rendered pictures lit from one side the distance between the two
middles of the edges followed the true shift with a correlation of 0.95 (180 pictures), and left 0.004 of 0.011 mm rms
unexplained.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_lsq_spline
from scipy.ndimage import map_coordinates

from labrig.vision.picture import Picture
from labrig.vision.shaft_trace import Widths

FloatArray = NDArray[np.float64]
_Strip = NDArray[np.float32]

# Fewest points of a guide.
LEAST_POINTS = 5
# Distance of the guide's knots along the shaft: the guide bends no faster than the shaft can.
_KNOTS_MM = 6.0
# Length of the last stretch, whose curvature the guide keeps beyond its points.
_LAST_ARC_MM = 8.0
# Smoothing along the shaft, and of the two levels, in needle diameters.
_ALONG = 0.25
_LEVELS_ALONG = 1.0
# Half width of the core, and range of the gel beyond the widest shaft, in needle diameters.
_CORE = 0.35
_GEL_FROM, _GEL_TO = 0.25, 0.9
_CORE_QUANTILE, _GEL_QUANTILE = 0.25, 0.6
# A row counts if its contrast reaches this share of the median contrast.
_LEAST_CONTRAST = 0.4


@dataclass(frozen=True, eq=False)
class Guide:
    """A smooth line through the picture, with one row per pixel of length.

    Attributes
    ----------
    places, normals : ndarray (N, 2)
        Pixels and unit normals, columns (u, v).
    """

    places: FloatArray
    normals: FloatArray

    def at(self, rows: FloatArray, offsets: FloatArray) -> FloatArray:
        """Return the pixels (M, 2) at `offsets` (M,) px along the normals of fractional `rows` (M,)."""
        grid = np.arange(len(self.places))
        columns = (
            np.interp(rows, grid, self.places[:, axis])
            + offsets * np.interp(rows, grid, self.normals[:, axis])
            for axis in (0, 1)
        )
        return np.column_stack(tuple(columns))

    def inside(self, width: int, height: int) -> "Guide":
        """Return the longest stretch of the guide that lies inside a picture of that size."""
        u, v = self.places.T
        out = np.flatnonzero((u < -0.5) | (u > width - 0.5) | (v < -0.5) | (v > height - 0.5))
        bounds = np.concatenate(([-1], out, [len(u)]))
        longest = int(np.argmax(np.diff(bounds)))
        kept = slice(bounds[longest] + 1, bounds[longest + 1])
        return Guide(self.places[kept], self.normals[kept])


@dataclass(frozen=True, eq=False)
class Edges:
    """The shaft's edges in every row of a strip.

    Attributes
    ----------
    left, right : ndarray (N,)
        Offsets from the guide [px]; undefined in rows that do not count.
    counts : ndarray of bool (N,)
    gel, core : ndarray (N,)
        Grey levels beside the shaft and in its core.
    """

    left: FloatArray
    right: FloatArray
    counts: NDArray[np.bool_]
    gel: FloatArray
    core: FloatArray

    @property
    def middle(self) -> FloatArray:
        """Offsets of the centre line from the guide [px]."""
        return 0.5 * (self.left + self.right)

    @property
    def width(self) -> FloatArray:
        """Distances between the edges [px]."""
        return self.right - self.left


def fit_guide(points: FloatArray, px_per_mm: float, before_mm: float, after_mm: float) -> Guide:
    """Return a smooth line through at least `LEAST_POINTS` points (M, 2) in order, extended before and after them.

    It is a cubic least-squares spline with knots some millimetres apart, so single points may be off. Before the points
    it is straight; after them it keeps the curvature of its last stretch.
    """
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    kept = np.concatenate(([True], np.diff(lengths) > 0.0))
    lengths, points = lengths[kept], points[kept]
    pieces = max(1, min(int(lengths[-1] / (_KNOTS_MM * px_per_mm)), len(points) // LEAST_POINTS))
    # Knots at points, so that every piece has enough points, however they are spread.
    inner = lengths[np.linspace(0, len(lengths) - 1, pieces + 1).round().astype(int)]
    knots = np.concatenate(([0.0] * 3, inner, [lengths[-1]] * 3))
    spline = make_lsq_spline(lengths, points, knots, k=3)
    rows = np.arange(0.0, lengths[-1], 1.0)
    places, tangents = (
        np.asarray(values @ [1.0, 1.0j], dtype=complex) for values in (spline(rows), spline(rows, nu=1))
    )
    tangents /= np.abs(tangents)
    last = min(len(rows) - 1, round(_LAST_ARC_MM * px_per_mm))
    turn = float(np.angle(tangents[-1] / tangents[-1 - last])) / max(last, 1)
    before = np.arange(-round(before_mm * px_per_mm), 0)
    after = np.arange(1, round(after_mm * px_per_mm) + 1)
    arc = tangents[-1] * np.exp(1j * turn * after)
    places = np.concatenate((places[0] + before * tangents[0], places, places[-1] + np.cumsum(arc)))
    normals = 1j * np.concatenate((np.repeat(tangents[0], len(before)), tangents, arc))
    return Guide(_columns(places), _columns(normals))


def _columns(values: NDArray[np.complex128]) -> FloatArray:
    return np.column_stack((values.real, values.imag))


def straighten(picture: Picture, guide: Guide, widths: Widths) -> _Strip:
    """Return the strip (N, 2 K + 1) of grey values along the guide; the guide is in column K."""
    reach = int(np.ceil(0.5 * widths.widest_px + _GEL_TO * widths.needle_px))
    offsets = np.arange(-reach, reach + 1)
    u, v = (guide.places[:, a, None] + guide.normals[:, a, None] * offsets for a in (0, 1))
    strip = cv2.remap(
        picture, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(strip, dtype=np.float32)


def smooth_rows(strip: _Strip, sigma_px: float) -> _Strip:
    """Return the strip smoothed along the shaft."""
    return np.asarray(
        cv2.GaussianBlur(strip, (1, 2 * int(np.ceil(3 * sigma_px)) + 1), sigmaX=0.0, sigmaY=sigma_px),
        dtype=np.float32,
    )


def _fill_glint(strip: _Strip, widths: Widths) -> _Strip:
    """Return the strip with narrow bright stripes filled to the grey value beside them (grey opening)."""
    across = np.ones((1, int(np.ceil(widths.glint_px)) | 1), np.uint8)
    return np.asarray(cv2.morphologyEx(strip, cv2.MORPH_OPEN, across), dtype=np.float32)


def find_edges(strip: _Strip, widths: Widths) -> Edges:
    """Return the edges in every row of a strip."""
    smooth = _fill_glint(smooth_rows(strip, _ALONG * widths.needle_px), widths)
    middle = strip.shape[1] // 2
    half = max(1, int(_CORE * widths.needle_px))
    core = _measure_level(smooth[:, middle - half : middle + half + 1], _CORE_QUANTILE, widths)
    sides = (smooth[:, middle::-1], smooth[:, middle:])
    first = measure_gel_onset(widths)
    gels = tuple(_measure_level(side[:, first:], _GEL_QUANTILE, widths) for side in sides)
    (left, left_found), (right, right_found) = (
        _find_outermost_crossing(side, 0.5 * (core + gel), first)
        for side, gel in zip(sides, gels, strict=True)
    )
    contrast = np.minimum(*gels) - core
    width = left + right
    found = left_found & right_found & (width > 0.4 * widths.needle_px) & (width < 1.3 * widths.widest_px)
    counts = found & (contrast > 0.0)
    usual = np.median(contrast[counts]) if counts.any() else 0.0
    return Edges(
        -left, right, counts & (contrast >= _LEAST_CONTRAST * usual), 0.5 * (gels[0] + gels[1]), core
    )


def measure_gel_onset(widths: Widths) -> int:
    """Return how far from the middle of a strip [px] gel is beside the widest shaft."""
    return int(np.ceil(0.5 * widths.widest_px + _GEL_FROM * widths.needle_px))


def take_sides(strip: _Strip, widths: Widths) -> tuple[_Strip, _Strip]:
    """Return the columns of a strip left and right of the widest shaft."""
    first = measure_gel_onset(widths)
    middle = strip.shape[1] // 2
    return strip[:, : middle - first + 1], strip[:, middle + first :]


def measure_gel_level(strip: _Strip, widths: Widths) -> FloatArray:
    """Return the grey level (N,) of the gel on both sides, row by row."""
    return np.asarray(np.median(np.hstack(take_sides(strip, widths)), axis=1), dtype=np.float64)


def measure_side_levels(strip: _Strip, widths: Widths) -> tuple[FloatArray, FloatArray]:
    """Return the grey level (N,) of the gel on the darker and on the brighter side, row by row."""
    left, right = (np.median(side, axis=1).astype(np.float64) for side in take_sides(strip, widths))
    return np.minimum(left, right), np.maximum(left, right)


def _measure_level(columns: _Strip, quantile: float, widths: Widths) -> FloatArray:
    """Return the grey level (N,) of some columns of a strip, smoothed along it."""
    index = int(quantile * (columns.shape[1] - 1) + 0.5)
    ranked = np.ascontiguousarray(np.partition(columns, index, axis=1)[:, index, None])
    return np.asarray(smooth_rows(ranked, _LEVELS_ALONG * widths.needle_px)[:, 0], dtype=np.float64)


def _find_outermost_crossing(
    side: _Strip, threshold: FloatArray, last: int
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return where (N,) the grey value last rises through the threshold before column `last`, and whether it does."""
    dark = side[:, :last] < threshold[:, None]
    column = last - 1 - np.argmax(dark[:, ::-1], axis=1)
    rows = np.arange(len(side))
    inner, outer = (side[rows, column + k].astype(np.float64) for k in (0, 1))
    rise = np.maximum(outer - inner, 1e-6)
    return column + np.clip((threshold - inner) / rise, 0.0, 1.0), np.asarray(dark.any(axis=1))


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


def split_light_shift(shift: FloatArray) -> tuple[float, FloatArray]:
    """Split measured shifts (N,) [px] into what the centre line is corrected by and what stays uncertain (N,).

    What all rows have in common, as far as it stands out of noise, is the light; how it differs from row to row is as
    likely a bubble, and is not corrected.
    """
    common = float(np.median(shift))
    common *= common**2 / (common**2 + _NOISE_PX**2)
    return _CORRECTED * common, shift - (1.0 - _UNCERTAIN) * common


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
    columns = strip.shape[1] // 2 + offsets[:, None] + side * aside
    rows = np.broadcast_to(np.arange(len(strip))[:, None], columns.shape)
    values = map_coordinates(strip, (rows, columns), np.float64, order=1, mode="nearest")
    firsts = np.flatnonzero(np.diff(stretch, prepend=-1))
    return np.asarray(np.add.reduceat(values, firsts, axis=0) / np.bincount(stretch)[:, None])


def _find_rise(profiles: FloatArray) -> FloatArray:
    """Return where (S,) [px] profiles (S, P) rise, from the place in their middle outwards."""
    weights = np.maximum(np.diff(profiles, axis=1), 0.0) ** 2
    places = np.linspace(-_REACH_PX + 0.5 * _STEP_PX, _REACH_PX - 0.5 * _STEP_PX, weights.shape[1])
    return np.asarray(weights @ places / np.maximum(weights.sum(axis=1), np.finfo(float).tiny))
