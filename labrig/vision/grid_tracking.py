"""Ruled lines followed over the picture by their phase.

In a window of a few lines the density is multiplied by the complex wave of a family of lines: the angle of the sum is
the window's place between two lines (lock-in; geometric phase analysis, Hytch, Snoeck & Kilaas 1998). Heavier lines are
in phase with finer ones, so the weights of lines do not matter; noise and marks average out over the window. From one
window to the next the wave predicts the place, and the windows so count the lines. A window whose phase is further off
than a share of the distance between lines, or whose lines are much fainter than its neighbours', is left out: it lies
beyond the paper's edge, or under something.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.vision.grid_seed import Seed
from labrig.vision.line_density import Density

_FloatArray = NDArray[np.float64]
_IntArray = NDArray[np.int64]

# Half the width of a window and the distance of windows, in distances between lines: close lines, far lines. Far lines
# are located one by one, and their windows have to reach near the picture's edge.
_CLOSE_PX = 12.0
_CLOSE, _FAR = (2.5, 2.0), (1.6, 1.0)
_LEAST_HALF_PX, _LEAST_SPACING_PX = 6.0, 8
# Largest difference of a phase from its prediction, in distances between lines.
_LARGEST_SHIFT = 0.15
# Least amplitude of a window's fainter family of lines, as a share of its neighbours'.
_LEAST_AMPLITUDE = 0.35
_MOST_TRIES = 4
# Least sine of the angle between both families of lines.
_LEAST_SINE = 0.5
# Largest ratio of the distances between lines of both families: a view slanted by 40 degrees.
_LARGEST_RATIO = 1.35
# Cells around a cell whose phases give its waves, and the least determinant of their spread, in squared spacings.
_REACH = 2
_LEAST_SPREAD = 3.0
# Waves are even within this share of them; fits of the waves by least distances, and what counts as no distance.
_LARGEST_DEVIATION, _FITS, _EXACT = 0.1, 8, 0.01
_LEAST_EVEN, _MOST_COMPARED = 12, 1500
_NEAR, _AROUND = (
    np.array([step for step in product(range(-reach, reach + 1), repeat=2) if step != (0, 0)])
    for reach in (1, _REACH)
)


@dataclass(frozen=True, eq=False)
class TrackedGrid:
    """Windows in which both families of lines were followed.

    Attributes
    ----------
    pixels : ndarray (N, 2)
        Their middles (u, v).
    coordinates : ndarray (N, 2)
        Their places among the lines of both families; at a line the coordinate is an integer.
    waves : ndarray (N, 2, 2)
        Rows: how the coordinates change by pixel.
    share : float
        Of all windows of the picture.
    amplitude : float
        Median density of the fainter family of lines, as the amplitude of its wave.
    """

    pixels: _FloatArray
    coordinates: _FloatArray
    waves: _FloatArray
    share: float
    amplitude: float

    @property
    def pitch_px(self) -> float:
        """Return the median distance between lines, of the closer family."""
        return float(np.median(1.0 / np.linalg.norm(self.waves, axis=2).max(axis=1)))

    def is_square(self) -> bool:
        """Return whether both families of lines are alike: one can have been followed at twice its frequency."""
        first, second = (
            np.median(np.linalg.norm(self.waves, axis=2), axis=0) if len(self.waves) else (0.0, 1.0)
        )
        return bool(max(first, second) < _LARGEST_RATIO * min(first, second))

    @cached_property
    def even_share(self) -> float:
        """Return the share of the picture's windows whose waves change slowly over the picture, as perspective has it.

        Windows that follow the lines at a wrong frequency, beside a trace of ink for instance, differ from the others.
        """
        return self.share * float(np.mean(self._is_even())) if len(self.pixels) >= _LEAST_EVEN else 0.0

    @property
    def clarity(self) -> float:
        """Return how much of the picture shows the lines, and how dark: a faint wave everywhere is none of lines."""
        return float(self.even_share * np.sqrt(self.amplitude))

    def _is_even(self) -> NDArray[np.bool_]:
        """Return which of some waves are near a quadratic function of the place, fitted by least distances."""
        chosen = slice(None, None, len(self.pixels) // _MOST_COMPARED + 1)
        pixels, waves = self.pixels[chosen], self.waves[chosen].reshape(-1, 4)
        u, v = ((pixels - pixels.mean(axis=0)) / np.ptp(pixels, axis=0).max()).T
        terms = np.column_stack((np.ones(len(u)), u, v, u * u, u * v, v * v))
        weights = np.ones((len(u), 1))
        for _ in range(_FITS):
            # Normal equations: the terms are within -1 and 1, and a least-squares solver takes ten times as long.
            weighted = (terms * weights**2).T
            fitted = terms @ np.linalg.lstsq(weighted @ terms, weighted @ waves, rcond=None)[0]
            off = np.linalg.norm((fitted - waves).reshape(-1, 2, 2), axis=2)
            off = (off / np.linalg.norm(fitted.reshape(-1, 2, 2), axis=2)).max(axis=1)
            weights = np.maximum(off, _EXACT)[:, None] ** -0.5
        return np.asarray(off < _LARGEST_DEVIATION)

    def enlarge(self, factor: int) -> "TrackedGrid":
        """Return the windows in a picture that is larger by a factor."""
        pixels = (self.pixels + 0.5) * factor - 0.5
        return replace(self, pixels=pixels, waves=self.waves / factor)


class _Windows:
    """The windows of a picture: their middles in rows and columns, and their lock-in."""

    def __init__(self, density: Density, pitch_px: float) -> None:
        half, spacing = _CLOSE if pitch_px < _CLOSE_PX else _FAR
        reach = max(half * pitch_px, _LEAST_HALF_PX)
        self._half = int(min(reach, (min(density.shape) - 1) // 2))
        self._at = np.arange(-self._half, self._half + 1)
        self._taper = np.cos(0.5 * np.pi * self._at / reach) ** 2
        self.spacing = max(round(spacing * pitch_px), _LEAST_SPACING_PX)
        self.v, self.u = (self._place(extent) for extent in density.shape)
        side = 2 * self._half + 1
        self._views = np.lib.stride_tricks.sliding_window_view(density, (side, side))

    def _place(self, extent: int) -> _IntArray:
        free = extent - 1 - 2 * self._half
        return np.arange(self._half + free % self.spacing // 2, extent - self._half, self.spacing)

    def lock_in(self, cells: _IntArray, waves: _FloatArray) -> tuple[_FloatArray, _FloatArray]:
        """Return the phases (N, 2), from -0.5 to 0.5, and the amplitudes (N, 2) of both families of lines."""
        corners = self.v[cells[:, 0]] - self._half, self.u[cells[:, 1]] - self._half
        # Waves (N, 2 families, side) along u and v. The patches are real: real and imaginary part are two columns.
        across, down = (
            (self._taper * np.exp(-2j * np.pi * part[..., None] * self._at)).astype(np.complex64)
            for part in (waves[..., 0], waves[..., 1])
        )
        columns = np.concatenate((across.real, across.imag), axis=1).transpose(0, 2, 1)
        rows = np.matmul(self._views[corners], columns)
        total = np.einsum("nvf,nfv->nf", rows[..., :2] + 1j * rows[..., 2:], down)
        return np.angle(total) / (2.0 * np.pi), 2.0 * np.abs(total) / self._taper.sum() ** 2


def track_grid(density: Density, seed: Seed) -> TrackedGrid | None:
    """Follow the lines from a seed over the picture; None if the picture is too small for windows."""
    windows = _Windows(density, 1.0 / float(np.linalg.norm(seed.waves, axis=1).max()))
    if min(len(windows.u), len(windows.v)) < 2:
        return None
    cells = _Cells(len(windows.v), len(windows.u))
    start = np.array(
        [[np.argmin(np.abs(windows.v - seed.centre[1])), np.argmin(np.abs(windows.u - seed.centre[0]))]]
    )
    phases, amplitudes = windows.lock_in(start, seed.waves[None])
    cells.store(start, phases, seed.waves[None], amplitudes.min(axis=1))
    while len(wanted := cells.find_wanted()):
        predicted, waves, amplitude = cells.predict(wanted, windows.spacing)
        phases, amplitudes = windows.lock_in(wanted, waves)
        off = phases - predicted
        off -= np.round(off)
        faintest = amplitudes.min(axis=1)
        good = (np.abs(off) < _LARGEST_SHIFT).all(axis=1) & (faintest > _LEAST_AMPLITUDE * amplitude)
        # A mark of ink must not raise what the next windows have to show.
        typical = 0.5 * (amplitude + np.minimum(faintest, 2.0 * amplitude))
        cells.store(wanted[good], (predicted + off)[good], waves[good], typical[good])
        cells.update_waves(wanted[good], windows.spacing)
    return cells.collect(windows)


class _Cells:
    """What is known of the windows, in tables with a margin of unknown ones."""

    def __init__(self, rows: int, columns: int) -> None:
        shape = rows + 2 * _REACH, columns + 2 * _REACH
        self._coordinates = np.full((*shape, 2), np.nan)
        self._waves = np.full((*shape, 2, 2), np.nan)
        self._amplitude = np.full(shape, np.nan)
        self._tries = np.zeros(shape, dtype=int)
        self._inside = np.zeros(shape, dtype=bool)
        self._inside[_REACH:-_REACH, _REACH:-_REACH] = True

    def store(
        self, cells: _IntArray, coordinates: _FloatArray, waves: _FloatArray, amplitude: _FloatArray
    ) -> None:
        at = tuple((cells + _REACH).T)
        self._coordinates[at], self._waves[at], self._amplitude[at] = coordinates, waves, amplitude

    def find_wanted(self) -> _IntArray:
        """Return unknown cells beside known ones; again, up to four times, if more of their neighbours are known."""
        known = np.isfinite(self._amplitude)
        count = cv2.boxFilter(known.astype(np.float32), -1, (3, 3), normalize=False).astype(int) - known
        wanted = self._inside & ~known & (count > self._tries) & (self._tries < _MOST_TRIES)
        self._tries[wanted] = np.maximum(count[wanted], self._tries[wanted])
        return np.argwhere(wanted) - _REACH

    def predict(self, cells: _IntArray, spacing: int) -> tuple[_FloatArray, _FloatArray, _FloatArray]:
        """Return coordinates (N, 2), waves (N, 2, 2) and amplitudes (N,) as the neighbours have them."""
        at = self._list_around(cells, _NEAR)
        known = np.isfinite(self._amplitude[at])
        back = -float(spacing) * _NEAR[:, ::-1]
        waves = np.where(known[..., None, None], self._waves[at], 0.0)
        places = np.where(known[..., None], self._coordinates[at], 0.0)
        places += waves[..., 0] * back[:, :1] + waves[..., 1] * back[:, 1:]
        amplitudes = np.where(known, self._amplitude[at], 0.0)
        count = known.sum(axis=1)
        return (
            places.sum(axis=1) / count[:, None],
            waves.sum(axis=1) / count[:, None, None],
            amplitudes.sum(axis=1) / count,
        )

    def update_waves(self, cells: _IntArray, spacing: int) -> None:
        """Fit the waves of cells to the coordinates around them, where these are spread enough."""
        here = self._coordinates[tuple((cells + _REACH).T)]
        away = self._coordinates[self._list_around(cells, _AROUND)] - here[:, None]
        known = np.isfinite(away[..., 0])
        steps = float(spacing) * _AROUND[:, ::-1]
        pairs = (steps[:, :, None] * steps[:, None]).reshape(-1, 4)
        spread = (known.astype(np.float64) @ pairs).reshape(-1, 2, 2)
        change = np.where(known[..., None], away, 0.0).transpose(0, 2, 1) @ steps
        good = np.linalg.det(spread) > _LEAST_SPREAD * spacing**4
        self._waves[tuple((cells[good] + _REACH).T)] = change[good] @ np.linalg.inv(spread[good])

    @staticmethod
    def _list_around(cells: _IntArray, steps: _IntArray) -> tuple[_IntArray, _IntArray]:
        """Return the rows and columns (N, K) in the tables of the cells around cells."""
        around = cells[:, None] + _REACH + steps
        return around[..., 0], around[..., 1]

    def collect(self, windows: _Windows) -> TrackedGrid:
        sizes = np.linalg.norm(self._waves, axis=-1).prod(axis=-1)
        area = (
            self._waves[..., 0, 0] * self._waves[..., 1, 1] - self._waves[..., 0, 1] * self._waves[..., 1, 0]
        )
        known = np.argwhere(np.abs(area) > _LEAST_SINE * sizes)
        at, cells = tuple(known.T), known - _REACH
        pixels = np.column_stack((windows.u[cells[:, 1]], windows.v[cells[:, 0]])).astype(np.float64)
        share = len(known) / (len(windows.u) * len(windows.v))
        amplitude = float(np.median(self._amplitude[at])) if len(known) else 0.0
        return TrackedGrid(pixels, self._coordinates[at], self._waves[at], share, amplitude)
