"""Whether there are fainter lines between the lines that were counted: a pen has drawn over some of the printed ones.

Lines drawn over every second or third printed line hide that the printed ones go on between them: they are far
fainter. The scale would be wrong by two or three without any residual. The mean profile across the lines shows them
where they are resolved. Where blur runs them together, its spectrum does: the logarithms of the harmonics of single
lines fall with the square of their number, and the second to twelfth is larger than that if there are two to twelve
lines.

Where noise or blur leaves open whether a harmonic is larger, the picture cannot tell a plain grid from one that a pen
has drawn over finer lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.line_profile import Comb, Harmonics, Profile

_FloatArray = NDArray[np.float64]

_NUMBERS = tuple(range(2, 13))
# Half the width of what is looked at around a place [px]: beyond it, light changes slowly.
_REACH_PX = 6.0
_LEAST_PLACES = 5
_SAMPLES_PER_PX = 4.0
_LEAST_CELLS = 4
# Least height of a line over that of the lines counted, as amplitudes of their waves, and over its standard error.
_LEAST_HEIGHT, _LEAST_SIGMAS = 0.02, 5.0
# Harmonics that are compared with those beside them, and the least logarithm of their ratio: lines as thick as 0.3 of
# their distance have 0.04. The weaker one is above its noise by this factor, and its waves are so long at the least.
_HARMONICS = (2, 3, 4, 5)
_LEAST_RATIO, _LEAST_OVER_NOISE, _LEAST_WAVE_PX = 0.1, 5.0, 1.9
_LEAST_RATIO_SIGMAS = 4.0
# Of more lines a high harmonic tells, which the form of thick lines raises too: light and density must agree on it.
_HIGH_HARMONICS = (6, 7, 8, 9, 10, 11, 12)
# Finer lines of at least this share of the weight of the lines counted are to be excluded, so surely: harmonics of
# single lines vary by 0.04, those of the faintest lines midway between them by 0.11. Closer lines than this are not
# looked for, or no plain lines under 5 px would be told; further ones are seen in the profile.
_FAINTEST, _SURE_SIGMAS = 0.06, 2.0
_LEAST_PRINT_PX, _SEEN_PX = 2.3, 8.0
# The removal of slow light weakens longer waves; what is between lines further apart is seen.
_MOST_SPACING_PX = 24.0
_MOST_BELOW_ZERO = 3.0
# Standard error of a median, in median absolute deviations over the square root of the number.
_MAD_TO_SIGMA, _MEDIAN_TO_MEAN = 1.4826, 1.2533


@dataclass(frozen=True, eq=False)
class Spectra:
    """Harmonics of both families: of the density across the lines, and of the light that they take.

    Blur adds up light. Of close lines, whose third harmonic is weak, the density has harmonics that are products of the
    lower ones. Of lines further apart the light's higher harmonics reach zero earlier, and the density's fall evenly.
    """

    density: Sequence[Harmonics]
    light: Sequence[Harmonics]

    @classmethod
    def of(cls, profiles: Sequence[Profile], combs: Sequence[Comb]) -> "Spectra":
        """Return the harmonics of combs in the profiles of the density."""
        pairs = list(zip(profiles, combs, strict=True))
        return cls(
            [Harmonics.of(profile, comb) for profile, comb in pairs],
            [Harmonics.of(profile.to_absorption(), comb) for profile, comb in pairs],
        )

    def compare(self, number: int, *, thin: bool) -> tuple[float, float] | None:
        """Return `compare_harmonics` of light or density, whichever falls evenly."""
        return compare_harmonics(self.light if number == _HARMONICS[0] else self.density, number, thin=thin)


def require_no_lines_between(profiles: Sequence[Profile], combs: Sequence[Comb], spectra: Spectra) -> None:
    """Refuse lines between which the profiles of both families show fainter lines, evenly spaced.

    Raises
    ------
    MeasurementRefusedError
        With the distances between both.
    """
    spacing_px = float(
        np.mean([profile.step_px * comb.step for profile, comb in zip(profiles, combs, strict=True)])
    )
    number = next((n for n in _NUMBERS if _see_lines(profiles, combs, n)), None) or next(
        (n for n in (*_HARMONICS, *_HIGH_HARMONICS) if _infer_lines(spectra, n, spacing_px)), None
    )
    if number is not None:
        raise MeasurementRefusedError(
            f"between the lines {spacing_px:.1f} px apart there are fainter ones, {spacing_px / number:.1f} px apart: "
            "the darker ones were drawn over a part of the paper's lines",
            "show graph paper on which nothing else is ruled",
        )


def _see_lines(profiles: Sequence[Profile], combs: Sequence[Comb], number: int) -> bool:
    """Return whether there is a line at every place that divides a step evenly."""
    heights, errors = np.transpose(
        [_measure_least(profile, comb, number) for profile, comb in zip(profiles, combs, strict=True)]
    )
    return bool((heights > np.maximum(_LEAST_HEIGHT, _LEAST_SIGMAS * errors)).all())


def find_undecided(spectra: Spectra, spacing_px: float) -> tuple[int, ...]:
    """Return the numbers of finer steps between lines that the picture leaves open.

    A pen could have drawn the lines over every such line of paper with finer, plain lines: blur and noise would hide
    these. Finer lines raise one harmonic over what those beside it predict, and so lower the one before it beside what
    is predicted of that: either tells them.

    Parameters
    ----------
    spectra : of both families
    spacing_px : float
        Distance between the lines counted.
    """
    return tuple(
        number
        for number in _HARMONICS
        if _LEAST_PRINT_PX <= spacing_px / number < _SEEN_PX
        and not _exclude_lines(spectra, number, spacing_px)
    )


def _exclude_lines(spectra: Spectra, number: int, spacing_px: float) -> bool:
    """Return whether the harmonics exclude finer lines with the least share of the weight of those counted."""
    before = number - 1
    least = np.log1p(number * _FAINTEST)
    for compared, share in ((number, 1.0), (before, -_weigh_beyond(before))):
        ratio = spectra.compare(compared, thin=False) if can_infer(compared, spacing_px) else None
        if ratio is not None and ratio[0] / share + _SURE_SIGMAS * ratio[1] ** 0.5 / abs(share) < least:
            return True
    return False


def _infer_lines(spectra: Spectra, number: int, spacing_px: float) -> bool:
    """Return whether a harmonic is larger than those of single lines, whatever their blur."""
    if not can_infer(number, spacing_px):
        return False
    ratios = (
        [spectra.compare(number, thin=True)]
        if number in _HARMONICS
        else [compare_harmonics(family, number) for family in (spectra.light, spectra.density)]
    )
    return all(
        ratio is not None and ratio[0] > max(_LEAST_RATIO, _LEAST_RATIO_SIGMAS * ratio[1] ** 0.5)
        for ratio in ratios
    )


def can_infer(number: int, spacing_px: float) -> bool:
    """Return whether the harmonics that tell so many lines from one are neither too fine nor taken for light."""
    return (
        number > 1
        and spacing_px / (number + 1) >= _LEAST_WAVE_PX
        and spacing_px / (number - 1) <= _MOST_SPACING_PX
    )


def compare_harmonics(
    families: Sequence[Harmonics], number: int, *, thin: bool = True
) -> tuple[float, float] | None:
    """Return the mean of `_compare_harmonic` over the families, and its variance; None if it is unknown of any."""
    found = [ratio for family in families if (ratio := _compare_harmonic(family, number, thin)) is not None]
    return average(found) if len(found) == len(families) else None


def average(found: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the mean of values with standard errors, and its variance."""
    return (
        sum(value for value, _ in found) / len(found),
        sum(error**2 for _, error in found) / len(found) ** 2,
    )


