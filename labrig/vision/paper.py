"""The ruled lines of graph paper, followed over a picture whose scale is roughly known.

The picture's scale says how far apart the paper's lines are in the picture, to a fifth. Lines in two directions that
far apart are sought in patches of the picture's spectrum. From the clearest patch they are followed by their phase: in
a window of a few lines the density is multiplied by the complex wave of a family of lines, and the angle of the sum is
the window's place between two lines (lock-in; geometric phase analysis, Hytch, Snoeck & Kilaas 1998). Heavier lines are
in phase with finer ones, so they do not matter; noise and marks average out over the window. From one window to the
next the wave predicts the place, and the windows so count the lines. A window whose phase is off its prediction, whose
lines are faint, or in which the paper ends is left out.

The sum over all windows is the spectrum of the whole sheet. It tells whether the lines that were followed are those of
the stated pitch: of coarser lines only every other multiple of a frequency is one of theirs, and finer lines add to one
multiple what the multiples beside it do not have.
"""

from dataclasses import dataclass
from functools import reduce
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.picture import Picture

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Density = NDArray[np.float32]

# The stated scale may be off by this share; a slanted sheet shows its lines closer and further apart as well.
LARGEST_SCALE_ERROR = 0.2
_BAND = 0.68, 1.42
# Closer lines are not resolved [px].
_LEAST_PX = 2.4
_LEAST_LINES = 4
# Lines are sought and followed in a picture that is made smaller until they are less than twice this far apart [px].
_FOLLOWED_PX = 24.0
# Slow changes of light are removed over this many lines, and at least so many pixels.
_SLOW, _LEAST_SLOW_PX = 0.6, 8.0
# The optical density of each grey level.
_DENSITIES = -np.log(np.maximum(np.arange(256, dtype=np.float32), 1.0))
# What is darker than lines is clipped at this quantile.
_CLIP_QUANTILE, _CLIP_STRIDE = 0.97, 8
# Half a grey level of 200.
_LEAST_NOISE = 0.0025
# Side of a patch in distances of lines, and limits [px].
_PATCH, _PATCH_PX = 8.0, (128, 256)
_PLACES = tuple(product((0.5, 0.25, 0.75, 0.05, 0.95), repeat=2))
# A peak of a patch's spectrum over its median, at the least.
_LEAST_STRENGTH = 6.0
_LEAST_ANGLE_DEG, _LARGEST_RATIO = 50.0, 1.35
# Half a window's width, which is also the distance of windows: a share of the picture's shorter side, within limits in
# lines. Narrower windows follow what are no lines, wider ones would be too few.
_HALF_OF_SHORT, _HALF = 1.0 / 7.3, (1.25, 2.5)
_LEAST_HALF_PX = 10
# Largest difference of a phase from its prediction, in lines, and least amplitude as a share of the neighbours'.
_LARGEST_SHIFT, _LEAST_AMPLITUDE = 0.2, 0.35
# A step in the paper's brightness within a window, as a difference of logarithms: there the paper ends.
_LARGEST_STEP = 0.3
_MOST_TRIES = 4
# Order of the polynomial of places while fewer windows than this are known, and cells around to which it is mended.
_ORDERS = ((12, 0), (40, 2), (np.inf, 3))
_AROUND = np.array(list(product((-2, -1, 0, 1, 2), repeat=2)))
_RIDGE = 1e-6, 0.3, 0.3
# Lines further apart than this [px] are located by a multiple of their frequency.
_FINE_PX = 16.0
# Variance of a window's taper in squared halves of its width, and order of the polynomial that bends the lines.
_TAPER_VARIANCE, _BEND_ORDER = 1.0 / 3.0 - 2.0 / np.pi**2, 3
# A place is left out if it is further than this many times the median from what its neighbours say.
_OUTLIER = 5.0
_LEAST_WINDOWS = 12
# Windows grow until there are no more than about so many.
_MANY_WINDOWS = 2500
# Windows that measure the spectrum of the sheet; how much its own lines, or finer ones, exceed the multiples beside.
_SPECTRUM_WINDOWS, _STANDS_OUT, _LEAST_FINER = 250, 1.4, 0.1
# Steps between lines of common papers.
_MULTIPLES = (2, 5, 10)
# Fractions of the lines' frequency that no heavier lines have, or hardly, and their largest share of it: they are those
# of lines two to four times as far apart.
_FRACTIONS = ((1.0 / 2.0, 1.0), (1.0 / 3.0, 0.5), (1.0 / 4.0, 0.5))
# Another sheet's lines differ from the first's by this share.
_OTHER_SHEET = 0.08
# Pixels of windows that are looked at together.
_BLOCK_PX = 2_000_000
_OVEREXPOSED = 250


