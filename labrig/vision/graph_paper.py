"""The crossings of the ruled lines on graph paper, to a fraction of a pixel, with their row and column.

The search starts in a small patch, where the lines are straight and evenly spaced: it finds the two directions in which
the picture changes most, then sums the darkness along each. The closest lines there set the pitch, so heavier lines
every 5 or 10 mm do not mislead it. From a crossing in that patch the grid grows outwards, ring by ring: the steps
between its neighbours predict each crossing, which is then refined on its own.

If the darkness alone shows no large grid, because the grid is faint or lies under pen traces and printed dots, the
search also uses the ink: colour and darkness together, without pixels far darker than any line, and with each line
averaged over a longer stretch. Of these grids the one wins in which most crossings lie evenly between their neighbours.

If only the heavier lines can be followed, the finer lines between them are counted in the mean over all cells, so that
all crossings are numbered in the finest lines. Crossings that their neighbours contradict are left out.
"""

from dataclasses import dataclass, replace
from itertools import pairwise, product

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.picture import Picture

_FloatArray = NDArray[np.float64]

# Half the side of the first patch, as shares of the picture's shorter side: in a smaller patch a slanted view is more
# even, and a larger patch holds enough lines of a coarse grid.
_PATCH_SHARES = (1.0 / 6.0, 1.0 / 12.0, 1.0 / 3.0)
_INK_PATCH_SHARES = (1.0 / 6.0, 1.0 / 3.0)
_PATCH_PX = (40, 160)
# Centres of the patches, as shares of the picture, the middle first.
_PATCH_PLACES = sorted(
    product((0.25, 0.5, 0.75), repeat=2), key=lambda at: abs(at[0] - 0.5) + abs(at[1] - 0.5)
)
_LEAST_LINES = 5
# Number of crossings above which no other patch is tried.
_ENOUGH = 400
_LEAST_PITCH_PX = 5.0
# Least depth of a line, as a share of the 90 % quantile: paper has lines of two or three weights.
_LEAST_DEPTH = 0.15
# Largest distance of a line or a crossing from its prediction, as a share of the pitch.
_LARGEST_SHIFT = 0.3
# Least contrast of the fainter line of a crossing, as a share of the contrast where the search began.
_LEAST_CONTRAST = 0.3
# Where the density is sampled around a crossing, in steps to the next crossing: across a line, and along it.
_ACROSS = np.linspace(-0.45, 0.45, 25)
_ALONG = np.array([-0.45, -0.35, -0.25, 0.25, 0.35, 0.45])
# Where fainter lines are searched for between two lines, in steps from the middle, and their least darkness as a share
# of the lines' own.
_BETWEEN = np.linspace(-0.4, 0.4, 81)
_FINER_LINE = 0.02
_MOST_CELLS = 2000
# Possible numbers of fine steps in a heavy step, and the least share of the profile between two lines they explain.
_SUBDIVISIONS = (5, 10)
_LEAST_EXPLAINED = 0.7
# The ink without traces: a pixel darker than this quantile of the picture by this factor is a trace. It is removed with
# its surroundings, and the rest is smoothed.
_INK_QUANTILE, _TRACE = 0.93, 1.8
_TRACE_MARGIN_PX = 3
_INK_BLUR_PX = 2.0
# Printed dots, remains of traces and noise disturb a crossing: its lines are then averaged over more steps.
_FAR_ALONG = np.concatenate([sign * (np.linspace(0.25, 0.75, 6) + k) for sign in (-1, 1) for k in range(3)])
_INK_SLOW_PX = 21
# A crossing is left out if it is this many times the median distance from where its neighbours predict it.
_OUTLIER = 4.0
# A crossing this close to where its neighbours predict it, in pitches, lies evenly.
_EVEN = 0.1
_PAIRS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
# Further than this from a line, across it, the paper is bare.
_FLANK = 0.32
_REFINEMENTS = 3
# Steps are averaged over this many cells to each side.
_STEP_REACH = 2


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
        Distance between neighbouring lines where the search began.
    step : int
        Difference of the indices of neighbouring crossings: above one if only heavier lines were followed.
    """

    pixels: _FloatArray
    indices: NDArray[np.int64]
    pitch_px: float
    step: int = 1


@dataclass(frozen=True, eq=False)
class _Seed:
    """The grid in a patch: a crossing (2,), and the steps to the next crossings as rows (2, 2)."""

    crossing: _FloatArray
    steps: _FloatArray

    @property
    def pitch_px(self) -> float:
        return float(np.linalg.norm(self.steps, axis=1).min())


@dataclass(frozen=True, eq=False)
class _Ring:
    """Crossings to refine: cells (N, 2), predicted pixels (N, 2), steps along either axis (N, 2, 2)."""

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
    darkness = _measure_darkness(_darkest_channel(image))
    found = _find_largest_grid(darkness)
    if found is None or _count(found) < _ENOUGH:
        others = (_refine_along_lines(darkness, found), _find_ink_grid(image))
        found = max((grid for grid in (found, *others) if grid is not None), key=_count_even, default=None)
    if found is None or _count(found) < _LEAST_LINES**2:
        raise MeasurementRefusedError(
            "no grid of ruled lines in the picture",
            "fill it with sharp, evenly lit graph paper, close enough that the nearest lines are "
            f"{_LEAST_PITCH_PX:.0f} px apart or more",
        )
    return _number_in_finest(darkness, _remove_outliers(found))


def _count(found: Crossings) -> int:
    return len(found.pixels)


def _count_even(found: Crossings) -> int:
    return int(np.sum(_measure_offsets(found) <= _EVEN * found.pitch_px))


def _darkest_channel(image: Picture) -> Picture:
    """Return the darkest channel, which shows lines of any colour on white paper."""
    return image if image.ndim == 2 else np.asarray(image.min(axis=2), dtype=np.uint8)


def _find_largest_grid(
    flat: NDArray[np.float32], shares: tuple[float, ...] = _PATCH_SHARES
) -> Crossings | None:
    """Return the grid with the most crossings of the grids grown from all patches."""
    largest: Crossings | None = None
    for share, place in product(shares, _PATCH_PLACES):
        seed = _find_seed(flat, np.array(place) * (flat.shape[1], flat.shape[0]), share)
        if seed is None:
            continue
        grown = _grow(flat, seed)
        if largest is None or _count(grown) > _count(largest):
            largest = grown
        if _count(largest) >= _ENOUGH:
            break
    return largest


def _find_ink_grid(image: Picture) -> Crossings | None:
    """Return the grid that the ink shows, without pen traces."""
    ink = _blur(_measure_ink(image), _INK_BLUR_PX)
    return _refine_along_lines(ink, _find_largest_grid(ink, _INK_PATCH_SHARES))


def _refine_along_lines(flat: NDArray[np.float32], found: Crossings | None) -> Crossings | None:
    """Refine crossings by their lines over several steps to both sides; None if there are too few."""
    if found is None or _count(found) < _LEAST_LINES**2:
        return None
    _, steps, cells = _tabulate(found)
    known = np.isfinite(steps[tuple(cells.T)]).all(axis=(1, 2))
    ring = _Ring(cells[known], found.pixels[known], steps[tuple(cells[known].T)])
    fine, _ = _refine(flat, ring, _FAR_ALONG)
    return Crossings(fine, found.indices[known], found.pitch_px)


def _measure_ink(image: Picture) -> NDArray[np.float32]:
    """Return the optical density of the lines, darkness and colour together, without pen traces."""
    darkness = _remove_slow_light(_density(_darkest_channel(image)))
    level = float(np.quantile(darkness, _INK_QUANTILE))
    side = np.ones((_TRACE_MARGIN_PX, _TRACE_MARGIN_PX), np.uint8)
    trace = cv2.dilate((darkness > _TRACE * level).astype(np.uint8), side) > 0
    # Bytes suffice for the median: a hundredth of density is less than any line.
    bytes_ = np.clip(128.0 + 100.0 * darkness, 0, 255).astype(np.uint8)
    around = (cv2.medianBlur(bytes_, _INK_SLOW_PX).astype(np.float32) - 128.0) / 100.0
    ink = np.where(trace, around, np.minimum(darkness, level))
    if image.ndim == 3:
        colour = _remove_slow_light(_density(image[..., 1]) - _density(image[..., 2]))
        most = float(np.quantile(colour, _INK_QUANTILE))
        ink += np.where(trace, 0.0, np.clip(colour, -most, most))
    return np.asarray(ink, dtype=np.float32)


def _density(channel: Picture) -> NDArray[np.float32]:
    return np.asarray(-np.log(np.maximum(channel.astype(np.float32), 1.0)), dtype=np.float32)


def _remove_slow_light(density: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the density without uneven light, its slowly varying part."""
    slow = cv2.GaussianBlur(density, (0, 0), max(min(density.shape) / 40.0, 8.0))
    return np.asarray(density - slow, dtype=np.float32)


