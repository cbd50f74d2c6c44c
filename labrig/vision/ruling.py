"""Which lines of a sheet were followed: the finest, or heavier ones between which finer lines are too faint to follow.

A scale is wrong by 5 or 10 without any residual if 5 or 10 mm lines are counted as 1 mm lines. So the density is
averaged along the lines into one profile across each family of lines, over the whole sheet: noise nearly vanishes in
it, and what is printed every millimetre stands out. The profiles answer three questions.

- Which of the positions that were followed have a line? The phase can follow a multiple of the lines' frequency.
- Are there finer lines between? Where they are resolved they are seen in the profile. Where they are not, they still
  add to one harmonic of the profile, 5 or 10, which the harmonics beside it do not have.
- Which lines are heavier? Paper has heavier lines every 5 or 10 mm, so their rhythm tells the distance of the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

from labrig.errors import MeasurementRefusedError
from labrig.vision.grid_tracking import TrackedGrid
from labrig.vision.line_density import Density
from labrig.vision.line_profile import ACROSS, Comb, Harmonics, LineTable, Profile, measure_profile, sample
from labrig.vision.lines_between import Spectra, find_undecided, require_no_lines_between
from labrig.vision.uneven_lines import require_even_lines, require_finer_lines

_FloatArray = NDArray[np.float64]

# A position has a line, or none, if its line is at least or less than so dark, as a share of the heaviest lines.
_LEAST_WEIGHT, _MOST_BARE = 0.05, 0.1
# Part of a profile, in steps from its line, in which the line is measured.
_LINE_REACH = 0.35
_FLANK = 0.32
_MERGES = (2, 3, 5)
# Numbers of steps between the lines that were followed, and the least weight of the lines there: 5 mm lines midway
# between 10 mm lines are heavier than the finest.
_DIVISIONS = {10: 0.05, 5: 0.05, 2: 0.2}
# Lines closer than this are not seen one by one.
_LEAST_SEEN_PX = 3.5
_MOST_CHANGES = 6
# Numbers of finer steps between two lines that are looked for where the finer lines are not resolved: at such distances
# of the finer lines. Still finer ones leave no trace in the pixels.
_HIDDEN = (5, 10)
_LEAST_HIDDEN_PX, _RESOLVED_PX = 1.5, 8.0
# An excess of a harmonic counts above so many times the spectrum's noise, and this share of the first harmonic.
_EXCESS_SIGMAS, _LEAST_EXCESS = 6.0, 0.004
# Finer lines are excluded if they would exceed that by this factor.
_SURE = 1.25
# Finer lines double a harmonic, or more; less is the lines' own width.
_BESIDE = 0.5
_BELOW_ZERO = 5.0
# Harmonics of lines so close are so weak that a profile over more windows has to show them.
_CLOSE_PX, _MANY_WINDOWS = 13.0, 2000
# Five and ten: a rhythm of two says that the finest lines are not seen, or that there are none.
_PAIR = 2
# Weight of the finest lines of a sheet as a share of the heaviest, at the least: width times darkness. Lines that a pen
# has drawn over are heavier than printed ones.
_FAINTEST_FINE = 0.18
_RHYTHMS = tuple(range(2, 13))
# Least share of the variance of the lines' weights that a rhythm explains, and how little less than the best it may.
_LEAST_RHYTHM, _AS_GOOD = 0.5, 0.9
# Few lines have some rhythm by chance: 0.01 for lines that a pen drew, 4e-5 at the most for printed rhythms.
_LARGEST_CHANCE = 1e-3
_LEAST_HEAVIER = 1.15
# Number of lines with which the weight of a line is compared: light and focus change slowly.
_AROUND = 20
_HEAVY_QUANTILE, _LARGEST_WEIGHT = 0.95, 1.8
# Least share of the mean cell's variance that lines in two directions explain.
_LEAST_LINE_SHARE = 0.6
# Lines further apart than this are narrower than their gaps, and run on between crossings at least so dark.
_RESOLVED_CELL_PX, _MOST_COVER, _LEAST_RUN = 13.0, 0.44, 0.4
# A window samples its mean cell at these places, in steps that were followed.
_NEAR, _CELL_WINDOWS = (np.arange(7) + 0.5) / 7.0 - 0.5, 2000
# A window is brighter than others if it is below the middle of all by so many times the distance to this quantile.
_PLAIN_QUANTILE, _BRIGHT = 0.3, 7.0
_SHIFTS = np.array([0.618034, 0.754878])
_SAMPLES_PER_LINE, _LEAST_CELL_SAMPLES = 6, 24
_LARGEST_RATIO = 1.35
# Lines are not thicker than this share of their distance, times their density; chequers are.
_THICKEST = 0.4
# Closer lines could be another pattern, folded over by the pixels: lines 1.5 px apart look as if they were 3 px apart.
_LEAST_SPACING_PX = 3.0


@dataclass(frozen=True)
class Rhythm:
    """Every `heavy`th line is heavier than others, and every `heaviest`th the heaviest: the same number if alike."""

    heavy: int
    heaviest: int


@dataclass(frozen=True)
class Ruling:
    """How the lines that were followed relate to those of the sheet.

    Attributes
    ----------
    steps : (float, float)
        Distance between the visible lines of both families, in the steps that were followed.
    offsets : (float, float)
        Coordinate of one visible line of both families; a heaviest one, if there is a rhythm.
    hidden : int
        Number of finest steps between two visible lines; 1 if the visible lines are the finest.
    rhythm : Rhythm or None
        Of the finest lines.
    unresolved : tuple of int
        Numbers of finer steps that the picture would not show, if these lines were the paper's heavier ones.
    undecided : tuple of int
        Numbers of finer steps that it would not show, if a pen had drawn these lines over some of the paper's.
    thickness : float
        Mean width of the visible lines, as a share of their distance, times their density.
    width : float
        Standard deviation of the profile of the visible lines, blur included, as a share of their distance.
    """

    steps: tuple[float, float]
    offsets: tuple[float, float]
    hidden: int
    rhythm: Rhythm | None
    unresolved: tuple[int, ...]
    undecided: tuple[int, ...]
    thickness: float
    width: float


def read_ruling(density: Density, grid: TrackedGrid) -> Ruling:
    """Return which lines of the sheet were followed.

    Raises
    ------
    MeasurementRefusedError
        If what was followed are no lines, or lines that are not evenly spaced.
    """
    profiles = tuple(measure_profile(density, grid, axis) for axis in (0, 1))
    combs, divisions = _find_combs(profiles)
    steps, offsets = (combs[0].step, combs[1].step), (combs[0].offset, combs[1].offset)
    spacings = [step * profile.step_px for step, profile in zip(steps, profiles, strict=True)]
    if max(spacings) > _LARGEST_RATIO * min(spacings):
        raise MeasurementRefusedError(
            f"no grid of squares in the picture: the lines are {min(spacings):.1f} px apart in one direction and "
            f"{max(spacings):.1f} px in the other",
            "show graph paper alone, without other lines on it, and from above",
        )
    rhythm, shifts = _find_rhythm([profile.cut(comb) for profile, comb in zip(profiles, combs, strict=True)])
    offsets = (offsets[0] + shifts[0] * steps[0], offsets[1] + shifts[1] * steps[1])
    if rhythm is None and divisions > 1:
        # The lines that were followed first are the heavier ones, however uncertain the weight of a single line.
        rhythm = Rhythm(divisions, divisions)
    if rhythm is None and min(spacings) < _LEAST_SPACING_PX:
        raise MeasurementRefusedError(
            f"the lines are {min(spacings):.1f} px apart, and {_LEAST_SPACING_PX:g} px is the least to count them",
            "come closer with the camera",
        )
    lines = [Comb(*comb) for comb in zip(steps, offsets, strict=True)]
    _require_lines(density, grid, lines, rhythm)
    harmonics = [Harmonics.of(profile, comb) for profile, comb in zip(profiles, lines, strict=True)]
    thickness = float(np.mean([family.thickness() for family in harmonics]))
    if thickness > _THICKEST:
        raise _no_lines_error()
    width = float(np.mean([family.width() for family in harmonics]))
    hidden, unresolved = (
        (1, ())
        if rhythm is not None and rhythm.heavy > _PAIR
        else _find_hidden(harmonics, width, float(np.mean(spacings)))
    )
    undecided = _require_no_others(density, grid, profiles, lines, rhythm) if hidden == 1 else ()
    if hidden > 1:
        require_finer_lines(harmonics, hidden)
        # With a rhythm of two, these are lines of 5 and 10 mm: the finest lie between all of them.
        rhythm, unresolved = Rhythm(hidden, hidden * (rhythm.heaviest if rhythm else 1)), ()
    return Ruling(steps, offsets, hidden, rhythm, unresolved, undecided, thickness, width)


def _require_no_others(
    density: Density,
    grid: TrackedGrid,
    profiles: Sequence[Profile],
    lines: Sequence[Comb],
    rhythm: Rhythm | None,
) -> tuple[int, ...]:
    """Refuse lines between or beside which others are seen; return which finer lines would not be seen."""
    spacing_px = min(line.step * profile.step_px for line, profile in zip(lines, profiles, strict=True))
    if spacing_px < _CLOSE_PX:
        finer = [measure_profile(density, grid, axis, _MANY_WINDOWS) for axis in (0, 1)]
    else:
        finer = list(profiles)
    spectra = Spectra.of(finer, lines)
    require_no_lines_between(profiles, lines, spectra)
    period, heavy = (1, 1) if rhythm is None else (rhythm.heaviest, rhythm.heavy)
    require_even_lines(spectra.density, period, heavy, density.shape)
    return find_undecided(spectra, spacing_px) if rhythm is None else ()


def _find_combs(profiles: Sequence[Profile]) -> tuple[tuple[Comb, Comb], int]:
    """Return the visible lines of both families, and how many of their steps one step of heavier lines is."""
    combs = Comb(1.0, 0.0), Comb(1.0, 0.0)
    for _ in range(_MOST_CHANGES):
        merged = next((found for every in _MERGES if (found := _merge(profiles, combs, every))), None)
        if merged is None:
            break
        combs = merged
    divided = next(
        (n for n, least in _DIVISIONS.items() if _have_lines_between(profiles, combs, n, least)), 1
    )
    return (combs[0].divide(divided), combs[1].divide(divided)), divided


def _merge(profiles: Sequence[Profile], combs: Sequence[Comb], every: int) -> tuple[Comb, Comb] | None:
    """Return the wider combs if only every second, third or fifth position has a line in both families."""
    merged, shares = [], []
    for profile, comb in zip(profiles, combs, strict=True):
        folded = profile.cut(comb).fold(every)
        weights = _weigh(folded, folded[int(np.argmax(_rough_weights(folded)))])
        strongest = int(np.argmax(weights))
        shares.append(float(np.delete(weights, strongest).max() / weights[strongest]))
        merged.append(Comb(comb.step * every, comb.offset + strongest * comb.step))
    # In mottled paper one family alone is uncertain.
    bare = np.isfinite(shares).all() and np.mean(shares) < _MOST_BARE and max(shares) < 2.0 * _MOST_BARE
    return (merged[0], merged[1]) if bare else None


def _have_lines_between(
    profiles: Sequence[Profile], combs: Sequence[Comb], divisions: int, least: float
) -> bool:
    """Return whether both families have a line at every place that divides their steps evenly, and none between."""
    weights = [
        _weigh_between(profile, comb, 2 * divisions) for profile, comb in zip(profiles, combs, strict=True)
    ]
    if any(family is None for family in weights):
        return False
    mean = np.mean([family / family[0] for family in weights if family is not None], axis=0)
    at, between = mean[2::2], mean[1::2]
    alike = at.min() >= max(least, 0.4 * float(np.median(at)))
    return bool(np.isfinite(mean).all() and alike and np.median(between) < 0.5 * np.median(at))


def _weigh_between(profile: Profile, comb: Comb, divisions: int) -> _FloatArray | None:
    """Return the weights of lines at every division of a step, the visible line's first; None if they are too close."""
    fine = comb.divide(divisions)
    if 2.0 * fine.step * profile.step_px < _LEAST_SEEN_PX:
        return None
    folded = profile.cut(fine).fold(divisions)
    return _weigh(folded, folded[0])