def _compare_harmonic(family: Harmonics, number: int, thin: bool) -> tuple[float, float] | None:
    """Return the logarithm of a harmonic over what those beside it predict of single lines, and its standard error.

    None if one of them is lost in noise, or, with `thin`, if the lines are so thick that they alone raise it. The one
    after it may be lost if it exceeds the one before it, as no harmonic of single lines does.
    """
    near = number + np.array([-1.0, 0.0, 1.0])
    after = _weigh_beyond(number)
    before, here, beyond, double = family.at((*near, 2.0 * number)).real
    noise = family.noise(number + 1)
    # Thick lines have harmonics below zero, and next to these a weak one.
    thick = double < -_MOST_BELOW_ZERO * noise
    least = _LEAST_OVER_NOISE * noise
    if min(before, here, max(beyond, here - before)) < least or (thin and thick):
        return None
    beyond = max(beyond, least)
    ratio = np.log(here) - (1.0 - after) * np.log(before) - after * np.log(beyond)
    return float(ratio), float(noise * np.hypot(1.0 / here, after / beyond))


def _weigh_beyond(number: int) -> float:
    """Return the weight of the next harmonic in the prediction of one from those beside it."""
    return (2 * number - 1) / (4 * number)


def _measure_least(profile: Profile, comb: Comb, number: int) -> tuple[float, float]:
    """Return the height of the faintest line at the places that divide a step evenly, and its standard error.

    In units of the amplitude of the wave of the lines counted; NaN for too few lines.
    """
    cells, places = _cut_cells(profile, comb)
    if len(cells) < _LEAST_CELLS:
        return np.nan, np.nan
    amplitude = 2.0 * abs(np.mean(np.median(cells, axis=0) * np.exp(2j * np.pi * places)))
    reach = min(0.5 / number, _REACH_PX / (profile.step_px * comb.step))
    found = []
    for place in np.arange(1, number) / number:
        near = np.abs(places - place) < reach
        if near.sum() < _LEAST_PLACES:
            return np.nan, np.nan
        # A wave over the place: a level and a slope do not count, and the tails of the lines beside count against it.
        wave = np.cos(np.pi * (places[near] - place) / reach)
        wave -= wave.mean()
        heights = cells[:, near] @ wave / (wave @ wave * amplitude)
        middle = float(np.median(heights))
        spread = _MAD_TO_SIGMA * float(np.median(np.abs(heights - middle)))
        found.append((middle, _MEDIAN_TO_MEAN * spread / len(heights) ** 0.5))
    return min(found)


def _cut_cells(profile: Profile, comb: Comb) -> tuple[_FloatArray, _FloatArray]:
    """Return the density (L, S) from each line to the next, where it is known, and the places (S,) in steps."""
    samples = max(int(_SAMPLES_PER_PX * profile.step_px * comb.step), 4 * _NUMBERS[-1])
    places = (np.arange(samples) + 0.5) / samples
    first = int(np.ceil((profile.places[0] - comb.offset) / comb.step))
    last = int(np.floor((profile.places[-1] - comb.offset) / comb.step))
    at = comb.offset + comb.step * (np.arange(first, max(last, first + 1))[:, None] + places)
    cells = np.interp(at, profile.places, profile.density, left=np.nan, right=np.nan)
    return np.asarray(cells[np.isfinite(cells).all(axis=1)]), places