def _blur(density: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(density, (0, 0), sigma_px), dtype=np.float32)


def _tabulate(found: Crossings) -> tuple[_FloatArray, _FloatArray, NDArray[np.int64]]:
    """Return a table of the crossings' places (R, C, 2), the steps between them (R, C, 2, 2), their cells (N, 2)."""
    # With a margin of unknown cells, `np.roll` does not make the first cells neighbours of the last.
    cells = found.indices - found.indices.min(axis=0) + 2
    places = np.full((*(cells.max(axis=0) + 3), 2), np.nan)
    places[tuple(cells.T)] = found.pixels
    return places, _average_steps(places), cells


def _measure_offsets(found: Crossings) -> _FloatArray:
    """Return the distances (N,) [px] of crossings from the middle between their neighbours; NaN without neighbours."""
    if not _count(found):
        return np.empty(0)
    places, _, cells = _tabulate(found)
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
    off = _measure_offsets(found)
    seen = np.isfinite(off)
    kept = seen & (off <= _OUTLIER * np.median(off[seen])) if seen.any() else seen
    return replace(found, pixels=found.pixels[kept], indices=found.indices[kept])


def _measure_darkness(grey: Picture) -> NDArray[np.float32]:
    """Return the optical density of the lines without uneven light."""
    return _blur(_remove_slow_light(_density(grey)), 1.0)


