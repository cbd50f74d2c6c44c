"""Flicker over several pictures: the variation of the mean brightness, without its slow drift.

Lamps on the mains flicker with twice its frequency; pictures at a lower rate show a beat of that, whose period is
stated. scipy.signal takes 0.7 s to import: what judges single pictures does without.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lombscargle

from labrig.vision.picture_quality import FEWEST_FOR_FLICKER, Flicker

_FloatArray = NDArray[np.float64]

_LEAST_PERIODIC = 0.5


def measure_flicker(times_s: Sequence[float], means: Sequence[float]) -> Flicker | None:
    """Measure the variation of the mean brightness of successive pictures.

    Parameters
    ----------
    times_s : sequence of float
        Time of each picture [s].
    means : sequence of float
        Their mean grey levels.

    Returns
    -------
    Flicker or None
        None for fewer than eight pictures. The period is that which explains most of the variation (Lomb, Astrophysics
        and Space Science, 1976), between two pictures and half the time observed; None if it explains less than half.
    """
    t_s, grey = np.asarray(times_s, float), np.asarray(means, float)
    if len(grey) < FEWEST_FOR_FLICKER or not grey.mean() > 0.0:
        return None
    observed_s = float(t_s[-1] - t_s[0])
    if not observed_s > 0.0:
        return Flicker(float(grey.std() / grey.mean()), None)
    left = grey - np.polynomial.Polynomial.fit(t_s, grey, 1)(t_s)
    return Flicker(float(left.std() / grey.mean()), _find_period_s(t_s - t_s[0], left, observed_s))


def _find_period_s(t_s: _FloatArray, left: _FloatArray, observed_s: float) -> float | None:
    fastest_hz = 0.5 * (len(t_s) - 1) / observed_s
    slowest_hz = 2.0 / observed_s
    if not left.std() > 0.0 or fastest_hz <= slowest_hz:
        return None
    rates_hz = np.linspace(slowest_hz, fastest_hz, 8 * len(t_s))
    power = lombscargle(t_s, left, 2.0 * np.pi * rates_hz, normalize=True)
    best = int(np.argmax(power))
    return float(1.0 / rates_hz[best]) if power[best] >= _LEAST_PERIODIC else None
