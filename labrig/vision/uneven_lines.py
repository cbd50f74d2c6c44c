"""Whether other lines lie between or beside the lines that were counted, not evenly, as a pen grid leaves them.

A pen that follows every second to fifth printed line is counted in place of the print. Where the print itself is too
fine to be seen, its heavier lines still lie between the drawn ones, and a drawn line beside a heavier one makes both
together asymmetric. The spectrum of a rhythm shows the former: heavier lines at the counted places alone have harmonics
that fall as evenly as those of a single line, and lines between them have not. Of lines far apart, drawn over every
seventh to twelfth of the paper's, it shows that only above their own frequency.

Finer lines that are told by one harmonic alone have another source: drawn lines a few of these finer lines apart have
the same harmonic as a multiple of their own. Every fourth printed line drawn over, and every tenth heavier, look like
lines twice as far apart as the printed ones. The drawn lines' own harmonic lies between those of the heavier lines, and
how steeply blur lets harmonics fall tells how much of the multiple is theirs.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labrig.errors import MeasurementRefusedError
from labrig.vision.line_density import keep_of_wave
from labrig.vision.line_profile import Harmonics

_FloatArray = NDArray[np.float64]

# Least share of the heavier lines' spectrum that is no even fall: 0.29 at the most for printed rhythms, 0.46 and more
# with lines between. Up to twice the frequency of lines far apart: 0.52 and 0.91.
_LEAST_UNEVEN, _LEAST_UNEVEN_FAR = 0.3, 0.7
_LEAST_PERIOD = 3
# Fewer periods than this in the picture run their harmonics into one another.
_LEAST_PERIODS = 3.0
# Of lines this far apart the spectrum is seen up to twice their frequency, and further apart there is too little of it
# below. The removal of slow light, and for shorter waves blur, leaves at least this share of what is compared.
_FAR_PX, _MOST_SPACING_PX, _LEAST_KEPT = 13.0, 24.0, 0.25
# Where lines without a rhythm have no harmonic, and heavier lines every 5 or 10 of finer ones do; its least height over
# the lines' first harmonic and over what is beside it.
_TENTHS = (0.3, 0.4, 0.6, 0.7, 0.8)
_BESIDE = (-0.05, -0.03, 0.03, 0.05)
_LEAST_HEIGHT, _LEAST_OVER_BESIDE = 0.06, 5.0
# Above their frequency lines without a rhythm have 0.1 of it at such tenths at the most, in photographs of worn paper.
_TENTHS_ABOVE, _LEAST_HEIGHT_ABOVE = (1.2, 1.4, 1.6, 1.8, 2.2, 2.4), 0.11
# Least asymmetry of the lines of both families: the parts of the second and third harmonic that symmetric lines lack,
# over the first. Print has 0.05 at the most.
_LEAST_ASYMMETRY = 0.08
# Least odd part of the profile of the lines of both families, as an amplitude over that of the profile, at the best
# place of the line within these shifts, in steps: 0.07 of print, 0.13 of drawn lines a tenth of a step beside others.
_LEAST_ODD, _SHIFTS = 0.1, np.linspace(-0.1, 0.1, 81)
_MOST_HARMONICS, _LEAST_WAVE_PX = 12, 1.9
# Largest share of the finer lines' harmonic that the drawn lines explain: 0.05 on printed sheets, 0.26 where a pen has
# drawn over some of these finer lines, 0.7 and more without any.
_MOST_DRAWN = 0.5


def require_even_lines(
    harmonics: Sequence[Harmonics], period: int, heavy: int, shape: tuple[int, ...]
) -> None:
    """Refuse lines between or beside which heavier ones lie.

    Parameters
    ----------
    harmonics : of both families, with a heaviest line at their offset
    period, heavy : int
        Every `heavy`th line is heavier, every `period`th the heaviest; 1 for no rhythm.
    shape : of the picture, in which slow changes of light were removed

    Raises
    ------
    MeasurementRefusedError
    """
    uneven = (
        _measure_unevenness(harmonics, period, heavy, shape, far=False) > _LEAST_UNEVEN
        or _measure_unevenness(harmonics, period, heavy, shape, far=True) > _LEAST_UNEVEN_FAR
        if period >= _LEAST_PERIOD
        else _see_tenths(harmonics) or _see_tenths_above(harmonics)
    )
    if uneven:
        raise _refuse("between")
    if _measure_asymmetry(harmonics) > _LEAST_ASYMMETRY or _measure_odd(harmonics) > _LEAST_ODD:
        raise _refuse("beside")


def require_finer_lines(harmonics: Sequence[Harmonics], number: int) -> None:
    """Refuse finer lines whose harmonic, the `number`th, is no more than a multiple of that of lines drawn between.

    Parameters
    ----------
    harmonics : of the heavier lines of both families

    Raises
    ------
    MeasurementRefusedError
    """
    finer = sum(family.excess(number)[0] for family in harmonics)
    for frequency in (number / every for every in range(2, number) if number % every):
        drawn = sum(
            abs(family.excess(frequency)[0]) * _measure_fall(family, frequency, number)
            for family in harmonics
        )
        if drawn > _MOST_DRAWN * finer:
            raise _refuse("between")


def _measure_fall(family: Harmonics, low: float, high: float) -> float:
    """Return the share that blur leaves of a wave at the higher of two frequencies, over that at the lower one.

    From the second and third harmonic: where slow light is removed, the first of lines far apart is weaker.
    """
    second, third = np.maximum(family.at((2.0, 3.0)).real, np.finfo(float).tiny)
    return float((third / max(second, third)) ** ((high**2 - low**2) / 5.0))


def _refuse(where: str) -> MeasurementRefusedError:
    return MeasurementRefusedError(
        f"{where} the lines that were followed there are others at uneven distances: a pen has drawn over a part of "
        "the paper's lines, or the picture shows two grids",
        "show graph paper on which nothing else is ruled",
    )


def _measure_unevenness(
    harmonics: Sequence[Harmonics], period: int, heavy: int, shape: tuple[int, ...], *, far: bool
) -> float:
    """Return the share of the rhythm's spectrum that does not fall evenly.

    Below the lines' own frequency, or of lines far apart up to twice that. Lines that a pen drew over every seventh of
    the paper's, whose every fifth is heavier, have nothing uneven below.
    """
    uneven, whole = 0.0, float(np.finfo(float).tiny)
    for family in harmonics:
        spacing_px = family.step * family.profile.step_px
        places = family.profile.places[np.isfinite(family.profile.density)]
        periods = float(np.ptp(places)) / family.step / period
        numbers = np.setdiff1d(np.arange(1, 2 * period if far else period), period)
        kept = keep_of_wave(shape, spacing_px * period / numbers)
        fall = kept * np.exp(-2.0 * (np.pi * family.width() * numbers / period) ** 2)
        seen = (fall if far else kept) > _LEAST_KEPT
        numbers, fall = numbers[seen], fall[seen]
        apart = spacing_px > _FAR_PX if far else spacing_px <= _MOST_SPACING_PX
        if not apart or periods < _LEAST_PERIODS or len(numbers) < _LEAST_PERIOD - 1:
            continue
        heights = family.at(numbers / period).real / fall / family.at((1.0,))[0].real
        # Lines of two weights, in turn for instance, have harmonics of two heights in turn.
        kinds = [heights[numbers % (period // heavy) == kind] for kind in range(period // heavy)]
        uneven += sum(float(np.sum((kind - kind.mean()) ** 2)) for kind in kinds if len(kind))
        whole += float(np.sum(heights**2))
    return float(np.sqrt(uneven / whole))


def _see_tenths(harmonics: Sequence[Harmonics]) -> bool:
    """Return whether both families have a harmonic at the same tenths of the lines' frequency."""
    for tenth in _TENTHS:
        first, beside = (
            np.abs([family.at(tenth + np.array(off)) for family in harmonics]) for off in ((0.0,), _BESIDE)
        )
        height = np.array([abs(family.at((1.0,))[0]) for family in harmonics])
        seen = first[:, 0] > np.maximum(_LEAST_HEIGHT * height, _LEAST_OVER_BESIDE * beside.mean(axis=1))
        if seen.all():
            return True
    return False