def _find_seed(flat: NDArray[np.float32], centre: _FloatArray, share: float) -> _Seed | None:
    """Return the grid around `centre`, or None if there is none."""
    reach = int(np.clip(min(flat.shape) * share, *_PATCH_PX))
    normals, offsets, pitches = [], [], []
    for angle in _find_normals(_cut_square(flat, centre, 0.0, reach)):
        found = _find_line_family(flat, centre, angle, reach)
        if found is None:
            return None
        fine, offset, pitch = found
        normals.append((np.cos(fine), np.sin(fine)))
        offsets.append(offset)
        pitches.append(pitch)
    inverse = np.linalg.inv(np.array(normals))
    return _Seed(crossing=centre + inverse @ offsets, steps=(inverse * pitches).T)


def _cut_square(
    flat: NDArray[np.float32], centre: _FloatArray, angle: float, reach: int
) -> NDArray[np.float32]:
    """Return the square around `centre`, turned so that `angle` runs along its rows."""
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin], [sin, cos]])
    affine = np.column_stack((turn, centre - turn @ (reach, reach)))
    side = 2 * reach + 1
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(flat, affine, (side, side), flags=flags, borderMode=cv2.BORDER_REFLECT_101)
    )


def _find_normals(patch: NDArray[np.float32]) -> tuple[float, float]:
    """Return the two directions [rad] in which a patch changes most, at least 50 degrees apart."""
    across, down = cv2.Sobel(patch, cv2.CV_32F, 1, 0), cv2.Sobel(patch, cv2.CV_32F, 0, 1)
    degrees = np.rad2deg(np.arctan2(down, across)) % 180.0
    weights = across**2 + down**2
    counts = np.bincount(degrees.ravel().astype(int) % 180, weights.ravel(), minlength=180)
    kernel = np.exp(-0.5 * (np.arange(-8, 9) / 3.0) ** 2)
    smooth = np.convolve(np.concatenate((counts[-8:], counts, counts[:8])), kernel, mode="valid")
    first = int(np.argmax(smooth))
    away = np.abs((np.arange(180) - first + 90) % 180 - 90) >= 50
    second = int(np.argmax(np.where(away, smooth, -1.0)))
    return float(np.deg2rad(first + 0.5)), float(np.deg2rad(second + 0.5))


