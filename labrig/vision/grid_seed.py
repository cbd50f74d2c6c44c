"""Where to begin with ruled lines: two directions and the distance between lines, in patches of the picture.

By the projection-slice theorem the power of a patch's spectrum along a ray is the variance of its line profile in that
direction. The variance of line profiles over 180 degrees peaks across the lines. (The gradient's direction, a histogram
of edges, peaks on the diagonals of thin or blurred lines, because the lines' ends and crossings dominate there.) Along
each of the two rays the spectrum peaks at the lines' frequency and its multiples. Both frequencies are chosen together:
the two families of a square grid have the same distance, up to the foreshortening of a slanted view.
"""

from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.vision.line_density import Density

_FloatArray = NDArray[np.float64]

_PATCH_PX, _LEAST_PATCH_PX = 128, 32
# Centres of the patches, as shares of the picture.
_PLACES = tuple(product((0.25, 0.5, 0.75), repeat=2))
# Frequencies that are looked at, in cycles per patch: below, slow light and single marks; above, less than three pixels
# from line to line.
_LEAST_CYCLES, _MOST_CYCLES_SHARE, _CYCLES_STEP = 5.0, 0.36, 0.5
# Lines that are too close to be followed, as shares of a patch's pixels: from 4.5 to 2 px from line to line.
_LEAST_FINE, _MOST_FINE = 0.22, 0.5
# Such lines are so close; so many patches show them; and lines further apart than this many times are not clearer.
_LARGEST_FINE_PX, _LEAST_FINE_SUPPORT, _COARSER = 3.95, 5, 1.2
_LEAST_ANGLE_DEG = 50
# Half the width, in degrees, over which rays are added, and that in which a ray's peak is searched.
_RAY_DEG, _PEAK_DEG = 2, 4
# Largest ratio of the two distances between lines: a view slanted by 40 degrees.
_LARGEST_RATIO = 1.3
# Power below this many times the median is noise.
_NOISE = 3.0
_LEAST_STRENGTH = 12.0
_MOST_CLIMBS = 5
# Waves of the same lines in two patches differ by less, as a share of them.
_ALIKE = 0.15
_DEGREES = 180


@dataclass(frozen=True, eq=False)
class Seed:
    """The grid around a pixel.

    Attributes
    ----------
    strength : float
        Power of the weaker direction's peak over that of noise (geometric mean of both).
    centre : ndarray (2,)
    waves : ndarray (2, 2)
        Rows: wave vectors of the two families of lines [cycles/px].
    support : int
        Number of patches, its own among them, that show the same lines.
    """

    strength: float
    centre: _FloatArray
    waves: _FloatArray
    support: int = 1

    @property
    def spacings_px(self) -> _FloatArray:
        """Return the distances (2,) between the lines of both families."""
        return np.asarray(1.0 / np.linalg.norm(self.waves, axis=1))


def find_seeds(density: Density) -> list[Seed]:
    """Return the grids in the patches of a picture: first those that most others agree with, the strongest first."""
    side = _choose_side(density)
    return _find_seeds(density, np.arange(_LEAST_CYCLES, _MOST_CYCLES_SHARE * side, _CYCLES_STEP))


def find_fine_spacing_px(density: Density) -> float | None:
    """Return the distance between lines in two directions that are too close to be followed; None for no such lines.

    A coarser pattern has multiples of its frequency there. They are weaker than the pattern itself.
    """
    side = _choose_side(density)
    seeds = _find_seeds(density, np.arange(_LEAST_FINE * side, _MOST_FINE * side, _CYCLES_STEP))
    if not seeds or seeds[0].support < _LEAST_FINE_SUPPORT or seeds[0].spacings_px.max() > _LARGEST_FINE_PX:
        return None
    fine_px = float(seeds[0].spacings_px.mean())
    clearer = (
        seed.strength > seeds[0].strength and seed.spacings_px.max() > _COARSER * fine_px
        for seed in find_seeds(density)
    )
    return None if any(clearer) else fine_px


def _choose_side(density: Density) -> int:
    height, width = density.shape
    side: int = min(_PATCH_PX, height, width) // 2 * 2
    return side


def _find_seeds(density: Density, cycles: _FloatArray) -> list[Seed]:
    """Return the grids with these frequencies [cycles per patch] in the patches."""
    height, width = density.shape
    side = _choose_side(density)
    if side < _LEAST_PATCH_PX:
        return []
    taper = np.hanning(side).astype(np.float32)
    found = []
    for across, down in _PLACES:
        left, top = (
            int(np.clip(share * extent - side / 2, 0, extent - side))
            for share, extent in ((across, width), (down, height))
        )
        patch = density[top : top + side, left : left + side]
        middle = np.array([left, top], dtype=np.float64) + side / 2
        seed = _find_seed((patch - patch.mean()) * taper[:, None] * taper, middle, cycles)
        if seed is not None:
            found.append(seed)
    supported = [replace(seed, support=sum(_agree(seed, other) for other in found)) for seed in found]
    return sorted(supported, key=lambda seed: (-seed.support, -seed.strength))


