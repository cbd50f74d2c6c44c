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
from itertools import product
from typing import Any

import cv2
import numpy as np
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
# Lines are sought and followed in a picture so small that they are about this far apart [px].
_FOLLOWED_PX = 10.0
# Slow changes of light are removed over this many lines, and at least so many pixels.
_SLOW, _LEAST_SLOW_PX = 0.6, 8.0
# The optical density of each grey level.
_DENSITIES = -np.log(np.maximum(np.arange(256, dtype=np.float32), 1.0))
# What is darker than lines is clipped at this quantile.
_CLIP_QUANTILE, _CLIP_STRIDE = 0.97, 4
# Half a grey level of 200.
_LEAST_NOISE = 0.0025
_PATCH_PX = 128
_PLACES = tuple(product((0.5, 0.25, 0.75, 0.05, 0.95), repeat=2))
# A peak of a patch's spectrum over its median, at the least.
_LEAST_STRENGTH = 6.0
_LEAST_ANGLE_DEG, _LARGEST_RATIO = 50.0, 1.35
# Half a window's width in lines, which is also the distance of windows. Where the picture has few lines across, it is
# this share of them, within limits: wider windows would be too few, and narrower ones follow what are no lines.
_HALF, _FEW, _SHARE_OF_FEW, _HALF_OF_FEW = 2.5, 25.0, 1.0 / 7.3, (1.25, 1.8)
_LEAST_HALF_PX = 10
# Largest difference of a phase from its prediction, in lines, and least amplitude as a share of the neighbours'.
_LARGEST_SHIFT, _LEAST_AMPLITUDE = 0.2, 0.35
# A step in the paper's brightness within a window, as a difference of logarithms: there the paper ends.
_LARGEST_STEP = 0.3
_MOST_TRIES = 4
# Change of the waves from the outer neighbours to the inner ones, to half-way from these to here, and to here.
_ONWARD = 2.0, 3.0
# Lines further apart than this [px] are located by a multiple of their frequency.
_FINE_PX = 16.0
# Variance of a window's taper in squared halves of its width, and order of the polynomial of places.
_TAPER_VARIANCE, _ORDER = 1.0 / 3.0 - 2.0 / np.pi**2, 3
# A place is left out if it is further than this many times the median from what its neighbours say.
_OUTLIER = 5.0
_LEAST_WINDOWS = 12
# More windows than this are averaged in blocks.
_MANY_WINDOWS = 1200
# Windows that measure the spectrum of the sheet; how much its own lines, or finer ones, exceed the multiples beside.
_SPECTRUM_WINDOWS, _STANDS_OUT, _LEAST_FINER = 250, 1.4, 0.1
# Steps between lines of common papers.
_MULTIPLES = (2, 5, 10)
# Fractions of the lines' frequency that no heavier lines have, or hardly, and their largest share of it: they are those
# of lines two to four times as far apart.
_FRACTIONS = ((1.0 / 2.0, 1.0), (1.0 / 3.0, 0.5), (1.0 / 4.0, 0.5))
# Another sheet's lines differ from the first's by this share.
_OTHER_SHEET = 0.08
_AROUND = np.array([step for step in product((-2, -1, 0, 1, 2), repeat=2) if step != (0, 0)])
# Pixels of windows that are looked at together.
_BLOCK_PX = 2_000_000
# Scales over the stated one at which other lines are looked for, to tell what is wrong.
_OTHER_SCALES, _LEAST_SUPPORT, _LEAST_SIDE_PX = (0.2, 0.5, 2.0, 5.0, 0.1, 10.0), 3, 32
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
    density = _measure_darkness(image, spacing_px)
    factor = max(round(spacing_px / _FOLLOWED_PX), 1)
    windows = _Windows(_shrink(density, factor), _shrink(image, factor), spacing_px / factor)
    seeds = _find_seeds(windows.density, spacing_px / factor)
    grids: list[_Grid] = []
    for seed in seeds:
        if not any(windows.covers(grid, seed) for grid in grids):
            grids.append(windows.follow(seed))
    best = max(grids, key=lambda grid: grid.size, default=None)
    if best is None or best.size < _LEAST_WINDOWS:
        raise _explain_no_lines(image, density, spacing_px)
    rough = _tabulate(best, windows, factor)
    found = _locate(density, rough, windows.half * factor)
    _require_scale(found, spacing_px, density.shape)
    _require_these_lines(density, rough, windows.half * factor)
    for grid in grids:
        windows.require_same_sheet(best, grid)
    spacing = float(np.median(found.spacings_px()))
    return PaperPoints(found.pixels, found.lines, found.cells, spacing, float(windows.half * factor))