def _rough_weights(table: _FloatArray) -> _FloatArray:
    """Return the height of the middle of each profile (L,) above its flanks."""
    at = np.abs(ACROSS)
    height = table[:, at < 0.1].mean(axis=1) - table[:, at > _FLANK].mean(axis=1)
    return np.asarray(np.where(np.isfinite(height), height, -np.inf))


def _weigh(table: _FloatArray, shape: _FloatArray) -> _FloatArray:
    """Return how much of a line's shape (S,) is in each profile (L,), beside a level and a slope."""
    at = ACROSS
    near = np.abs(at) < _LINE_REACH
    design = np.column_stack((shape[near], at[near], np.ones(near.sum())))
    if not np.isfinite(design).all():
        return np.full(len(table), np.nan)
    return np.asarray((np.linalg.pinv(design) @ table[:, near].T)[0])


def _find_hidden(harmonics: list[Harmonics], width: float, spacing_px: float) -> tuple[int, tuple[int, ...]]:
    """Return the number of finer steps between visible lines, and which numbers the picture would not show."""
    level = sum(float(family.at((1.0,))[0].real) for family in harmonics)
    found, unresolved = 1, []
    for number in _HIDDEN:
        if spacing_px / number > _RESOLVED_PX:
            continue
        excesses, noises, neighbours, lowest = zip(
            *(family.excess(number) for family in harmonics), strict=True
        )
        least = max(_EXCESS_SIGMAS * float(np.linalg.norm(noises)), _LEAST_EXCESS * level)
        # Thick lines, of a pen for instance, have harmonics below zero, and exceed those by themselves. Lines beside
        # those that were followed, for instance of a print that a pen has not covered, have some too.
        thick = min(lowest) < -_BELOW_ZERO * max(noises) or _falls_below_zero(harmonics, number)
        seen = (
            sum(excesses) > max(least, _BESIDE * sum(neighbours))
            and spacing_px / number >= _LEAST_HIDDEN_PX
            and not thick
        )
        if seen and (found == 1 or number % found):
            found = number
        blur = np.exp(-2.0 * (np.pi * width) ** 2 * (number**2 - 1.0))
        if _FAINTEST_FINE * number * level * blur < _SURE * least:
            unresolved.append(number)
    return found, tuple(unresolved)


