"""The crossings of the ruled lines on graph paper, to a fraction of a pixel, with their row and column.

The lines are followed by their phase from the clearest patch over the picture (`grid_seed`, `grid_tracking`), and the
profile across them tells which lines of the sheet were followed (`ruling`). The phase predicts each crossing, which is
then refined on its own; where lines are close, every few lines. From these crossings the grid grows outwards to the
edge of picture and paper: a crossing counts only if both of its lines run on to both sides.

Faint lines, blurred behind gel for instance, show few of the crossings that the windows let expect. Each crossing is
then located by longer stretches of its lines, over the next crossings. If these are few too, because the lines lie
under pen traces and printed dots, the ink is tried: colour and darkness together, without pixels far darker than any
line. What shows most of the crossings expected is used. Crossings that their neighbours contradict are left out.
"""

from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.grid_seed import Seed, find_fine_spacing_px, find_seeds
from labrig.vision.grid_tracking import TrackedGrid, track_grid
from labrig.vision.line_density import Density, blur, clip, halve, measure_darkness, measure_ink
from labrig.vision.picture import Picture
from labrig.vision.ruling import Ruling, read_ruling
from labrig.vision.second_grid import require_single_grid
from labrig.vision.second_ink import require_one_ink

_FloatArray = NDArray[np.float64]

# The picture and its halves, in the order in which they are searched: lines 3 to 25 px apart are found in each.
_LEVELS, _LEAST_LEVEL_PX = 4, 150
_LEVEL_ORDER = (1, 0, 2, 3)
_SEEDS_PER_LEVEL = 2
# A grid that was followed over less of the picture is used only if there is no clearer one.
_LARGE_SHARE, _LEAST_SHARE = 0.8, 0.03
# So many windows of a grid are even where no trace of ink disturbs it. Otherwise the next quantile clips the density.
_EVEN = 0.9
_CLIP_QUANTILES = (0.97, 0.9)
# Heavier lines are this much darker than others, at the most.
_HEAVIEST = 2.5
# Crossings are located this far apart or further [px]: where lines are closer, at every few lines.
_LEAST_DISTANCE_PX, _LARGEST_DISTANCE_PX = 14.0, 40.0
_MANY_CROSSINGS = 200
_LEAST_LINES = 5
# Largest distance of a crossing from its prediction, as a share of the distance between lines.
_LARGEST_SHIFT = 0.12
# Where the density is sampled across a line, in shares of a reach.
_ACROSS = np.linspace(-1.0, 1.0, 25)
# Further than this share of the reach from a line the paper is bare; nearer than this the line is measured.
_FLANK, _CORE = 0.7, 0.33
_ON_FLANKS = np.abs(_ACROSS) > _FLANK
# From the flanks' samples to the straight line through them, at all samples.
_FIT_FLANKS = np.linalg.pinv(np.vander(_ACROSS[_ON_FLANKS], 2)).T @ np.vander(_ACROSS, 2).T
_REFINEMENTS = 3
# Crossings that are sampled at once: the samples of so many stay in the processor's cache, which halves the time.
_BLOCK = 64
# Steps are averaged over this many cells to each side.
_STEP_REACH = 2
_MOST_TRIES = 4
# Least share of the crossings that the windows let expect, and the share below which lines are taken for faint.
_LEAST_CONFIRMED, _MANY_CONFIRMED = 0.25, 0.6
# Lines further apart than others by this factor are other lines: the least multiple is two.
_COARSER = 1.4
# Crossings that the grid may grow beyond the windows that were followed.
_MARGIN = 8
# A crossing is left out if it is this many times the median distance from where its neighbours predict it.
_OUTLIER = 4.0
# Cells around the one nearest to a window's middle.
_AROUND_WINDOW = tuple(product((-1, 0, 1), repeat=2))
_PAIRS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))


@dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of two families of ruled lines.

    Attributes
    ----------
    pixels : ndarray (N, 2)
        Pixels of the crossings (u, v).
    indices : ndarray of int (N, 2)
        Numbers of their lines in both families; neighbouring lines differ by one.
    pitch_px : float
        Median distance between the finest lines.
    step : int
        Difference of the indices of neighbouring crossings: above one if not every line was located.
    ruling : Ruling
        Which lines of the sheet are numbered.
    """

    pixels: _FloatArray
    indices: NDArray[np.int64]
    pitch_px: float
    step: int
    ruling: Ruling


@dataclass(frozen=True, eq=False)
class _Ring:
    """Crossings to refine: cells (N, 2), predicted pixels (N, 2), steps to the next crossings (N, 2, 2)."""

    cells: NDArray[np.int64]
    predicted: _FloatArray
    steps: _FloatArray


def find_crossings(image: Picture) -> Crossings:
    """Find the crossings of ruled lines in a picture of graph paper, dark on light.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)

    Raises
    ------
    MeasurementRefusedError
        If the picture shows no two families of evenly spaced lines, or the lines are too close together.
    """
    darkness = measure_darkness(image)
    try:
        return _find_crossings(image, darkness)
    except MeasurementRefusedError as refusal:
        fine_px = find_fine_spacing_px(darkness)
        if fine_px is None:
            raise
        raise MeasurementRefusedError(
            f"the finest lines in the picture are {fine_px:.1f} px apart, too close to tell each from the next",
            "come closer with the camera, or use one with more pixels, until they are 5 px apart or more",
        ) from refusal


def _find_crossings(image: Picture, darkness: Density) -> Crossings:
    best = _find_grid(darkness, image)
    if best is not None and best[1] >= _MANY_CONFIRMED:
        return best[0]
    # What the ink is refused for says nothing against a grid that darkness shows.
    with suppress(MeasurementRefusedError) if best is not None else nullcontext():
        ink = _find_grid(measure_ink(image), image)
        if ink is not None and (best is None or (ink[1] > best[1] and _is_as_fine(ink[0], best[0]))):
            return _doubt_fine_lines(ink[0])
    if best is not None:
        return best[0]
    raise MeasurementRefusedError(
        "no grid of ruled lines in the picture",
        "fill it with sharp, evenly lit graph paper, close enough that the nearest lines are 4 px apart or more",
    )


def _is_as_fine(ink: Crossings, found: Crossings) -> bool:
    """Return whether the smoothed ink shows lines as close as those that darkness shows."""
    return ink.pitch_px < _COARSER * found.pitch_px


def _doubt_fine_lines(found: Crossings) -> Crossings:
    """Return crossings of the smoothed ink: how thick its lines are says nothing about which lines they are."""
    return replace(found, ruling=replace(found.ruling, thickness=0.0))


def _find_grid(density: Density, image: Picture) -> tuple[Crossings, float] | None:
    """Return the crossings that a density shows, and which share of those expected they are; None for too few.

    Raises MeasurementRefusedError.
    """
    tracked = _track_best(density)
    if tracked is None:
        return None
    ruling = read_ruling(clip(density, _HEAVIEST), tracked)
    require_single_grid(clip(density, _HEAVIEST), tracked, ruling)
    require_one_ink(image, tracked, ruling, _HEAVIEST)
    found = _remove_outliers(_locate_crossings(density, tracked, ruling, _SHARP))
    expected = _expect_crossings(tracked, found, density.size)
    if len(found.pixels) < _MANY_CONFIRMED * expected:
        faint = _remove_outliers(_locate_crossings(clip(density), tracked, ruling, _FAINT))
        found = max(found, faint, key=lambda grid: len(grid.pixels))
    if len(found.pixels) < max(_LEAST_CONFIRMED * expected, _LEAST_LINES**2):
        return None
    return found, len(found.pixels) / expected


def _expect_crossings(tracked: TrackedGrid, located: Crossings, pixels: int) -> float:
    """Return how many crossings there would be if all windows were filled with them."""
    lines = located.step // located.ruling.hidden * np.array(located.ruling.steps)
    cell_px = float(np.median(1.0 / np.abs(np.linalg.det(tracked.waves)))) * float(lines.prod())
    return tracked.share * pixels / cell_px


def _track_best(density: Density) -> TrackedGrid | None:
    """Return the first grid that covers nearly the whole picture, or else the clearest.

    If a trace of ink, a needle for instance, disturbs even that, the density is clipped further.
    """
    best: TrackedGrid | None = None
    for quantile in _CLIP_QUANTILES:
        for found in _track_candidates(clip(density, quantile=quantile)):
            if best is None or found.clarity > best.clarity:
                best = found
            if best.even_share >= _LARGE_SHARE:
                return best
        if best is not None and best.even_share >= _EVEN * best.share:
            break
    return best if best is not None and best.even_share >= _LEAST_SHARE else None


def _track_candidates(density: Density) -> Iterator[TrackedGrid]:
    """Yield the grids that grow from the clearest patches of every level, then from the next clearest."""
    levels = halve(density, _LEVELS, _LEAST_LEVEL_PX)
    order = sorted(range(len(levels)), key=_LEVEL_ORDER.index)
    seeds: dict[int, list[Seed]] = {}
    for number, level in product(range(_SEEDS_PER_LEVEL), order):
        if level not in seeds:
            seeds[level] = find_seeds(levels[level])
        tracked = track_grid(levels[level], seeds[level][number]) if number < len(seeds[level]) else None
        if tracked is not None and tracked.is_square():
            yield tracked.enlarge(2**level)


@dataclass(frozen=True, eq=False)
class _Arms:
    """How much of the lines beside a crossing takes part.

    Attributes
    ----------
    along : ndarray
        Places along a line, on one side, in steps to the next crossing.
    reach_px, least_reach, most_reach : float
        Reach of a profile across a line, and its limits in distances between lines.
    least_contrast : float
        Of each arm of a crossing, as a share of the typical one.
    """

    along: _FloatArray
    reach_px: float
    least_reach: float
    most_reach: float
    least_contrast: float


_SHARP = _Arms(np.linspace(0.2, 0.45, 6), 5.0, 0.15, 0.45, 0.3)
# Faint lines, blurred behind gel, are averaged over the next crossings, between the lines that cross them there.
_FAINT = _Arms(np.concatenate([np.linspace(0.2, 0.8, 8) + step for step in range(3)]), 9.5, 0.33, 0.33, 0.2)


@dataclass(frozen=True, eq=False)
class _Located:
    """How crossings are located: every `lines` lines, by profiles of `reach` lines to both sides."""

    density: Density
    lines: int
    reach: float
    arms: _Arms

    def refine(self, ring: _Ring) -> tuple[_FloatArray, _FloatArray]:
        """Return the crossing of the two lines at each prediction (N, 2), and the contrasts of its arms (N, 4).

        Each line is located between its two flanks, beside the crossing, away from the other line.
        """
        found = ring.predicted.copy()
        for _ in range(_REFINEMENTS):
            for axis in (0, 1):
                across, along = ring.steps[:, axis] * (self.reach / self.lines), ring.steps[:, 1 - axis]
                arms = self._sample_arms(found, across, along)
                found = found + _locate_lines(arms.mean(axis=0))[:, None] * across
        contrasts = [
            _measure_depths(arm)
            for axis in (0, 1)
            for arm in self._sample_arms(
                found, ring.steps[:, axis] * (self.reach / self.lines), ring.steps[:, 1 - axis]
            )
        ]
        return found, np.column_stack(contrasts)

    def _sample_arms(self, centres: _FloatArray, across: _FloatArray, along: _FloatArray) -> _FloatArray:
        """Return the density across a line (2, N, samples), averaged along it on either side of the crossing."""
        blocks = [slice(first, first + _BLOCK) for first in range(0, len(centres), _BLOCK)]
        return np.concatenate(
            [self._sample_block(centres[block], across[block], along[block]) for block in blocks], axis=1
        )

    def _sample_block(self, centres: _FloatArray, across: _FloatArray, along: _FloatArray) -> _FloatArray:
        places = (np.array((-1.0, 1.0))[:, None] * self.arms.along).ravel()
        start = centres.T[..., None] + _ACROSS * across.T[..., None]
        beside = places * along.T[..., None]
        maps = np.empty((2, len(centres), len(_ACROSS), len(places)), dtype=np.float32)
        np.add(start[..., None], beside[:, :, None], out=maps, casting="same_kind")
        u, v = maps.reshape(2, len(centres), -1)
        drawn = cv2.remap(self.density, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        stretches = np.asarray(drawn).reshape(-1, len(self.arms.along))
        means = np.asarray(cv2.reduce(stretches, 1, cv2.REDUCE_AVG, dtype=cv2.CV_64F), dtype=np.float64)
        return means.reshape(len(centres), len(_ACROSS), 2).transpose(2, 0, 1)


def _locate_crossings(density: Density, tracked: TrackedGrid, ruling: Ruling, arms: _Arms) -> Crossings:
    """Return the crossings of the visible lines, numbered in the finest."""
    coordinates = (tracked.coordinates - ruling.offsets) / ruling.steps
    waves = tracked.waves / np.array(ruling.steps)[:, None]
    spacing_px = float(np.median(1.0 / np.linalg.norm(waves, axis=2)))
    lines = _choose_lines(spacing_px, ruling, tracked.share * density.size)
    steps = np.linalg.inv(waves).transpose(0, 2, 1) * lines
    start = _predict_around(tracked.pixels, coordinates / lines, steps)
    reach = float(np.clip(arms.reach_px / spacing_px, arms.least_reach, arms.most_reach))
    cells, pixels = _grow(_Located(blur(density, min(1.0, spacing_px / 8.0)), lines, reach, arms), start)
    step = lines * ruling.hidden
    return Crossings(pixels, cells * step, spacing_px / ruling.hidden, step, ruling)


def _predict_around(pixels: _FloatArray, coordinates: _FloatArray, steps: _FloatArray) -> _Ring:
    """Return the crossings around windows, each predicted by the nearest window.

    `coordinates` (N, 2) and `steps` (N, 2, 2) of the windows are counted and measured from crossing to crossing.
    """
    cells = (np.round(coordinates).astype(int)[:, None] + np.array(_AROUND_WINDOW)).reshape(-1, 2)
    window = np.repeat(np.arange(len(pixels)), len(_AROUND_WINDOW))
    away = cells - coordinates[window]
    order = np.argsort(np.sum(away**2, axis=1), kind="stable")
    rows, columns = (cells[order] - cells.min(axis=0)).T
    _, first = np.unique(rows * (int(columns.max()) + 1) + columns, return_index=True)
    chosen = order[first]
    steps = steps[window[chosen]]
    return _Ring(cells[chosen], pixels[window[chosen]] + np.einsum("na,nax->nx", away[chosen], steps), steps)


def _choose_lines(spacing_px: float, ruling: Ruling, ruled_px: float) -> int:
    """Return the number of lines from one located crossing to the next: heavier ones where lines are close.

    Not where the part of the picture that is ruled, `ruled_px` pixels, would have too few crossings of heavier ones.
    """
    least = int(np.ceil(_LEAST_DISTANCE_PX / spacing_px))
    if least == 1 or ruling.rhythm is None or ruling.hidden > 1:
        return least
    heavy = ruling.rhythm.heavy * int(np.ceil(least / ruling.rhythm.heavy))
    heavy_px = heavy * spacing_px
    return heavy if heavy_px <= _LARGEST_DISTANCE_PX and ruled_px >= _MANY_CROSSINGS * heavy_px**2 else least


def _grow(located: _Located, start: _Ring) -> tuple[NDArray[np.int64], _FloatArray]:
    """Return the cells (N, 2) and pixels (N, 2) of the crossings, from the first ones to the edge of the paper."""
    low = start.cells.min(axis=0) - _MARGIN
    places = np.full((*(start.cells.max(axis=0) - low + 1 + _MARGIN), 2), np.nan)
    tries = np.zeros(places.shape[:2], dtype=int)
    ring = replace(start, cells=start.cells - low)
    found, contrasts = located.refine(ring)
    least = located.arms.least_contrast * np.median(contrasts, axis=0)
    while True:
        near = np.linalg.norm(
            found - ring.predicted, axis=1
        ) * located.lines < _LARGEST_SHIFT * np.linalg.norm(ring.steps, axis=2).min(axis=1)
        good = near & (contrasts > least).all(axis=1)
        tries[tuple(ring.cells.T)] += 1
        places[tuple(ring.cells[good].T)] = found[good]
        ring = _predict_ring(places, tries, located.density.shape)
        if not len(ring.cells):
            break
        found, contrasts = located.refine(ring)
    cells = np.argwhere(np.isfinite(places[..., 0]))
    return cells + low, places[tuple(cells.T)]


def _predict_ring(places: _FloatArray, tries: NDArray[np.int_], shape: tuple[int, ...]) -> _Ring:
    """Return the unknown crossings next to known crossings, predicted by a local step from each neighbour.

    A cell is tried again, up to four times in all, when more of its neighbours are known.
    """
    known = np.argwhere(np.isfinite(places[..., 0]))
    if not len(known):
        return _Ring(np.empty((0, 2), dtype=int), np.empty((0, 2)), np.empty((0, 2, 2)))
    # Only the known part and a margin; the margin also keeps `np.roll` from bringing in the other side.
    low, high = np.maximum(known.min(axis=0) - 2, 0), np.minimum(known.max(axis=0) + 3, len(places))
    window = (slice(low[0], high[0]), slice(low[1], high[1]))
    steps = _average_steps(places[window])
    predicted, count = _extrapolate(places[window], steps)
    wanted = np.isnan(places[window][..., 0]) & (count > tries[window])
    wanted[[0, -1]] = wanted[:, [0, -1]] = False
    margin = 0.6 * np.abs(steps).sum(axis=2)
    limit = np.array([shape[1] - 1, shape[0] - 1])
    wanted &= ((predicted >= margin) & (predicted <= limit - margin)).all(axis=2)
    return _Ring(np.argwhere(wanted) + low, predicted[wanted], steps[wanted])


def _extrapolate(places: _FloatArray, steps: _FloatArray) -> tuple[_FloatArray, NDArray[np.int_]]:
    """Return the mean prediction of each cell from its known neighbours (R, C, 2), and their number (R, C)."""
    total = np.zeros_like(places)
    count = np.zeros(places.shape[:2], dtype=int)
    for axis, sign in product((0, 1), (1, -1)):
        near = np.roll(places, sign, axis=axis) + sign * steps[:, :, axis]
        seen = np.isfinite(near[..., 0])
        total[seen] += near[seen]
        count += seen
    return np.asarray(total / np.maximum(count, 1)[..., None]), count


def _average_steps(places: _FloatArray) -> _FloatArray:
    """Return the mean steps (R, C, 2, 2) to the next crossing along either axis over the cells around, or NaN."""
    means = []
    for axis in (0, 1):
        steps = places - np.roll(places, 1, axis=axis)
        pairs = np.isfinite(steps[..., 0])
        side = (2 * _STEP_REACH + 1, 2 * _STEP_REACH + 1)
        total = cv2.boxFilter(np.where(pairs[..., None], steps, 0.0), -1, side, normalize=False)
        count = cv2.boxFilter(pairs.astype(np.float64), -1, side, normalize=False)
        means.append(total / np.where(count > 0.5, count, np.nan)[..., None])
    return np.stack(means, axis=2)


def _locate_lines(profiles: _FloatArray) -> _FloatArray:
    """Return the lines' offsets (N,) from the middle of their profiles (N, S), in reaches."""
    bare = profiles - profiles[:, _ON_FLANKS] @ _FIT_FLANKS
    weight = bare * np.cos(0.5 * np.pi * _ACROSS) ** 2
    mass = weight.sum(axis=1)
    offset = (weight @ _ACROSS) / np.where(mass > 0.0, mass, np.inf)
    return np.asarray(np.clip(offset, -_FLANK, _FLANK))


