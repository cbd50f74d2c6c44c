"""The density across a family of ruled lines, averaged along them over the whole sheet.

Noise nearly vanishes in it, and what is printed every millimetre stands out: in the profile itself, and in its
spectrum where lines are not resolved.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

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
# Places between the harmonics where the spectrum holds noise alone: heavier lines every 5 or 10 have theirs at tenths.
_NOISE_AT = (-0.45, -0.35, -0.25, 0.25, 0.35, 0.45)
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

    def to_absorption(self) -> "Profile":
        """Return the profile of the light that the lines take: blur adds up light, and densities only where faint.

        In densities, harmonics of dark lines that blur has weakened are products of the lower ones.
        """
        return replace(self, density=-np.exp(-self.density))


@dataclass(frozen=True, eq=False)
class Harmonics:
    """The spectrum of a profile at multiples of the visible lines' frequency; a line's part is real and positive."""

    profile: Profile
    step: float
    offset: float

    @classmethod
    def of(cls, profile: Profile, comb: Comb) -> "Harmonics":
        """Return the spectrum of the lines of a comb, whose place is taken from the first harmonic."""
        first = cls(profile, comb.step, comb.offset)
        shift = float(np.angle(first.at((1.0,))[0]) / (2.0 * np.pi))
        return cls(profile, comb.step, comb.offset + shift * comb.step)

    def at(self, frequencies: Iterable[float]) -> NDArray[np.complex128]:
        """Return the amplitudes at frequencies, in cycles per step between visible lines."""
        seen = np.isfinite(self.profile.density)
        places = (self.profile.places[seen] - self.offset) / self.step
        taper = np.sin(np.pi * (places - places[0]) / max(np.ptp(places), 1.0)) ** 2
        density = self.profile.density[seen]
        density = density - np.average(density, weights=np.maximum(taper, 1e-9))
        phases = 2.0 * np.pi * np.array(list(frequencies))[:, None] * places
        weights = 2.0 * taper * density / taper.sum()
        # Half the time of a complex exponential.
        return np.asarray(np.cos(phases) @ weights + 1j * (np.sin(phases) @ weights))

    def excess(self, number: float) -> tuple[float, float, float, float]:
        """Return a harmonic's excess over what its neighbours predict, the noise of that, their size and the least.

        Between harmonics, where `number` is no whole one, the neighbours are whole steps away too.
        """
        near = self.at(number + np.arange(-2.0, 3.0)).real
        # Harmonics of a broad line fall so steeply that their trend runs below zero: nothing would exceed it by itself.
        predicted = max((4.0 * (near[1] + near[3]) - near[0] - near[4]) / 6.0, 0.0)
        noise = 1.4 * self.noise(number)
        beside = np.delete(near, 2)
        return float(near[2] - predicted), noise, float(np.abs(beside).mean()), float(beside.min())

    def noise(self, number: float) -> float:
        """Return the standard deviation of the noise of a harmonic, from what is beside it."""
        return float(np.sqrt(np.mean(np.abs(self.at(number + np.array(_NOISE_AT))) ** 2) / 2.0))

    def width(self) -> float:
        """Return the standard deviation of a line's profile, in steps, from the first two harmonics."""
        first, second = np.maximum(self.at((1.0, 2.0)).real, np.finfo(float).tiny)
        return float(np.sqrt(max(np.log(first / second), 0.0) / (6.0 * np.pi**2)))

    def thickness(self) -> float:
        """Return the width of a line, in steps, times its density."""
        return float(0.5 * self.at((1.0,))[0].real * np.exp(2.0 * (np.pi * self.width()) ** 2))


def measure_profile(
    density: Density, grid: TrackedGrid, axis: int, most_windows: int = _MOST_WINDOWS
) -> Profile:
    """Return the mean density across the lines of one family, averaged along them over so many windows."""
    chosen = slice(None, None, len(grid.pixels) // most_windows + 1)
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