def _falls_below_zero(harmonics: list[Harmonics], number: int) -> bool:
    """Return whether a harmonic below a number is negative in both families."""
    return any(
        all(family.at((lower,))[0].real < -_BELOW_ZERO * family.noise(lower) for family in harmonics)
        for lower in range(2, number)
    )


def _find_rhythm(tables: list[LineTable]) -> tuple[Rhythm | None, tuple[int, int]]:
    """Return the rhythm of heavier lines, and the number of a heaviest line of both families."""
    weights = [
        _compare_with_neighbours(_weigh(table.profiles, _average_lines(table.profiles))) for table in tables
    ]
    explained = {every: np.array([_explain(family, every) for family in weights]) for every in _RHYTHMS}
    best = max(float(shares.max()) for shares in explained.values())
    if best < _LEAST_RHYTHM:
        return None, (0, 0)
    every = next(number for number, shares in explained.items() if shares.max() >= _AS_GOOD * best)
    if min(_measure_chance(family, every) for family in weights) > _LARGEST_CHANCE:
        return None, (0, 0)
    # Where a family hardly shows the rhythm, for instance out of focus, the other one tells it.
    clear = explained[every] >= _LEAST_RHYTHM
    means = [_average(family, every) for family in weights]
    found = {_read_rhythm(family) for family, seen in zip(means, clear, strict=True) if seen}
    heaviest = [
        (int(np.nanargmax(family)) + table.first) % every if np.isfinite(family).any() else 0
        for family, table in zip(means, tables, strict=True)
    ]
    return (found.pop() if len(found) == 1 else None), (heaviest[0], heaviest[1])