def _measure_depths(profiles: _FloatArray) -> _FloatArray:
    """Return how much darker the lines (N,) are than their darker side: what lies beyond the paper is dark too."""
    sides = [profiles[:, side].mean(axis=1) for side in (_ACROSS < -_FLANK, _ACROSS > _FLANK)]
    return np.asarray(profiles[:, np.abs(_ACROSS) < _CORE].mean(axis=1) - np.maximum(*sides))


def _tabulate(found: Crossings) -> tuple[_FloatArray, NDArray[np.int64]]:
    """Return a table of the crossings' places (R, C, 2), and their cells (N, 2)."""
    # With a margin of unknown cells, `np.roll` does not make the first cells neighbours of the last.
    cells = (found.indices - found.indices.min(axis=0)) // found.step + 2
    places = np.full((*(cells.max(axis=0) + 3), 2), np.nan)
    places[tuple(cells.T)] = found.pixels
    return places, cells


def _measure_offsets(found: Crossings) -> _FloatArray:
    """Return the distances (N,) [px] of crossings from the middle between their neighbours; NaN without neighbours."""
    places, cells = _tabulate(found)
    pairs = [
        0.5 * (np.roll(places, pair, axis=(0, 1)) + np.roll(places, np.negative(pair), axis=(0, 1)))
        for pair in _PAIRS
    ]
    middles = np.array(pairs)[(slice(None), *cells.T)]
    seen = np.isfinite(middles[..., 0]).any(axis=0)
    middle = np.full(found.pixels.shape, np.nan)
    middle[seen] = np.nanmedian(middles[:, seen], axis=0)
    return np.asarray(np.linalg.norm(found.pixels - middle, axis=1))


def _remove_outliers(found: Crossings) -> Crossings:
    """Return the crossings that are not far from the middle between their neighbours."""
    if not len(found.pixels):
        return found
    off = _measure_offsets(found)
    seen = np.isfinite(off)
    kept = seen & (off <= _OUTLIER * np.median(off[seen])) if seen.any() else seen
    return replace(found, pixels=found.pixels[kept], indices=found.indices[kept])
