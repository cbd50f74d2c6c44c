"""Whether other lines lie between or beside the lines that were counted, not evenly, as a pen grid leaves them.

A pen that follows every second to fifth printed line is counted in place of the print. Where the print itself is too
fine to be seen, its heavier lines still lie between the drawn ones, and a drawn line beside a heavier one makes both
together asymmetric. The spectrum of a rhythm shows the former: heavier lines at the counted places alone have harmonics
that fall as evenly as those of a single line, and lines between them have not.

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

# Least share of the heavier lines' spectrum that is no even fall: 0.18 at the most for printed rhythms, 0.46 and more
# with lines between.
_LEAST_UNEVEN = 0.3
_LEAST_PERIOD = 3
# Fewer periods than this in the picture run their harmonics into one another.
_LEAST_PERIODS = 3.0
# Lines further apart are seen one by one. Of longer waves the removal of slow light leaves less than this share.
_MOST_SPACING_PX, _LEAST_KEPT = 24.0, 0.25
# Where lines without a rhythm have no harmonic, and heavier lines every 5 or 10 of finer ones do; its least height over
# the lines' first harmonic and over what is beside it.
_TENTHS = (0.3, 0.4, 0.6, 0.7, 0.8)
_BESIDE = (-0.05, -0.03, 0.03, 0.05)
_LEAST_HEIGHT, _LEAST_OVER_BESIDE = 0.06, 5.0
# Least asymmetry of the lines of both families: the parts of the second and third harmonic that symmetric lines lack,
# over the first. Print has 0.05 at the most.
_LEAST_ASYMMETRY = 0.08
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
        _measure_unevenness(harmonics, period, heavy, shape) > _LEAST_UNEVEN
        if period >= _LEAST_PERIOD
        else _see_tenths(harmonics)
    )
    if uneven:
        raise _refuse("between")
    if _measure_asymmetry(harmonics) > _LEAST_ASYMMETRY:
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
    harmonics: Sequence[Harmonics], period: int, heavy: int, shape: tuple[int, ...]
) -> float:
    """Return the share of the rhythm's spectrum, below the lines' own frequency, that does not fall evenly."""
    uneven, whole = 0.0, float(np.finfo(float).tiny)
    for family in harmonics:
        spacing_px = family.step * family.profile.step_px
        seen = family.profile.places[np.isfinite(family.profile.density)]
        periods = float(np.ptp(seen)) / family.step / period
        numbers = np.arange(1, period)
        kept = keep_of_wave(shape, spacing_px * period / numbers)
        numbers, kept = numbers[kept > _LEAST_KEPT], kept[kept > _LEAST_KEPT]
        if spacing_px > _MOST_SPACING_PX or periods < _LEAST_PERIODS or len(numbers) < _LEAST_PERIOD - 1:
            continue
        fall = kept * np.exp(-2.0 * (np.pi * family.width() * numbers / period) ** 2)
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


def _measure_asymmetry(harmonics: Sequence[Harmonics]) -> float:
    """Return the least of both families and of the second and third harmonic."""
    found = []
    for family in harmonics:
        first, second, third = family.at((1.0, 2.0, 3.0))
        found += [abs(second.imag) / first.real, abs(third.imag) / first.real]
    return float(min(found))
