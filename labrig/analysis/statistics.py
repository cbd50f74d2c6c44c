"""Mean, spread and interval of repeated measurements, and what the roll of the bevel adds to it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

_TWO_SIDED_95 = 1.96


@dataclass(frozen=True)
class Spread:
    """What n repeated values say: their mean, sample standard deviation and the 95 % interval of the mean.

    The standard deviation and the interval are None below two values, the mean too for none.
    """

    n: int
    mean: float | None
    sd: float | None
    ci95: tuple[float, float] | None


def spread(values: Sequence[float]) -> Spread:
    """Return the spread of `values`: standard deviation over n - 1, interval by Student's t."""
    n = len(values)
    if n < 2:
        return Spread(n, float(values[0]) if n else None, None, None)
    mean, sd = float(np.mean(values)), float(np.std(values, ddof=1))
    half_width = float(stdtrit(n - 1, 0.975)) * sd / n**0.5
    return Spread(n, mean, sd, (mean - half_width, mean + half_width))


def with_roll(interval: tuple[float, float] | None, roll_sd_deg: float) -> tuple[float, float] | None:
    """Return a 95 % interval of a radius with the roll's uncertainty in it; None stays None.

    A bevel turned out of the plane by rho bends the needle by cos(rho) / r in it (equation 5), so that r / cos(rho) is
    seen: too large, never too small. Only the lower end moves, and all insertions of a needle share it.
    """
    if interval is None:
        return None
    low, high = interval
    return low * math.cos(_TWO_SIDED_95 * math.radians(roll_sd_deg)), high
