"""The density across a family of ruled lines, averaged along them over the whole sheet.

Noise nearly vanishes in it, and what is printed every millimetre stands out.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.vision.grid_tracking import TrackedGrid
from labrig.vision.line_density import Density

_FloatArray = NDArray[np.float64]

# Where the density is sampled along a line, in steps to the next line: evenly over three cells, as lines may be dotted.
_ALONG = (np.arange(18) + 0.5) / 6.0 - 1.0
# Samples across: each window gives three lines, in steps of at most 0.8 px.
_LINES_PER_WINDOW = 3
_SAMPLE_PX = 0.8
_LEAST_SAMPLES, _MOST_SAMPLES = 30, 160
_MOST_WINDOWS = 500
_LEAST_COUNT = 3
# The samples of a line's profile, in steps from the line.
ACROSS = (np.arange(60) + 0.5) / 60.0 - 0.5


@dataclass(frozen=True)
class Comb:
    """Evenly spaced lines: their step and the place of one, in steps that were followed."""

    step: float
    offset: float

    def divide(self, number: int) -> "Comb":
        """Return the comb with so many lines for every one."""
        return Comb(self.step / number, self.offset)


@dataclass(frozen=True, eq=False)
class LineTable:
    """The profiles (L, S) around lines, at `ACROSS`; NaN beyond the sheet. `first` is the number of the first line."""

    first: int
    profiles: _FloatArray

    def fold(self, period: int) -> _FloatArray:
        """Return the median profiles (period, S) of the lines that have the same number modulo the period.

        A median is not moved by a line at the paper's edge or by a mark along a line.
        """
        folded = np.full((period, self.profiles.shape[1]), np.nan)
        for residue in range(period):
            lines = self.profiles[(residue - self.first) % period :: period]
            seen = lines[np.isfinite(lines).all(axis=1)]
            if len(seen):
                folded[residue] = np.median(seen, axis=0)
        return folded


@dataclass(frozen=True, eq=False)
class Profile:
    """The mean density across a family of lines.

    `places` (K,) are in steps that were followed, evenly spaced; `density` (K,) is NaN where no window reached;
    `step_px` is the step in pixels.
    """

    places: _FloatArray
    density: _FloatArray
    step_px: float

    def cut(self, comb: Comb) -> LineTable:
        """Return the profiles around the lines of a comb, from half a step before to half a step after."""
        step, offset = comb.step, comb.offset
        first = int(np.ceil((self.places[0] - offset) / step + 0.5))
        last = int(np.floor((self.places[-1] - offset) / step - 0.5))
        lines = np.arange(first, max(last, first) + 1)
        at = offset + step * (lines[:, None] + ACROSS)
        return LineTable(first, np.interp(at, self.places, self.density, left=np.nan, right=np.nan))


def measure_profile(density: Density, grid: TrackedGrid, axis: int) -> Profile:
    """Return the mean density across the lines of one family, averaged along them."""
    chosen = slice(None, None, len(grid.pixels) // _MOST_WINDOWS + 1)
    across, along = (np.linalg.inv(grid.waves[chosen])[:, :, family] for family in (axis, 1 - axis))
    step_px = float(np.median(np.linalg.norm(across, axis=1)))
    samples = int(np.clip(np.ceil(step_px / _SAMPLE_PX), _LEAST_SAMPLES, _MOST_SAMPLES))
    here, beside = grid.coordinates[chosen, axis], grid.coordinates[chosen, 1 - axis]
    first_sample = np.round((np.round(here) - 0.5 * (_LINES_PER_WINDOW - 1)) * samples).astype(int)
    places = (np.arange(_LINES_PER_WINDOW * samples) + 0.5) / samples - 0.5
    start = grid.pixels[chosen] + (first_sample / samples - here)[:, None] * across
    px = (start[:, None] + places[:, None] * across[:, None]).astype(np.float32)
    values = np.zeros((len(here), len(places)))
    for at in _ALONG:
        moved = (np.floor(beside) + at - beside)[:, None] * along
        values += sample(density, px + moved[:, None].astype(np.float32))
    values /= len(_ALONG)
    low = int(first_sample.min())
    numbers = (first_sample - low)[:, None] + np.arange(len(places))
    seen = np.isfinite(values)
    total = np.bincount(numbers[seen], values[seen], int(numbers.max()) + 1)
    count = np.bincount(numbers[seen], minlength=int(numbers.max()) + 1)
    mean = np.where(count >= _LEAST_COUNT, total / np.maximum(count, 1), np.nan)
    return Profile((low + np.arange(len(mean)) + 0.5) / samples - 0.5, mean, step_px)


def sample(density: Density, px: _FloatArray) -> _FloatArray:
    """Return the density at pixels (N, M, 2); NaN outside the picture."""
    maps = np.ascontiguousarray(px, dtype=np.float32)
    found = cv2.remap(
        density,
        maps[..., 0],
        maps[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=np.nan,
    )
    return np.asarray(found, dtype=np.float64)
