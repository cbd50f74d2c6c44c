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
    interval: tuple[float, float] | None, roll_sd_deg: float, roll_sigma: float | None = None
) -> tuple[float, float] | None:
    """Widen the 95 % interval of a radius by the uncertainty of the roll, which all insertions of a needle share.

    A bevel turned out of the plane by rho bends the needle by cos(rho) / r in it (equation 5), so that r / cos(rho) is
    measured: too large, never too small. It also brings the needle nearer to the camera or farther from it, which
    magnifies it by a share that is linear in rho, either way. The second outweighs the first at small angles.

    Parameters
    ----------
    roll_sd_deg : float
        Standard deviation of the roll [degrees].
    roll_sigma : float or None
        What that does to a radius through the camera, one standard deviation; both ends move. None: the camera's place
        is not known, and only the lower end moves, by the cosine.
    """
    if interval is None:
        return None
    low, high = interval
    if roll_sigma is None:
        return low * math.cos(_TWO_SIDED_95 * math.radians(roll_sd_deg)), high
    middle, half = (low + high) / 2.0, math.hypot((high - low) / 2.0, _TWO_SIDED_95 * roll_sigma)
    return middle - half, middle + half