def _agree(seed: Seed, other: Seed) -> bool:
    """Return whether two seeds have the same lines, whichever family comes first."""
    return any(
        all(
            min(np.linalg.norm(wave - twin), np.linalg.norm(wave + twin)) < _ALIKE * np.linalg.norm(wave)
            for wave, twin in zip(seed.waves, waves, strict=True)
        )
        for waves in (other.waves, other.waves[::-1])
    )


def _find_seed(tapered: Density, centre: _FloatArray, cycles: _FloatArray) -> Seed | None:
    side = len(tapered)
    amplitude = np.abs(np.fft.fftshift(np.fft.fft2(tapered))).astype(np.float32)
    angles = np.deg2rad(np.arange(_DEGREES))[:, None]
    u, v = ((side // 2 + turn * cycles).astype(np.float32) for turn in (np.cos(angles), np.sin(angles)))
    power = np.asarray(cv2.remap(amplitude**2, u, v, cv2.INTER_LINEAR), dtype=np.float32)
    noise = float(np.median(power))
    if not noise > 0.0:
        return None
    rays = _find_rays(power, noise)
    if rays is None:
        return None
    profiles = [
        np.take(power, range(ray - _PEAK_DEG, ray + _PEAK_DEG + 1), axis=0, mode="wrap") for ray in rays
    ]
    strength, peaks = _choose_frequencies([profile.max(axis=0) for profile in profiles], cycles)
    if strength < _LEAST_STRENGTH * noise:
        return None
    waves = []
    for ray, profile, peak in zip(rays, profiles, peaks, strict=True):
        angle = np.deg2rad(ray - _PEAK_DEG + int(np.argmax(profile[:, peak])))
        start = side // 2 + cycles[peak] * np.array([np.cos(angle), np.sin(angle)])
        waves.append((_climb(amplitude, start) - side // 2) / side)
    return Seed(strength / noise, centre, np.array(waves))


def _find_rays(power: Density, noise: float) -> tuple[int, int] | None:
    """Return the two directions [degrees] in which line profiles vary most, at least 50 degrees apart."""
    sums = np.maximum(power - _NOISE * noise, 0.0).sum(axis=1)
    padded = np.concatenate((sums[-_RAY_DEG:], sums, sums[:_RAY_DEG]))
    smooth = np.convolve(padded, np.ones(2 * _RAY_DEG + 1), mode="valid")
    first = int(np.argmax(smooth))
    apart = np.abs((np.arange(_DEGREES) - first + _DEGREES // 2) % _DEGREES - _DEGREES // 2)
    away = np.where(apart >= _LEAST_ANGLE_DEG, smooth, 0.0)
    second = int(np.argmax(away))
    return (first, second) if away[second] > 0.0 else None


def _choose_frequencies(profiles: list[Density], cycles: _FloatArray) -> tuple[float, tuple[int, int]]:
    """Return the strength and the indices of the strongest pair of peaks whose frequencies are alike."""
    first, second = profiles
    best, chosen = 0.0, (0, 0)
    for i in range(1, len(cycles) - 1):
        if first[i] < max(first[i - 1], first[i + 1]):
            continue
        alike = np.flatnonzero(np.abs(np.log(cycles / cycles[i])) < np.log(_LARGEST_RATIO))
        j = int(alike[np.argmax(second[alike])])
        strength = float(np.sqrt(first[i] * second[j]))
        if strength > best:
            best, chosen = strength, (i, j)
    return best, chosen


def _climb(amplitude: Density, start: _FloatArray) -> _FloatArray:
    """Return the summit (u, v) near `start`, to a fraction of a bin by parabolas through its logarithm."""
    u, v = (round(value) for value in start.tolist())
    for _ in range(_MOST_CLIMBS):
        around = amplitude[v - 1 : v + 2, u - 1 : u + 2]
        if around.shape != (3, 3):
            return start
        down, across = divmod(int(np.argmax(around)), 3)
        if (down, across) == (1, 1):
            break
        u, v = u + across - 1, v + down - 1
    around = np.log(np.maximum(amplitude[v - 1 : v + 2, u - 1 : u + 2], np.finfo(np.float32).tiny))
    if around.shape != (3, 3):
        return start
    return np.array([u + _find_summit(around[1]), v + _find_summit(around[:, 1])])


def _find_summit(three: Density) -> float:
    """Return where the parabola through three values has its summit, from the middle one; at most half a step."""
    bend = 2.0 * float(three[1]) - float(three[0]) - float(three[2])
    return float(np.clip(0.5 * (float(three[2]) - float(three[0])) / bend, -0.5, 0.5)) if bend > 0.0 else 0.0