def _average_lines(table: _FloatArray) -> _FloatArray:
    """Return the mean profile (S,) of the lines that are seen whole."""
    seen = table[np.isfinite(table).all(axis=1)]
    return np.asarray(seen.mean(axis=0)) if len(seen) else np.full(table.shape[1], np.nan)


def _compare_with_neighbours(weights: _FloatArray) -> _FloatArray:
    """Return the weights over the mean around them; NaN for marks that are far darker than lines."""
    seen = np.isfinite(weights)
    most = _LARGEST_WEIGHT * float(np.quantile(weights[seen], _HEAVY_QUANTILE)) if seen.any() else 0.0
    known = seen & (np.abs(weights) < most)
    if not known.any():
        return np.full(len(weights), np.nan)
    # Twenty lines hold whole periods of the usual rhythms.
    around = np.ones(min(_AROUND, len(weights)))
    total = np.convolve(np.where(known, weights, 0.0), around, mode="same")
    mean = total / np.maximum(np.convolve(known, around, mode="same"), 1.0)
    return np.asarray(np.where(known & (mean > 0.0), weights / np.where(mean > 0.0, mean, 1.0), np.nan))


def _average(weights: _FloatArray, every: int) -> _FloatArray:
    """Return the median weights (every,) of the lines that have the same number modulo `every`."""
    means = np.full(every, np.nan)
    for residue in range(every):
        seen = weights[residue::every][np.isfinite(weights[residue::every])]
        if len(seen):
            means[residue] = np.median(seen)
    return means