@dataclass(frozen=True, eq=False)
class PaperPoints:
    """Points of the picture whose places among the ruled lines are known.

    Attributes
    ----------
    pixels : ndarray (N, 2)
        Middles of windows (u, v).
    lines : ndarray (N, 2)
        Their places, counted in the lines of both families.
    cells : ndarray of int (N, 2)
        Row and column of each window; neighbours differ by one.
    spacing_px : float
        Median distance between lines.
    window_px : float
        Distance of windows: each stands for half of that around it.
    """

    pixels: FloatArray
    lines: FloatArray
    cells: IntArray
    spacing_px: float
    window_px: float


def find_paper(image: Picture, spacing_px: float) -> PaperPoints:
    """Find the ruled lines in a picture of graph paper, dark on light.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    spacing_px : float
        Distance between the paper's nearest lines in the picture, to a fifth.

    Raises
    ------
    MeasurementRefusedError
        If there are no such lines, they are too close, or the picture shows other lines or a second sheet.
    """
    if not spacing_px >= _LEAST_PX:
        raise MeasurementRefusedError(
            f"by the stated scale the paper's nearest lines are {spacing_px:.1f} px apart, too close to tell",
            "come closer with the camera, or use one with more pixels, until they are 3 px apart or more",
        )
    if min(image.shape[:2]) < _LEAST_LINES * spacing_px:
        raise MeasurementRefusedError(
            f"by the stated scale the paper's nearest lines are {spacing_px:.1f} px apart, so there is no grid of "
            f"{_LEAST_LINES} lines in the picture",
            "show more of the graph paper, and check the stated scale and the pitch of the paper",
        )
    factor = max(int(spacing_px / _FOLLOWED_PX), 1)
    windows = _Windows(_shrink(image, factor), spacing_px / factor)
    grids: list[_Grid] = []
    for seed in _find_seeds(windows.density, spacing_px / factor):
        if not any(windows.covers(grid, seed) for grid in grids):
            grids.append(windows.follow(seed))
    best = max(grids, key=lambda grid: grid.size, default=None)
    if best is None or best.size < _LEAST_WINDOWS:
        raise _explain_no_lines(image, spacing_px)
    found = windows.tabulate(best)
    _require_scale(found, spacing_px / factor, factor, windows.density.shape)
    _require_these_lines(windows, found, factor)
    for grid in grids:
        windows.require_same_sheet(best, grid)
    pixels = (found.pixels + 0.5) * factor - 0.5
    spacing_px = float(np.median(found.spacings_px())) * factor
    return PaperPoints(pixels, found.lines, found.cells, spacing_px, float(windows.half * factor))


@dataclass(frozen=True, eq=False)
class _Seed:
    """Two families of lines in a patch: strength over noise, the patch's middle (2,), and the waves (2, 2)."""

    strength: float
    centre: FloatArray
    waves: FloatArray


