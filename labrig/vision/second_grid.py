"""Whether a picture shows a second grid of lines, for instance drawn by hand on graph paper.

Either of two grids can be the clearer one, and nothing in it tells that the other one is the paper's. So the lines that
were followed are taken out of the picture, and a grid is searched for between them.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.grid_seed import find_seeds
from labrig.vision.grid_tracking import TrackedGrid, track_grid
from labrig.vision.line_density import Density, blur, halve
from labrig.vision.ruling import Ruling

_FloatArray = NDArray[np.float64]

# Order of the polynomial that gives the place among the lines at any pixel, and its fits without outliers.
_ORDER = 5
_FITS, _LARGEST_MISFIT = 3, 0.1
_LEAST_WINDOWS = 60
# Half the width of a line that is taken out [px], and its limits in distances between lines.
_LINE_PX, _LEAST_REACH, _MOST_REACH = 3.0, 0.1, 0.25
# Lines far apart may be blurred more: that in standard deviations of their profile, its limit, and how much more at the
# least. What is taken out in vain hides a second grid.
_FAR_PX, _BROAD, _MOST_BROAD, _BROADER = 13.0, 2.5, 0.4, 2.0
_LEVELS, _LEAST_LEVEL_PX = 3, 200
# A second grid is followed over at least this share of what the first covers, and at least so dark for it.
_LEAST_SHARE, _LEAST_AMPLITUDE = 0.3, 0.06
# So many patches of the picture show the same second grid, at least: what is left of a trace differs between them.
_LEAST_SUPPORT = 3
# Its waves are no multiples of those of the first: they differ by this much, in parts of the first's longest period.
_LEAST_DIFFERENCE = 0.15
_COMPARED = 100
_FINER, _LEAST_FINER = 2.5, 0.1
# Lines that are too fine to count would look like others in a smaller picture.
_BLUR_PX = 1.0


def require_single_grid(density: Density, grid: TrackedGrid, ruling: Ruling) -> None:
    """Refuse a picture in which a second grid of lines is left when the first is taken out.

    Raises
    ------
    MeasurementRefusedError
        With the distances between the lines of both.
    """
    period = 1 if ruling.rhythm is None else max(ruling.rhythm.heaviest // ruling.hidden, 1)
    rest = _take_out(density, grid, ruling)
    if rest is None:
        return
    for number, level in enumerate(halve(blur(rest, _BLUR_PX), _LEVELS, _LEAST_LEVEL_PX)):
        seeds = find_seeds(level)
        found = track_grid(level, seeds[0]) if seeds and seeds[0].support >= _LEAST_SUPPORT else None
        if found is None or found.even_share < _LEAST_SHARE * grid.share:
            continue
        second = found.enlarge(2**number)
        if second.amplitude < _LEAST_AMPLITUDE * grid.amplitude:
            continue
        if _is_other(second, grid, ruling, period):
            raise MeasurementRefusedError(
                f"the picture shows two grids of lines, {grid.pitch_px * min(ruling.steps):.1f} and "
                f"{second.pitch_px:.1f} px apart",
                "show graph paper on which nothing else is ruled",
            )


def _take_out(density: Density, grid: TrackedGrid, ruling: Ruling) -> Density | None:
    """Return the density between the lines, 0 on them and beyond the grid; None for too few windows."""
    places = _find_places(density.shape, grid)
    if places is None:
        return None
    bare = _cover(density.shape, grid)
    for place, step, offset in zip(places, ruling.steps, ruling.offsets, strict=True):
        line = (place - offset) / step
        reach = _choose_reach(step * grid.pitch_px, ruling.width)
        bare &= np.abs(line - np.round(line)) > reach
    level = float(density[bare].mean()) if bare.any() else 0.0
    return np.asarray(np.where(bare, density - level, 0.0), dtype=np.float32)


def _choose_reach(spacing_px: float, width: float) -> float:
    """Return half the width that a line is taken out with, in distances between lines."""
    thin = float(np.clip(_LINE_PX / spacing_px, _LEAST_REACH, _MOST_REACH))
    broad = min(_BROAD * width, _MOST_BROAD) if spacing_px > _FAR_PX else 0.0
    return broad if broad > _BROADER * thin else thin


def _find_places(shape: tuple[int, ...], grid: TrackedGrid) -> list[_FloatArray] | None:
    """Return the place among the lines of each family (H, W) at every pixel, by a polynomial fit to the windows."""
    extent = np.array(shape[::-1], dtype=np.float64)
    kept = np.ones(len(grid.pixels), dtype=bool)
    terms = _list_terms(2.0 * grid.pixels / extent - 1.0)
    for _ in range(_FITS):
        if kept.sum() < _LEAST_WINDOWS:
            return None
        # Normal equations: places are within -1 and 1, and a least-squares solver takes ten times as long.
        used = terms[kept]
        found = np.linalg.solve(used.T @ used, used.T @ grid.coordinates[kept])
        kept = np.abs(terms @ found - grid.coordinates).max(axis=1) < _LARGEST_MISFIT
    u, v = (2.0 * np.arange(size) / size - 1.0 for size in shape[::-1])
    powers = np.zeros((2, _ORDER + 1, _ORDER + 1))
    for number, (across, down) in enumerate(_EXPONENTS):
        powers[:, across, down] = found[number]
    return [
        np.asarray(
            np.vander(v, _ORDER + 1, increasing=True) @ (np.vander(u, _ORDER + 1, increasing=True) @ family).T
        )
        for family in powers
    ]


_EXPONENTS = tuple((i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i))


def _list_terms(places: _FloatArray) -> _FloatArray:
    return np.column_stack([places[:, 0] ** i * places[:, 1] ** j for i, j in _EXPONENTS])


def _cover(shape: tuple[int, ...], grid: TrackedGrid) -> NDArray[np.bool_]:
    """Return the convex hull (H, W) of the windows."""
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.round(grid.pixels).astype(np.int32)), 1)
    return np.asarray(mask > 0)


def _is_other(second: TrackedGrid, first: TrackedGrid, ruling: Ruling, period: int) -> bool:
    """Return whether the waves of a second grid are neither multiples nor divisors of those of the first."""
    chosen = slice(None, None, len(second.pixels) // _COMPARED + 1)
    away = np.linalg.norm(second.pixels[chosen, None] - first.pixels, axis=2)
    base = first.waves[np.argmin(away, axis=1)] / np.array(ruling.steps)[:, None] / period
    multiples = np.median(second.waves[chosen] @ np.linalg.inv(base), axis=0)
    divisors = np.linalg.inv(multiples)
    alone = all(np.abs(found - np.round(found)).max() > _LEAST_DIFFERENCE for found in (multiples, divisors))
    # Lines at a multiple of the frequency are finer ones between; a faint multiple is the lines' own shape.
    finer = ruling.hidden == 1 and np.abs(multiples).max() > _FINER * period
    return alone or (finer and second.amplitude > _LEAST_FINER * first.amplitude)