@dataclass(frozen=True, eq=False)
class _Seed:
    """Two families of lines in a patch: strength over noise, the patch's middle (2,), and the waves (2, 2)."""

    strength: float
    centre: FloatArray
    waves: FloatArray


def _find_seeds(density: Density, spacing_px: float) -> list[_Seed]:
    """Return the lines in patches of the picture that are about so far apart, the clearest first."""
    height, width = density.shape
    side = min(_PATCH_PX, height, width) // 2 * 2
    if side < 3.0 * spacing_px:
        return []
    taper = np.hanning(side).astype(np.float32)
    found = []
    for across, down in _PLACES:
        left, top = (
            int(np.clip(share * extent - side / 2, 0, extent - side))
            for share, extent in ((across, width), (down, height))
        )
        patch = density[top : top + side, left : left + side]
        spectrum = np.abs(np.fft.fftshift(np.fft.fft2((patch - patch.mean()) * taper[:, None] * taper)))
        peaks = _find_peaks(spectrum, spacing_px)
        if peaks is not None:
            strength, waves = peaks
            found.append(_Seed(strength, np.array([left, top]) + side / 2, waves))
    return sorted(found, key=lambda seed: -seed.strength)


def _find_peaks(spectrum: FloatArray, spacing_px: float) -> tuple[float, FloatArray] | None:
    """Return the strength and the waves (2, 2) of the two highest peaks at right angles, or nearly so."""
    side = len(spectrum)
    at = (np.arange(side) - side // 2) / side
    u, v = np.meshgrid(at, at)
    length = np.asarray(np.hypot(u, v) * spacing_px)
    ring = (length > 1.0 / _BAND[1]) & (length < 1.0 / _BAND[0]) & (np.maximum(np.abs(u), np.abs(v)) < 0.49)
    if not ring.any():
        return None
    noise = float(np.median(spectrum[ring]))
    first = np.unravel_index(np.argmax(np.where(ring, spectrum, 0.0)), spectrum.shape)
    cosine = np.abs(u * u[first] + v * v[first]) * spacing_px**2 / np.maximum(length * length[first], 1e-9)
    alike = np.abs(np.log(np.maximum(length, 1e-9) / length[first])) < np.log(_LARGEST_RATIO)
    aside = np.where(ring & alike & (cosine < np.cos(np.deg2rad(_LEAST_ANGLE_DEG))), spectrum, 0.0)
    second = np.unravel_index(np.argmax(aside), spectrum.shape)
    strength = float(aside[second]) / max(noise, float(np.finfo(np.float32).tiny))
    if strength < _LEAST_STRENGTH:
        return None
    return strength, np.array([_find_summit(spectrum, peak) - side // 2 for peak in (first, second)]) / side


def _find_summit(spectrum: FloatArray, peak: tuple[np.intp, ...]) -> FloatArray:
    """Return the summit (u, v) at a peak, to a fraction of a bin by parabolas through its logarithm."""
    v, u = peak
    summit = np.array([u, v], dtype=np.float64)
    for axis, three in enumerate((spectrum[v, u - 1 : u + 2], spectrum[v - 1 : v + 2, u])):
        low, middle, high = np.log(np.maximum(three, np.finfo(np.float64).tiny))
        bend = 2.0 * middle - low - high
        summit[axis] += np.clip(0.5 * (high - low) / bend, -0.5, 0.5) if bend > 0.0 else 0.0
    return summit


@dataclass(eq=False)
class _Grid:
    """What is known of the windows, in tables with a margin of two unknown ones."""

    lines: FloatArray
    waves: FloatArray
    amplitude: FloatArray

    @property
    def known(self) -> NDArray[np.bool_]:
        return np.isfinite(self.amplitude)

    @property
    def size(self) -> int:
        return int(self.known.sum())

    def predict(self, places: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return lines, waves and amplitude of all windows as their neighbours have them, and how many know."""
        known = self.known.astype(np.float64)
        waves = np.nan_to_num(self.waves)
        count = _add_around(known, 3)

        def average(table: FloatArray, side: int) -> FloatArray:
            total = _add_around(table.reshape(*known.shape, -1), side).reshape(*known.shape, -1)
            return np.asarray(total / np.maximum(_add_around(known, side), 1.0)[..., None])

        mean = average(waves, 3).reshape(waves.shape)
        # From the neighbours to here the waves change as they did from those beyond them.
        change = mean - average(waves, 5).reshape(waves.shape)
        at_zero = np.nan_to_num(self.lines - np.einsum("rcfx,rcx->rcf", self.waves, places))
        lines = average(at_zero, 3) + np.einsum("rcfx,rcx->rcf", mean, places)
        step = places - average(places * known[..., None], 3)
        lines += np.einsum("rcfx,rcx->rcf", _ONWARD[0] * change, step)
        return (
            lines,
            mean + _ONWARD[1] * change,
            average(np.nan_to_num(self.amplitude), 3)[..., 0],
            np.round(count),
        )

    def fit_waves(self, cells: IntArray, places: FloatArray) -> None:
        """Fit the waves of cells to the lines around them, where these are spread enough."""
        here = tuple(cells.T)
        around = tuple((cells[:, None] + _AROUND).transpose(2, 0, 1))
        away = self.lines[around] - self.lines[here][:, None]
        known = np.isfinite(away[..., 0])
        steps = np.where(known[..., None], places[around] - places[here][:, None], 0.0)
        spread = np.einsum("nkx,nky->nxy", steps, steps)
        change = np.einsum("nkf,nkx->nfx", np.where(known[..., None], away, 0.0), steps)
        size = np.trace(spread, axis1=1, axis2=2)
        good = np.linalg.det(spread) > 0.05 * size**2
        good &= size > 0.0
        self.waves[tuple(cells[good].T)] = np.linalg.solve(
            spread[good], change[good].transpose(0, 2, 1)
        ).transpose(0, 2, 1)


def _add_around(table: FloatArray, side: int) -> FloatArray:
    """Return the sums over squares of cells."""
    return np.asarray(cv2.boxFilter(table, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT))


class _Windows:
    """The windows of a picture in which lines are followed."""

    def __init__(self, density: Density, image: Picture, spacing_px: float) -> None:
        lines = min(density.shape) / spacing_px
        lines_of_half = _HALF if lines > _FEW else float(np.clip(_SHARE_OF_FEW * lines, *_HALF_OF_FEW))
        half = max(round(lines_of_half * spacing_px), _LEAST_HALF_PX)
        self.half = min(half, (min(density.shape) - 1) // 2)
        self.density = density
        v, u = (self._place(extent) for extent in density.shape)
        self.places = np.full((len(v) + 4, len(u) + 4, 2), np.nan)
        self.places[2:-2, 2:-2] = np.stack(np.meshgrid(u, v), axis=2)
        self._usable = np.zeros(self.places.shape[:2], dtype=bool)
        self._usable[2:-2, 2:-2] = _find_even_light(image, self.half, spacing_px)[np.ix_(v, u)]
        self.places = np.nan_to_num(self.places)

    @property
    def count(self) -> int:
        return int(self._usable.sum())

    def _place(self, extent: int) -> IntArray:
        free = extent - 1 - 2 * self.half
        return np.arange(self.half + free % self.half // 2, extent - self.half, self.half)

    def follow(self, seed: _Seed) -> _Grid:
        """Follow the lines from a seed over the picture."""
        shape = self._usable.shape
        grid = _Grid(np.full((*shape, 2), np.nan), np.full((*shape, 2, 2), np.nan), np.full(shape, np.nan))
        start = np.array([self._find_window(seed)])
        phases, amplitudes = self._lock_in(start, seed.waves[None])
        self._store(grid, start, phases, seed.waves[None], amplitudes.min(axis=1))
        tries = np.zeros(shape)
        while True:
            lines, waves, amplitude, count = grid.predict(self.places)
            wanted = self._usable & ~grid.known & (count > tries) & (tries < _MOST_TRIES)
            if not wanted.any():
                return grid
            tries[wanted] = count[wanted]
            cells = np.argwhere(wanted)
            phases, amplitudes = self._lock_in(cells, waves[wanted])
            off = phases - lines[wanted]
            off -= np.round(off)
            faintest, typical = amplitudes.min(axis=1), amplitude[wanted]
            good = (np.abs(off) < _LARGEST_SHIFT).all(axis=1) & (faintest > _LEAST_AMPLITUDE * typical)
            # A mark of ink must not raise what the next windows have to show.
            level = 0.5 * (typical + np.minimum(faintest, 2.0 * typical))
            self._store(grid, cells[good], (lines[wanted] + off)[good], waves[wanted][good], level[good])
            grid.fit_waves(cells[good], self.places)

    def _lock_in(self, cells: IntArray, waves: FloatArray) -> tuple[FloatArray, FloatArray]:
        total = lock_in(self.density, self.places[tuple(cells.T)].astype(int), self.half, waves)
        return np.angle(total) / (2.0 * np.pi), np.abs(total)

    @staticmethod
    def _store(
        grid: _Grid, cells: IntArray, lines: FloatArray, waves: FloatArray, amplitude: FloatArray
    ) -> None:
        at = tuple(cells.T)
        grid.lines[at], grid.waves[at], grid.amplitude[at] = lines, waves, amplitude

    def _find_window(self, seed: _Seed) -> tuple[np.intp, ...]:
        away = np.where(self._usable, np.linalg.norm(self.places - seed.centre, axis=2), np.inf)
        return np.unravel_index(np.argmin(away), away.shape)

    def covers(self, grid: _Grid, seed: _Seed) -> bool:
        """Return whether the lines around a seed, or beside, were followed."""
        row, column = self._find_window(seed)
        return bool(grid.known[row - 1 : row + 2, column - 1 : column + 2].any())

    def require_same_sheet(self, sheet: _Grid, other: _Grid) -> None:
        """Refuse a second sheet, whose lines do not go on as the first's do."""
        near = cv2.dilate(sheet.known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        fresh = other.known & ~near
        if fresh.sum() < _LEAST_WINDOWS:
            return
        places = np.concatenate((self.places, np.ones((*fresh.shape, 1))), axis=2)
        trend = np.linalg.lstsq(places[sheet.known], sheet.waves[sheet.known].reshape(-1, 4), rcond=None)[0]
        expected = (places[fresh] @ trend).reshape(-1, 2, 2).mean(axis=0)
        for wave in other.waves[fresh].mean(axis=0):
            off = [np.linalg.norm(wave - sign * twin) for sign, twin in product((1.0, -1.0), expected)]
            if min(off) > _OTHER_SHEET * np.linalg.norm(wave):
                raise MeasurementRefusedError(
                    "the picture shows two sheets of ruled paper that do not lie alike",
                    "take one of them away",
                )


def lock_in(density: Density, centres: IntArray, half: int, waves: FloatArray) -> NDArray[np.complex128]:
    """Return the complex amplitudes (N, 2) of both families of lines in windows around pixels (N, 2)."""
    side = 2 * half + 1
    at = np.arange(-half, half + 1)
    taper = np.cos(0.5 * np.pi * at / (half + 1)) ** 2
    views = np.lib.stride_tricks.sliding_window_view(density, (side, side))
    block = max(_BLOCK_PX // side**2, 1)
    total = np.empty((len(centres), 2), dtype=np.complex128)
    for first in range(0, len(centres), block):
        part = slice(first, first + block)
        # Waves (N, 2 families, side) along u and v. The patches are real: real and imaginary part are two columns.
        across, down = (
            (taper * np.exp(-2j * np.pi * waves[part, :, axis, None] * at)).astype(np.complex64)
            for axis in (0, 1)
        )
        columns = np.concatenate((across.real, across.imag), axis=1).transpose(0, 2, 1)
        u, v = centres[part].T - half
        rows = np.matmul(views[v, u], columns)
        total[part] = np.einsum("nvf,nfv->nf", rows[..., :2] + 1j * rows[..., 2:], down)
    return np.asarray(total * (2.0 / taper.sum() ** 2))


@dataclass(frozen=True, eq=False)
class _Found:
    """Windows in the full picture: pixels (N, 2), lines (N, 2), waves (N, 2, 2), cells (N, 2)."""

    pixels: FloatArray
    lines: FloatArray
    waves: FloatArray
    cells: IntArray

    def spacings_px(self) -> FloatArray:
        """Return the distance between lines in each window, the mean of both families."""
        return np.asarray(np.abs(np.linalg.det(self.waves)) ** -0.5)


def _tabulate(grid: _Grid, windows: _Windows, factor: int) -> _Found:
    """Return the windows that were followed, in the full picture, at whole pixels."""
    cells = np.argwhere(grid.known)
    grid.fit_waves(cells, windows.places)
    at = tuple(cells.T)
    exact = (windows.places[at] + 0.5) * factor - 0.5
    pixels, waves = np.floor(exact), grid.waves[at] / factor
    return _Found(pixels, grid.lines[at] + np.einsum("nfx,nx->nf", waves, pixels - exact), waves, cells)


def _locate(density: Density, rough: _Found, half: int) -> _Found:
    """Return the windows with their places by a multiple of the lines' frequency, without those that do not fit in."""
    lines = rough.lines
    most = max(round(float(np.median(rough.spacings_px())) / _FINE_PX), 1)
    for multiple in sorted({1, max(most // 2, 1), most}):
        phases = np.angle(lock_in(density, rough.pixels.astype(int), half, multiple * rough.waves)) / (
            2.0 * np.pi
        )
        off = phases - multiple * lines
        lines = lines + (off - np.round(off)) / multiple
    good = np.abs(lines - rough.lines).max(axis=1) < _LARGEST_SHIFT
    table = np.full((*(rough.cells.max(axis=0) + 2), 2), np.nan)
    table[tuple(rough.cells[good].T)] = lines[good]
    pairs = np.array(
        [
            0.5 * (np.roll(table, step, axis=(0, 1)) + np.roll(table, np.negative(step), axis=(0, 1)))
            for step in ((0, 1), (1, 0), (1, 1), (1, -1))
        ]
    )[(slice(None), *rough.cells.T)]
    count = np.isfinite(pairs).sum(axis=0)
    middle = np.nansum(pairs, axis=0) / np.where(count > 0, count, np.nan)
    off = np.linalg.norm(lines - middle, axis=1)
    good &= ~(off > _OUTLIER * np.nanmedian(off))
    return _average(_Found(rough.pixels[good], lines[good], rough.waves[good], rough.cells[good]), half)


def _average(found: _Found, half: int) -> _Found:
    """Return the means of square blocks of windows where there are many, without the windows' bias."""
    side = max(round((len(found.cells) / _MANY_WINDOWS) ** 0.5), 1)
    _, block, size = np.unique(found.cells // side, axis=0, return_inverse=True, return_counts=True)
    # A block that lacks a window has no middle of its own.
    whole = np.flatnonzero(size == side**2)
    order = np.argsort(block.ravel(), kind="stable")[np.isin(np.sort(block.ravel()), whole)]

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(values[order].reshape(len(whole), side**2, *values.shape[1:]).mean(axis=1))

    pixels, lines = mean(found.pixels), mean(found.lines)
    variance = _TAPER_VARIANCE * (half + 1) ** 2 + (side**2 - 1) / 12.0 * half**2
    cells = found.cells[order][:: side**2] // side
    return _Found(pixels, lines - _find_bias(pixels, lines, variance), mean(found.waves), cells)


def _find_bias(pixels: FloatArray, lines: FloatArray, variance_px2: float) -> FloatArray:
    """Return by how much windows see lines (N, 2) off their middle, because lens and perspective bend the lines.

    A window measures the mean of the place over its pixels: half the Laplacian of the place times their variance. The
    place is a polynomial of third order over the picture here, whose Laplacian is linear.
    """
    scale = 0.5 * float(np.ptp(pixels))
    x, y = (pixels - pixels.mean(axis=0)).T / scale
    powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
    terms = np.column_stack([x**i * y**j for i, j in powers])
    bent = np.column_stack(
        [i * (i - 1) * x ** max(i - 2, 0) * y**j + j * (j - 1) * x**i * y ** max(j - 2, 0) for i, j in powers]
    )
    laplacian = bent @ np.linalg.lstsq(terms, lines, rcond=None)[0] / scale**2
    return np.asarray(0.5 * variance_px2 * laplacian)


def _require_scale(found: _Found, spacing_px: float, shape: tuple[int, ...]) -> None:
    """Refuse lines that are at no angle as far apart as stated, nearest to the middle of the picture."""
    middle = np.argmin(np.linalg.norm(found.pixels - 0.5 * np.array(shape[::-1]), axis=1))
    most, least = 1.0 / np.linalg.svd(found.waves[middle], compute_uv=False)[::-1]
    if most < (1.0 - LARGEST_SCALE_ERROR) * spacing_px or least > (1.0 + LARGEST_SCALE_ERROR) * spacing_px:
        raise _contradict(float(np.sqrt(most * least)), spacing_px)


def _contradict(seen_px: float, spacing_px: float) -> MeasurementRefusedError:
    return MeasurementRefusedError(
        f"the paper's nearest lines are {seen_px:.1f} px apart in the picture, and by the stated scale and pitch they "
        f"would be {spacing_px:.1f} px apart, which may be {100.0 * LARGEST_SCALE_ERROR:.0f} % off at the most",
        "measure the lines of the graph paper with a ruler, and the distance of the camera with a tape",
    )


def _require_these_lines(density: Density, found: _Found, half: int) -> None:
    """Refuse lines that are not the paper's nearest, or of which some are not there."""
    spacing_px = float(np.median(found.spacings_px()))
    chosen = np.linspace(0, len(found.pixels) - 1, min(len(found.pixels), _SPECTRUM_WINDOWS)).astype(int)
    pixels, lines, waves = found.pixels[chosen].astype(int), found.lines[chosen], found.waves[chosen]

    def measure(multiple: float) -> FloatArray:
        drawn = lock_in(density, pixels, half, multiple * waves)
        return np.asarray(np.abs(np.mean(drawn * np.exp(-2j * np.pi * multiple * lines), axis=0)))

    own = measure(1.0)
    for fraction, most in _FRACTIONS:
        if (measure(fraction) > most * own).all():
            raise _contradict(spacing_px / fraction, spacing_px)
    for number in (5, 10):
        beside = np.sqrt(measure(1.0 - 1.0 / number) * measure(1.0 + 1.0 / number))
        if (own < _STANDS_OUT * beside).all():
            raise _contradict(number * spacing_px, spacing_px)
    for number in _MULTIPLES:
        if spacing_px / number > _LEAST_PX:
            finer = measure(float(number))
            beside = own if number == 2 else np.maximum(measure(number - 1.0), measure(number + 1.0))
            if (finer > np.maximum(_STANDS_OUT * beside, _LEAST_FINER * own)).all():
                raise _contradict(spacing_px / number, spacing_px)


def _explain_no_lines(image: Picture, density: Density, spacing_px: float) -> MeasurementRefusedError:
    """Return why no lines were followed: others are seen, the picture is too bright, or there are none."""
    for ratio in _OTHER_SCALES:
        factor = max(round(spacing_px * ratio / _FOLLOWED_PX), 1)
        if spacing_px * ratio < _LEAST_PX or min(density.shape) // factor < _LEAST_SIDE_PX:
            continue
        seeds = _find_seeds(_shrink(density, factor), spacing_px * ratio / factor)
        if len(seeds) >= _LEAST_SUPPORT and seeds[0].strength > 2.0 * _LEAST_STRENGTH:
            return _contradict(factor / float(np.linalg.norm(seeds[0].waves, axis=1).mean()), spacing_px)
    if np.mean(image >= _OVEREXPOSED) > 0.5:
        return MeasurementRefusedError(
            "no grid of ruled lines in the picture, most of which is overexposed",
            "shorten the exposure until the graph paper is light grey",
        )
    return MeasurementRefusedError(
        f"no grid of ruled lines about {spacing_px:.1f} px apart in the picture",
        "show sharp, evenly lit graph paper, and check the stated scale and the pitch of the paper",
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
    factor = max(int(sigma_px / 4.5), 1)
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
    grey = image if image.ndim == 2 else image.max(axis=2)
    side = 2 * round(0.35 * spacing_px) + 3
    paper = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    level = np.log(np.maximum(cv2.GaussianBlur(paper.astype(np.float32), (0, 0), 0.3 * side), 1.0))
    window = np.ones((2 * half + 1, 2 * half + 1), np.uint8)
    return np.asarray(cv2.dilate(level, window) - cv2.erode(level, window) < _LARGEST_STEP)