def _explain(weights: _FloatArray, every: int) -> float:
    """Return the share of the variance of the weights that a rhythm explains, less what it would explain of noise."""
    left, lines = _measure_left(weights, every)
    return 1.0 - left * (lines - 1) / (lines - every) if lines else 0.0


def _measure_chance(weights: _FloatArray, every: int) -> float:
    """Return the probability that a rhythm explains as much of noise: the F test of an analysis of variance."""
    left, lines = _measure_left(weights, every)
    # The share that is left of noise is a beta variable.
    return float(betainc(0.5 * (lines - every), 0.5 * (every - 1), min(left, 1.0))) if lines else 1.0


def _measure_left(weights: _FloatArray, every: int) -> tuple[float, int]:
    """Return the share of the variance that a rhythm leaves, and the number of lines; 0 lines if they are too few."""
    seen = np.flatnonzero(np.isfinite(weights))
    means = _average(weights, every)
    if len(seen) < 2 * every or not np.isfinite(means).all():
        return 1.0, 0
    left = weights[seen] - means[seen % every]
    return float(np.mean(left**2)) / max(float(np.var(weights[seen])), np.finfo(float).tiny), len(seen)


def _read_rhythm(means: _FloatArray) -> Rhythm | None:
    """Return the rhythm of the mean weights (every,) over one period; None if heavier lines are not evenly spaced."""
    every, light = len(means), float(np.median(means)) if len(means) > _PAIR else float(means.min())
    heaviest = int(np.argmax(means))
    if means[heaviest] < _LEAST_HEAVIER * light:
        return None
    heavy = np.flatnonzero(means > light + 0.2 * (means[heaviest] - light))
    spacing = every // len(heavy)
    if not np.array_equal(np.sort((heavy - heaviest) % every), np.arange(0, every, spacing)[: len(heavy)]):
        return None
    alike = bool((means[heavy] > light + 0.85 * (means[heaviest] - light)).all())
    return Rhythm(spacing, spacing if alike else every)