def _find_line_family(
    flat: NDArray[np.float32], centre: _FloatArray, angle: float, reach: int
) -> tuple[float, float, float] | None:
    """Return the lines' normal [rad], the offset of one from `centre` [px], and their pitch [px]."""
    angles = angle + np.deg2rad(np.arange(-5.0, 5.01, 0.25))
    profiles = [_cut_square(flat, centre, turned, reach).mean(axis=0) for turned in angles]
    best = int(np.argmax([profile.var() for profile in profiles]))
    lines = _find_dark_lines(profiles[best].astype(np.float64))
    if len(lines) < _LEAST_LINES:
        return None
    pitch = float(np.median(np.diff(lines)))
    counts = np.round((lines - lines[0]) / pitch)
    even = np.abs(np.diff(lines) / pitch - 1.0) < _LARGEST_SHIFT
    if even.mean() < 0.75 or pitch < _LEAST_PITCH_PX:
        return None
    slope, start = np.polyfit(counts, lines, 1)
    middle = start + slope * np.round((reach - start) / slope)
    return float(angles[best]), float(middle - reach), float(slope)


def _find_dark_lines(profile: _FloatArray) -> _FloatArray:
    """Return the places of the lines in a profile of optical density [px], to a fraction of a pixel."""
    inner = profile[1:-1]
    tops = np.flatnonzero((inner > profile[:-2]) & (inner >= profile[2:])) + 1
    if len(tops) < _LEAST_LINES:
        return np.empty(0)
    valleys = np.array([profile[a:b].min() for a, b in pairwise(tops)])
    # The outermost tops have a valley on one side only.
    depths = profile[tops] - np.maximum(np.append(valleys, valleys[-1]), np.insert(valleys, 0, valleys[0]))
    tops = tops[depths >= _LEAST_DEPTH * np.quantile(depths, 0.9)]
    before, at, after = profile[tops - 1], profile[tops], profile[tops + 1]
    return np.asarray(tops + 0.5 * (before - after) / (before - 2.0 * at + after))


def _grow(flat: NDArray[np.float32], seed: _Seed) -> Crossings:
    """Grow the grid from its seed to its edge in the picture."""
    # Leave room for a grid that perspective makes wider by half.
    half = int(1.5 * np.hypot(*flat.shape) / seed.pitch_px) + 4
    places = np.full((2 * half + 1, 2 * half + 1, 2), np.nan)
    tries = np.zeros(places.shape[:2], dtype=int)
    start = np.array(list(product((-1, 0, 1), repeat=2)))
    ring = _Ring(
        start + half, seed.crossing + start @ seed.steps, np.broadcast_to(seed.steps, (len(start), 2, 2))
    )
    least = _LEAST_CONTRAST * float(np.median(_refine(flat, ring)[1]))
    while len(ring.cells):
        found, contrast = _refine(flat, ring)
        pitch = np.linalg.norm(ring.steps, axis=2).min(axis=1)
        good = (np.linalg.norm(found - ring.predicted, axis=1) < _LARGEST_SHIFT * pitch) & (contrast > least)
        tries[tuple(ring.cells.T)] += 1
        places[tuple(ring.cells[good].T)] = found[good]
        ring = _predict_ring(places, tries, flat.shape)
    cells = np.argwhere(np.isfinite(places[..., 0]))
    return Crossings(places[tuple(cells.T)], cells - half, seed.pitch_px)


