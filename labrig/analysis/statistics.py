"""Mean, spread and interval of repeated measurements, and the part that the bevel's roll adds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

_TWO_SIDED_95 = 1.96


@dataclass(frozen=True)
class Spread:
    """Mean, sample standard deviation and 95 % interval of the mean of n repeated values.

    Standard deviation and interval are None below two values, and so is the mean without any.
    """

    n: int
    mean: float | None
    sd: float | None
    ci95: tuple[float, float] | None


def compute_spread(values: Sequence[float]) -> Spread:
    """Return the spread of `values`: standard deviation with n - 1, interval by Student's t."""
    n = len(values)
    if n < 2:
        return Spread(n, float(values[0]) if n else None, None, None)
    mean, sd = float(np.mean(values)), float(np.std(values, ddof=1))
    half_width = float(stdtrit(n - 1, 0.975)) * sd / n**0.5
    return Spread(n, mean, sd, (mean - half_width, mean + half_width))


def add_roll_uncertainty(
    interval: tuple[float, float] | None, roll_sd_deg: float
) -> tuple[float, float] | None:
    """Widen the 95 % interval of a radius by the uncertainty of the roll; None stays None.

    A bevel turned out of the plane by rho bends the needle by cos(rho) / r in it (equation 5), so that r / cos(rho) is
    measured: too large, never too small. Only the lower end moves, and all insertions of a needle share it.
    """
    if interval is None:
        return None
    low, high = interval
    return low * math.cos(_TWO_SIDED_95 * math.radians(roll_sd_deg)), high