def _require_lines(density: Density, grid: TrackedGrid, combs: Sequence[Comb], rhythm: Rhythm | None) -> None:
    """Refuse what is no lines in two directions: dots, chequers, or the diagonals of a grid.

    In the mean cell between the heavier lines, or between all lines if they are alike, the density of lines is one
    function of the place across plus another of the place along.
    """
    every = 1 if rhythm is None else rhythm.heavy
    steps = np.array([comb.step * every for comb in combs])
    offsets = np.array([comb.offset for comb in combs])
    samples = every * max(_SAMPLES_PER_LINE, 2 * (_LEAST_CELL_SAMPLES // (2 * every)))
    mean, noise = _average_cells(density, grid, steps, offsets, samples)
    lines = mean.mean(axis=1, keepdims=True) + mean.mean(axis=0) - mean.mean()
    total = max(float(mean.var()) - noise, np.finfo(float).tiny)
    share = (float(lines.var()) - noise / samples) / total
    resolved = min(comb.step for comb in combs) * grid.pitch_px >= _RESOLVED_CELL_PX
    wide = resolved and _cover(lines) > _MOST_COVER
    if share < _LEAST_LINE_SHARE or wide or _run_on(mean, every) < _LEAST_RUN:
        raise _no_lines_error()


def _average_cells(
    density: Density, grid: TrackedGrid, steps: _FloatArray, offsets: _FloatArray, samples: int
) -> tuple[_FloatArray, float]:
    """Return the mean cell (S, S) between lines, and the variance of its noise; each window samples what is near it."""
    chosen = slice(None, None, len(grid.pixels) // _CELL_WINDOWS + 1)
    inverse, coordinates = np.linalg.inv(grid.waves[chosen]), grid.coordinates[chosen]
    # Shifted from window to window, so that no part of the cell is left out where windows and lines keep step.
    shifts = np.arange(len(coordinates))[:, None] * _SHIFTS % 1.0 * (_NEAR[1] - _NEAR[0])
    around = np.array([(a, b) for a in _NEAR for b in _NEAR]) + shifts[:, None]
    values = sample(density, grid.pixels[chosen, None] + np.einsum("nxa,nsa->nsx", inverse, around))
    values[_is_beside_edge(values)] = np.nan
    places = (coordinates[:, None] + around - offsets) / steps
    bins = np.floor((places - np.floor(places)) * samples).astype(int) % samples
    seen = np.isfinite(values)
    numbers = (bins[..., 0] * samples + bins[..., 1])[seen]
    count, total, squares = (
        np.bincount(numbers, weights, samples**2) for weights in (None, values[seen], values[seen] ** 2)
    )
    mean = np.where(count > 0, total / np.maximum(count, 1), total.sum() / max(count.sum(), 1))
    noise = np.mean((squares / np.maximum(count, 1) - mean**2) / np.maximum(count - 1, 1))
    return np.asarray(mean.reshape(samples, samples)), float(noise)


def _is_beside_edge(values: _FloatArray) -> NDArray[np.bool_]:
    """Return which windows (N,) of samples (N, M) are brighter as a whole than others: beside the paper's dark edge.

    Heavier lines make a window darker; how bright those without are is told by the lower half of the windows.
    """
    levels = values.mean(axis=1)
    low, middle = np.nanquantile(levels, (_PLAIN_QUANTILE, 0.5)) if np.isfinite(levels).any() else (0.0, 0.0)
    return np.asarray(levels < middle - _BRIGHT * (middle - low))


def _cover(cell: _FloatArray) -> float:
    """Return the mean of a cell's density between its least and largest: about half for chequers, less for lines."""
    least, most = np.quantile(cell, (0.02, 0.98))
    return float((cell.mean() - least) / max(most - least, np.finfo(float).tiny))


def _run_on(cell: _FloatArray, every: int) -> float:
    """Return how dark heavy lines are where no other line meets them, as a share of their mean: near 0 for dots.

    `cell` (S, S) reaches from one heavy line to the next, over `every` lines.
    """
    side = len(cell)
    half = side // every // 2
    on, beside = np.array([0, side - 1]), np.array([half - 1, half, side - half - 1, side - half])
    between = np.isin(np.arange(side) % (2 * half), (half - 1, half))
    lines = [family[on].mean(axis=0) - family[beside].mean(axis=0) for family in (cell, cell.T)]
    return min(float(line[between].mean()) / max(float(line.mean()), np.finfo(float).tiny) for line in lines)


def _no_lines_error() -> MeasurementRefusedError:
    return MeasurementRefusedError(
        "the pattern in the picture is no grid of ruled lines",
        "show graph paper: dots and chequers are not used",
    )