def _predict_ring(places: _FloatArray, tries: NDArray[np.int_], shape: tuple[int, ...]) -> _Ring:
    """Return the unknown crossings next to known crossings, predicted by a local step from each neighbour.

    A cell is tried again, up to four times, when more of its neighbours are known.
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


def _refine(
    flat: NDArray[np.float32], ring: _Ring, along_at: _FloatArray = _ALONG
) -> tuple[_FloatArray, _FloatArray]:
    """Return the crossing of the two lines at each prediction (N, 2), and the contrast of the fainter line (N,).

    Each line is located between its two flanks, beside the crossing, away from the other line.
    """
    found = ring.predicted.copy()
    contrast = np.full(len(found), np.inf)
    for _ in range(_REFINEMENTS):
        for axis in (0, 1):
            across, along = ring.steps[:, axis], ring.steps[:, 1 - axis]
            profile = _sample_profiles(flat, found, across, along, _ACROSS, along_at=along_at)
            offset, depth = _locate_lines(profile)
            found = found + offset[:, None] * across
            contrast = np.minimum(contrast, depth)
    return found, contrast


def _sample_profiles(
    flat: NDArray[np.float32],
    centres: _FloatArray,
    across: _FloatArray,
    along: _FloatArray,
    at: _FloatArray,
    *,
    along_at: _FloatArray = _ALONG,
) -> _FloatArray:
    """Return the density across a line (N, samples), averaged along it on both sides of the crossing.

    `at` and `along_at` place the samples, in steps to the next line.
    """
    spread = (at[:, None, None, None] * across + along_at[:, None, None] * along).reshape(-1, *centres.shape)
    maps = (centres + spread).astype(np.float32)
    drawn = cv2.remap(flat, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(drawn, dtype=np.float64).reshape(len(at), len(along_at), len(centres))
    return np.asarray(values.mean(axis=1).T)


def _locate_lines(profiles: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
    """Return the lines' offsets (N,) from the middle of their profiles [steps], and their depths (N,)."""
    flank = np.abs(_ACROSS) > _FLANK
    slope, level = np.polyfit(_ACROSS[flank], profiles[:, flank].T, 1)
    bare = profiles - (slope[:, None] * _ACROSS + level[:, None])
    weight = bare * np.cos(0.5 * np.pi * _ACROSS / _ACROSS[-1]) ** 2
    mass = weight.sum(axis=1)
    offset = (weight @ _ACROSS) / np.where(mass > 0.0, mass, np.inf)
    return np.clip(offset, -_LARGEST_SHIFT, _LARGEST_SHIFT), bare.max(axis=1) * (mass > 0.0)


def _number_in_finest(flat: NDArray[np.float32], found: Crossings) -> Crossings:
    """Return the crossings numbered in the finest lines, even if these are too faint or too close to follow.

    Raises
    ------
    MeasurementRefusedError
        If something lies between the lines found that does not divide their distance evenly: every length could
        be wrong.
    """
    places, steps, cells = _tabulate(found)
    cells = cells[np.isfinite(steps[tuple(cells.T)]).all(axis=(1, 2))]
    sample = tuple(cells[:: len(cells) // _MOST_CELLS + 1].T)
    divisions = {_count_divisions(flat, places[sample], steps[sample], axis) for axis in (0, 1)}
    if len(divisions) != 1 or None in divisions:
        raise MeasurementRefusedError(
            f"between the lines {found.pitch_px:.0f} px apart there are fainter ones",
            "come closer, so that the nearest lines are seen as well as the others",
        )
    step = divisions.pop() or 1
    return replace(found, indices=found.indices * step, pitch_px=found.pitch_px / step, step=step)


def _count_divisions(
    flat: NDArray[np.float32], places: _FloatArray, steps: _FloatArray, axis: int
) -> int | None:
    """Return the number of fine steps from a line to the next; None if it is unclear."""
    across, along = steps[:, axis], steps[:, 1 - axis]
    depth = float(_locate_lines(_sample_profiles(flat, places, across, along, _ACROSS))[1].mean())
    between = _sample_profiles(flat, places + 0.5 * across, across, along, _BETWEEN).mean(axis=0)
    if _highest_top(between) <= _FINER_LINE * depth:
        return 1
    curve = np.polynomial.Polynomial.fit(_BETWEEN, between, 2)
    rest = between - curve(_BETWEEN)
    best, explained = 0, 0.0
    for count in _SUBDIVISIONS:
        wave = np.cos(2.0 * np.pi * count * (0.5 + _BETWEEN))
        wave -= np.polynomial.Polynomial.fit(_BETWEEN, wave, 2)(_BETWEEN)
        amplitude = float(rest @ wave) / float(wave @ wave)
        share = amplitude * float(rest @ wave) / float(rest @ rest) if amplitude > 0.0 else 0.0
        if share > explained:
            best, explained = count, share
    return best if explained >= _LEAST_EXPLAINED else None


def _highest_top(profile: _FloatArray) -> float:
    """Return the largest height of an inner peak above the higher of the minima on its two sides."""
    left, right = np.minimum.accumulate(profile), np.minimum.accumulate(profile[::-1])[::-1]
    return float((profile - np.maximum(left, right)).max())