def _see_tenths_above(harmonics: Sequence[Harmonics]) -> bool:
    """Return whether both families have a harmonic at the same tenths above the lines' frequency."""
    heights = [np.abs(family.at(_TENTHS_ABOVE)) / np.abs(family.at((1.0,))) for family in harmonics]
    return bool((np.min(heights, axis=0) > _LEAST_HEIGHT_ABOVE).any())


def _measure_asymmetry(harmonics: Sequence[Harmonics]) -> float:
    """Return the least of both families and of the second and third harmonic."""
    found = []
    for family in harmonics:
        first, second, third = family.at((1.0, 2.0, 3.0))
        found += [abs(second.imag) / first.real, abs(third.imag) / first.real]
    return float(min(found))


def _measure_odd(harmonics: Sequence[Harmonics]) -> float:
    """Return the odd part of the lines' profile over the whole, the least of both families.

    A heavier line right beside hardly changes the second and third harmonic of lines far apart.
    """
    found = []
    for family in harmonics:
        most = family.step * family.profile.step_px / _LEAST_WAVE_PX
        numbers = np.arange(1.0, np.clip(int(most), 1, _MOST_HARMONICS) + 1.0)
        shifted = family.at(numbers) * np.exp(-2j * np.pi * _SHIFTS[:, None] * numbers)
        share = np.sum(shifted.imag**2, axis=1) / np.sum(np.abs(shifted) ** 2, axis=1)
        found.append(float(np.sqrt(share.min())))
    return min(found)