def _find_seeds(density: Density, spacing_px: float) -> list[_Seed]:
    """Return the lines in patches of the picture that are about so far apart, the clearest first."""
    height, width = density.shape
    side = min(int(np.clip(_PATCH * spacing_px, *_PATCH_PX)), height, width) // 2 * 2
    if side < 3.0 * spacing_px:
        return []
    taper = np.hanning(side).astype(np.float32)
    at = (np.arange(side) - side // 2) / side
    waves = np.stack(np.meshgrid(at, at), axis=2)
    length = np.linalg.norm(waves, axis=2) * spacing_px
    ring = (length > 1.0 / _BAND[1]) & (length < 1.0 / _BAND[0]) & (np.abs(waves).max(axis=2) < 0.49)
    bins, found = np.argwhere(ring), []
    for across, down in _PLACES:
        left, top = (
            int(np.clip(share * extent - side / 2, 0, extent - side))
            for share, extent in ((across, width), (down, height))
        )
        patch = density[top : top + side, left : left + side]
        spectrum = np.abs(np.fft.fftshift(np.fft.fft2((patch - patch.mean()) * taper[:, None] * taper)))
        is_even = np.ptp(patch) < _LEAST_NOISE  # what is left has peaks too, by rounding
        pair = None if is_even or not len(bins) else _find_pair(spectrum[ring], waves[ring])
        if pair is not None:
            strength, peaks = pair
            summits = np.array([_find_summit(spectrum, peak) for peak in bins[list(peaks)]])
            middle = np.array([left, top]) + side / 2
            found.append(_Seed(strength, middle, (summits - side // 2) / side))
    return sorted(found, key=lambda seed: -seed.strength)


def _find_pair(heights: FloatArray, waves: FloatArray) -> tuple[float, tuple[int, int]] | None:
    """Return the strength and the numbers of the two highest of peaks (N,) at right angles, or nearly so."""
    first, length = int(np.argmax(heights)), np.linalg.norm(waves, axis=1)
    cosine = np.abs(waves @ waves[first]) / (length * length[first])
    alike = np.abs(np.log(length / length[first])) < np.log(_LARGEST_RATIO)
    aside = np.where(alike & (cosine < np.cos(np.deg2rad(_LEAST_ANGLE_DEG))), heights, 0.0)
    second = int(np.argmax(aside))
    strength = float(aside[second]) / max(float(np.median(heights)), float(np.finfo(np.float32).tiny))
    return (strength, (first, second)) if strength >= _LEAST_STRENGTH else None


def _find_summit(spectrum: FloatArray, peak: IntArray) -> FloatArray:
    """Return the summit (u, v) at a peak, to a fraction of a bin by parabolas through its logarithm."""
    v, u = peak
    summit = np.array([u, v], dtype=np.float64)
    for axis, three in enumerate((spectrum[v, u - 1 : u + 2], spectrum[v - 1 : v + 2, u])):
        low, middle, high = np.log(np.maximum(three, np.finfo(np.float64).tiny))
        bend = 2.0 * middle - low - high
        summit[axis] += np.clip(0.5 * (high - low) / bend, -0.5, 0.5) if bend > 0.0 else 0.0
    return summit


@dataclass(frozen=True, eq=False)
class _Grid:
    """The windows of one sheet, in tables with a margin of two unknown ones: places among the lines, and amplitude.

    `waves` (2, 2) are those of the seed.
    """

    waves: FloatArray
    lines: FloatArray
    amplitude: FloatArray

    @property
    def known(self) -> NDArray[np.bool_]:
        return np.isfinite(self.amplitude)

    @property
    def size(self) -> int:
        return int(self.known.sum())


class _Windows:
    """The windows of a picture in which lines are followed, half a width apart."""

    def __init__(self, image: Picture, spacing_px: float) -> None:
        self.density = _measure_darkness(image, spacing_px)
        extents = self.density.shape
        half = np.clip(_HALF_OF_SHORT * min(extents), *np.multiply(_HALF, spacing_px))
        half = max(round(float(half)), round((extents[0] * extents[1] / _MANY_WINDOWS) ** 0.5))
        self.half = min(max(half, _LEAST_HALF_PX), (min(extents) - 1) // 2)
        v, u = (self._place(extent) for extent in extents)
        shape = len(v) + 4, len(u) + 4
        self.places, self._usable = np.zeros((*shape, 2)), np.zeros(shape, dtype=bool)
        self.places[2:-2, 2:-2] = np.stack(np.meshgrid(u, v), axis=2)
        self._usable[2:-2, 2:-2] = _find_even_light(image, self.half, spacing_px)[np.ix_(v, u)]

    def _place(self, extent: int) -> IntArray:
        free = extent - 1 - 2 * self.half
        return np.arange(self.half + free % self.half // 2, extent - self.half, self.half)

    def follow(self, seed: _Seed) -> _Grid:
        """Follow the lines from a seed over the picture."""
        shape = self._usable.shape
        grid = _Grid(seed.waves, np.full((*shape, 2), np.nan), np.full(shape, np.nan))
        start = self.find_window(seed)
        (total,) = self.lock_in(self.places[start][None], seed.waves[None])
        grid.lines[start], grid.amplitude[start] = np.angle(total) / (2.0 * np.pi), np.abs(total).min()
        tries = np.zeros(shape)
        while True:
            beside = np.round(cv2.boxFilter(grid.known.astype(float), -1, (3, 3), normalize=False))
            wanted = self._usable & ~grid.known & (beside > tries) & (tries < _MOST_TRIES)
            if not wanted.any():
                return grid
            tries[wanted] = beside[wanted]
            cells = np.argwhere(wanted)
            lines, waves, typical = self.predict(grid, cells)
            total = self.lock_in(self.places[wanted], waves)
            off, faintest = _wrap(total, lines), np.abs(total).min(axis=1)
            good = (np.abs(off) < _LARGEST_SHIFT).all(axis=1) & (faintest > _LEAST_AMPLITUDE * typical)
            at = tuple(cells[good].T)
            grid.lines[at] = (lines + off)[good]
            # A mark of ink must not raise what the next windows have to show.
            grid.amplitude[at] = 0.5 * (typical + np.minimum(faintest, 2.0 * typical))[good]

    def predict(self, grid: _Grid, cells: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return lines (N, 2), waves (N, 2, 2) and amplitude (N,) of cells as the windows that are known have them.

        They are a polynomial over the sheet beside the waves of its seed, and what the cells around are off it.
        """
        at, known = tuple(cells.T), grid.known
        order = next(order for most, order in _ORDERS if grid.size < most)
        straight = self.places @ grid.waves.T
        trend = _Polynomial(self.places[known], (grid.lines - straight)[known], order)
        middle = straight + trend.at(self.places)
        around = tuple((cells[:, None] + _AROUND).transpose(2, 0, 1))
        counts = known[around].astype(float)
        basis = np.column_stack((np.ones(len(_AROUND)), _AROUND[:, ::-1]))
        normal = np.einsum("nk,ki,kj->nij", counts, basis, basis, optimize=True) + np.diag(_RIDGE)
        scores = np.einsum("nkf,ki->nif", np.nan_to_num((grid.lines - middle)[around]), basis)
        local = np.linalg.solve(normal, scores)
        typical = np.nansum(grid.amplitude[around], axis=1) / np.maximum(counts.sum(axis=1), 1.0)
        lines = middle[at] + local[:, 0]
        return (
            lines,
            grid.waves + trend.slopes(self.places[at]) + local[:, 1:].transpose(0, 2, 1) / self.half,
            typical,
        )

    def lock_in(self, centres: FloatArray, waves: FloatArray) -> NDArray[np.complex128]:
        """Return the complex amplitudes (N, 2) of both families of lines in windows around pixels (N, 2)."""
        side = 2 * self.half + 1
        at = np.arange(-self.half, self.half + 1, dtype=np.float32)
        taper = np.cos(np.float32(0.5 * np.pi) * at / (self.half + 1)) ** 2
        views = np.lib.stride_tricks.sliding_window_view(self.density, (side, side))
        block = max(_BLOCK_PX // side**2, 1)
        total = np.empty((len(centres), 2), dtype=np.complex128)
        for first in range(0, len(centres), block):
            part = slice(first, first + block)
            phase = (-2.0 * np.pi * waves[part]).astype(np.float32)[..., None] * at
            # Waves (N, 2 families, side) along u and v. The patches are real: real and imaginary part are two columns.
            real, imaginary = taper * np.cos(phase), taper * np.sin(phase)
            columns = np.concatenate((real[:, :, 0], imaginary[:, :, 0]), axis=1).transpose(0, 2, 1)
            u, v = centres[part].astype(int).T - self.half
            rows = np.matmul(views[v, u], columns)
            down = real[:, :, 1] + 1j * imaginary[:, :, 1]
            total[part] = np.einsum("nvf,nfv->nf", rows[..., :2] + 1j * rows[..., 2:], down)
        return np.asarray(total * (2.0 / float(taper.sum()) ** 2))

    def find_window(self, seed: _Seed) -> tuple[np.intp, ...]:
        """Return the cell nearest to a seed."""
        away = np.where(self._usable, np.linalg.norm(self.places - seed.centre, axis=2), np.inf)
        return np.unravel_index(np.argmin(away), away.shape)

    def covers(self, grid: _Grid, seed: _Seed) -> bool:
        """Return whether the lines around a seed, or beside, were followed."""
        row, column = self.find_window(seed)
        return bool(grid.known[row - 1 : row + 2, column - 1 : column + 2].any())

    def require_same_sheet(self, sheet: _Grid, other: _Grid) -> None:
        """Refuse a second sheet, whose lines do not go on as the first's do."""
        near = cv2.dilate(sheet.known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        fresh = other.known & ~near
        if fresh.sum() < max(_LEAST_WINDOWS, 0.5 * other.size):  # the same lines, followed into what are none
            return
        first, second = (
            _Polynomial(self.places[part], grid.lines[part], 2).slopes(self.places[fresh]).mean(axis=0)
            for grid, part in ((sheet, sheet.known), (other, fresh))
        )
        for wave in second:
            off = [np.linalg.norm(wave - sign * twin) for sign, twin in product((1.0, -1.0), first)]
            if min(off) > _OTHER_SHEET * np.linalg.norm(wave):
                raise MeasurementRefusedError(
                    "the picture shows two sheets of ruled paper that do not lie alike",
                    "take one of them away",
                )

    def tabulate(self, grid: _Grid) -> "_Found":
        """Return the windows of a sheet, measured anew, without those that do not fit in."""
        cells = np.argwhere(grid.known)
        lines, waves, _ = self.predict(grid, cells)
        places = self.places[grid.known]
        off = _wrap(self.lock_in(places, waves), lines)
        multiple = max(round(float(np.median(np.abs(np.linalg.det(waves)) ** -0.5)) / _FINE_PX), 1)
        off += _wrap(self.lock_in(places, multiple * waves), multiple * (lines + off)) / multiple
        away = np.linalg.norm(off, axis=1)
        good = (np.abs(off) < _LARGEST_SHIFT).all(axis=1) & (away <= _OUTLIER * np.median(away))
        places, lines = places[good], (lines + off)[good]
        # A window measures the mean over its pixels: lens and perspective bend the lines by half the Laplacian.
        variance_px2 = _TAPER_VARIANCE * (self.half + 1) ** 2
        trend = _Polynomial(places, lines, _BEND_ORDER)
        bent = trend.at(places, 2, 0) + trend.at(places, 0, 2)
        return _Found(places, lines - 0.5 * variance_px2 * bent, waves[good], cells[good])


@dataclass(frozen=True, eq=False)
class _Found:
    """Windows: pixels (N, 2) of the followed picture, lines (N, 2), waves (N, 2, 2), cells (N, 2)."""

    pixels: FloatArray
    lines: FloatArray
    waves: FloatArray
    cells: IntArray

    def spacings_px(self) -> FloatArray:
        """Return the distance between lines in each window, the mean of both families."""
        return np.asarray(np.abs(np.linalg.det(self.waves)) ** -0.5)


def _wrap(total: NDArray[np.complex128], lines: FloatArray) -> FloatArray:
    """Return by how much the phases of complex amplitudes are off places among lines, within half a line."""
    off = np.angle(total) / (2.0 * np.pi) - lines
    return np.asarray(off - np.round(off))


class _Polynomial:
    """Polynomials of an order that fit values (N, F) at places (N, 2)."""

    def __init__(self, places: FloatArray, values: FloatArray, order: int) -> None:
        self._middle, self._scale = places.mean(axis=0), max(0.5 * float(np.ptp(places)), 1.0)
        chosen = np.add.outer(np.arange(order + 1), np.arange(order + 1)) <= order
        x, y = ((places - self._middle) / self._scale).T
        terms = polynomial.polyvander2d(x, y, (order, order))[:, chosen.ravel()]
        self._factors = np.zeros((*chosen.shape, values.shape[1]))
        self._factors[chosen] = np.linalg.lstsq(terms, values, rcond=None)[0]

    def at(self, places: FloatArray, by_u: int = 0, by_v: int = 0) -> FloatArray:
        """Return values (..., F) at places (..., 2), or their derivatives."""
        bent = polynomial.polyder(polynomial.polyder(self._factors, by_u, axis=0), by_v, axis=1)
        x, y = np.moveaxis((places - self._middle) / self._scale, -1, 0)
        return np.asarray(np.moveaxis(polynomial.polyval2d(x, y, bent), 0, -1) / self._scale ** (by_u + by_v))

    def slopes(self, places: FloatArray) -> FloatArray:
        """Return the slopes (..., F, 2) at places (..., 2)."""
        return np.stack((self.at(places, 1, 0), self.at(places, 0, 1)), axis=-1)


def _require_scale(found: _Found, spacing_px: float, factor: int, shape: tuple[int, ...]) -> None:
    """Refuse lines that are at no angle as far apart as stated, nearest to the middle of the picture."""
    middle = np.argmin(np.linalg.norm(found.pixels - 0.5 * np.array(shape[::-1]), axis=1))
    most, least = 1.0 / np.linalg.svd(found.waves[middle], compute_uv=False)[::-1]
    if most < (1.0 - LARGEST_SCALE_ERROR) * spacing_px or least > (1.0 + LARGEST_SCALE_ERROR) * spacing_px:
        raise _contradict(factor * float(np.sqrt(most * least)), factor * spacing_px)


def _contradict(seen_px: float, spacing_px: float) -> MeasurementRefusedError:
    return MeasurementRefusedError(
        f"the paper's nearest lines are {seen_px:.1f} px apart in the picture, and by the stated scale and pitch they "
        f"would be {spacing_px:.1f} px apart, which may be {100.0 * LARGEST_SCALE_ERROR:.0f} % off at the most",
        "measure the lines of the graph paper with a ruler, and the distance of the camera with a tape",
    )


def _require_these_lines(windows: _Windows, found: _Found, factor: int) -> None:
    """Refuse lines that are not the paper's nearest, or of which some are not there."""
    spacing_px = float(np.median(found.spacings_px()))
    chosen = np.linspace(0, len(found.pixels) - 1, min(len(found.pixels), _SPECTRUM_WINDOWS)).astype(int)
    pixels, lines, waves = found.pixels[chosen], found.lines[chosen], found.waves[chosen]

    def measure(multiple: float) -> FloatArray:
        drawn = windows.lock_in(pixels, multiple * waves)
        return np.asarray(np.abs(np.mean(drawn * np.exp(-2j * np.pi * multiple * lines), axis=0)))

    def refuse(pitches: float) -> MeasurementRefusedError:
        return _contradict(factor * spacing_px * pitches, factor * spacing_px)

    own = measure(1.0)
    for fraction, most in _FRACTIONS:
        if (measure(fraction) > most * own).all():
            raise refuse(1.0 / fraction)
    for number in (5, 10):
        beside = np.sqrt(measure(1.0 - 1.0 / number) * measure(1.0 + 1.0 / number))
        if (own < _STANDS_OUT * beside).all():
            raise refuse(number)
    for number in _MULTIPLES:
        if spacing_px / number > _LEAST_PX:
            finer = measure(float(number))
            beside = own if number == 2 else np.maximum(measure(number - 1.0), measure(number + 1.0))
            if (finer > np.maximum(_STANDS_OUT * beside, _LEAST_FINER * own)).all():
                raise refuse(1.0 / number)


def _explain_no_lines(image: Picture, spacing_px: float) -> MeasurementRefusedError:
    """Return why no lines were followed: the picture is too bright, or there are none that far apart."""
    if np.mean(image >= _OVEREXPOSED) > 0.5:
        return MeasurementRefusedError(
            "no grid of ruled lines in the picture, most of which is overexposed",
            "shorten the exposure until the graph paper is light grey",
        )
    return MeasurementRefusedError(
        f"no grid of ruled lines about {spacing_px:.1f} px apart in the picture, as the stated scale and pitch have it",
        "measure the paper's lines and the stated scale again; show sharp, evenly lit graph paper",
    )


def _measure_darkness(image: Picture, spacing_px: float) -> Density:
    """Return the optical density (H, W) of the lines without uneven light; each channel counts by its contrast."""
    channels = image[..., None] if image.ndim == 2 else image
    total, weights = np.zeros(image.shape[:2], np.float32), 0.0
    for number in range(channels.shape[2]):
        density = _remove_slow_light(channels[..., number], max(_SLOW * spacing_px, _LEAST_SLOW_PX))
        part = density[::_CLIP_STRIDE]
        part = np.clip(part, *np.quantile(part, (1.0 - _CLIP_QUANTILE, _CLIP_QUANTILE)))
        noise = max(1.05 * float(np.median(np.abs(np.diff(part, axis=1)))), _LEAST_NOISE)
        weight = max(float(np.mean(part**2)) - noise**2, _LEAST_NOISE**2) ** 0.5 / noise**2
        total += np.float32(weight) * density
        weights += weight
    total /= np.float32(weights)
    most = float(np.quantile(np.abs(total[::_CLIP_STRIDE, ::_CLIP_STRIDE]), _CLIP_QUANTILE))
    return np.asarray(np.clip(total, -most, most))


def _remove_slow_light(channel: Picture, sigma_px: float) -> Density:
    """Return the optical density of a channel without its slowly varying part."""
    density = cv2.LUT(channel, _DENSITIES)
    height, width = density.shape
    factor = max(int(sigma_px / 2.5), 1)
    small = cv2.resize(density, (-(-width // factor), -(-height // factor)), interpolation=cv2.INTER_AREA)
    slow = cv2.GaussianBlur(small, (0, 0), sigma_px / factor)
    return np.asarray(
        density - cv2.resize(slow, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32
    )


def _shrink(picture: NDArray[Any], factor: int) -> NDArray[Any]:
    """Return a picture made smaller by a whole factor; what is left over at right and below is left out."""
    height, width = (extent // factor for extent in picture.shape[:2])
    even = picture[: height * factor, : width * factor]
    return (
        even if factor == 1 else np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA))
    )


def _find_even_light(image: Picture, half: int, spacing_px: float) -> NDArray[np.bool_]:
    """Return whether the paper's brightness has no step (H, W) in the window around a pixel; lines are none."""
    grey = reduce(cv2.max, cv2.split(image))
    side = 2 * round(0.35 * spacing_px) + 3
    factor = max(half // 5, 1)
    paper = _shrink(cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)), factor)
    level = np.log(
        np.maximum(cv2.GaussianBlur(paper.astype(np.float32), (0, 0), 0.3 * side / factor + 0.3), 1.0)
    )
    window = np.ones((2 * (half // factor) + 1,) * 2, np.uint8)
    even = (cv2.dilate(level, window) - cv2.erode(level, window) < _LARGEST_STEP).astype(np.uint8)
    return cv2.resize(even, image.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
