"""Mean, spread and interval of repeated measurements, what the bevel's roll adds, and tests of several means.

The tests do not assume equal variances. scipy has them; the first one loads `scipy.stats`, which takes half a second.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
import scipy
from scipy.optimize import brentq
from scipy.special import stdtrit

from labrig.protocol.model import Model

Interval = tuple[float, float]
Samples = Sequence[Sequence[float]]

LEVEL = 0.95
TWO_SIDED_95 = 1.96


@dataclass(frozen=True)
class Spread:
    """Mean, sample standard deviation and 95 % interval of the mean of n repeated values.

    Standard deviation and interval are None below two values, and so is the mean without any.
    """

    n: int
    mean: float | None
    sd: float | None
    ci95: Interval | None


def compute_spread(values: Sequence[float], comparisons: int = 1) -> Spread:
    """Return the spread of `values`: standard deviation with n - 1, interval by Student's t.

    The intervals of several `comparisons` hold together (Bonferroni).
    """
    n = len(values)
    if n < 2:
        return Spread(n, float(values[0]) if n else None, None, None)
    mean, sd = float(np.mean(values)), float(np.std(values, ddof=1))
    half_width = float(stdtrit(n - 1, 1.0 - 0.025 / comparisons)) * sd / n**0.5
    return Spread(n, mean, sd, (mean - half_width, mean + half_width))


def add_roll_uncertainty(
    interval: Interval | None, roll_sd_deg: float, roll_sigma: float | None = None
) -> Interval | None:
    """Widen the 95 % interval of a radius by the uncertainty of the roll, which all insertions of a needle share.

    A bevel turned out of the plane by rho bends the needle by cos(rho) / r in it (equation 5), so that r / cos(rho) is
    measured: too large, never too small. It also brings the needle nearer to the camera or farther from it, which
    magnifies it by a share that is linear in rho, either way. The second outweighs the first at small angles.

    Parameters
    ----------
    roll_sd_deg : float
        Standard deviation of the roll [degrees].
    roll_sigma : float or None
        What that does to a radius through the camera, with all else that the insertions share, one standard deviation;
        both ends move. None: the camera's place is not known, and only the lower end moves, by the cosine.
    """
    if interval is None:
        return None
    low, high = interval
    if roll_sigma is None:
        return low * math.cos(TWO_SIDED_95 * math.radians(roll_sd_deg)), high
    middle, half = (low + high) / 2.0, math.hypot((high - low) / 2.0, TWO_SIDED_95 * roll_sigma)
    return middle - half, middle + half


class WelchAnova(Model):
    """Welch's analysis of variance."""

    f: float
    df_between: float
    df_within: float
    p: float


class PairTest(NamedTuple):
    """The difference of two means, a - b, with its simultaneous interval and p by Games and Howell.

    Both are None where neither sample has a spread.
    """

    difference: float
    ci95: Interval | None
    p: float | None


def has_spread(sample: Sequence[float]) -> bool:
    """Return whether a sample has at least two values that are not all the same to the last digits."""
    return len(sample) > 1 and float(np.ptp(sample)) > 1e-12 * max(1.0, float(np.max(np.abs(sample))))


def compare_means(samples: Samples) -> WelchAnova | None:
    """Return Welch's ANOVA (1951); None for fewer than two samples, or where one has no spread.

    The second degrees of freedom are equation 30 of his paper, which scipy keeps to itself.
    """
    if len(samples) < 2 or not all(map(has_spread, samples)):
        return None
    found = scipy.stats.f_oneway(*samples, equal_var=False)
    n, groups = np.array([len(sample) for sample in samples], dtype=np.float64), len(samples)
    weight = n / np.array([np.var(sample, ddof=1) for sample in samples])
    within = (groups**2 - 1) / (3.0 * np.sum((1.0 - weight / weight.sum()) ** 2 / (n - 1)))
    return WelchAnova(
        f=float(found.statistic), df_between=groups - 1.0, df_within=float(within), p=float(found.pvalue)
    )


def compare_pairs(samples: Samples) -> dict[tuple[int, int], PairTest]:
    """Return the test of each pair of samples of at least two values, by their numbers, the smaller first.

    scipy's table of all intervals takes a fifth of a second for each, so the quantile of a pair is found here.
    """
    if len(samples) < 2:
        return {}
    with np.errstate(all="ignore"):  # a pair without spread is 0 / 0
        p = scipy.stats.tukey_hsd(*samples, equal_var=False).pvalue
    pairs = combinations(range(len(samples)), 2)
    return {(a, b): _compare_pair(samples[a], samples[b], float(p[a, b]), len(samples)) for a, b in pairs}


def _compare_pair(a: Sequence[float], b: Sequence[float], p: float, groups: int) -> PairTest:
    difference = float(np.mean(a) - np.mean(b))
    if not (has_spread(a) or has_spread(b)):
        return PairTest(difference, None, None)
    squares = np.var(a, ddof=1) / len(a), np.var(b, ddof=1) / len(b)
    df = float(sum(squares) ** 2 / (squares[0] ** 2 / (len(a) - 1) + squares[1] ** 2 / (len(b) - 1)))
    half = _find_range_quantile(groups, df) * math.sqrt(sum(squares) / 2.0)
    return PairTest(difference, (difference - half, difference + half), p)


def _find_range_quantile(groups: int, df: float) -> float:
    """Return the quantile of the studentized range; Student's t for two means and Bonferroni's bound enclose it."""
    low, high = (
        math.sqrt(2.0) * float(stdtrit(df, 1.0 - (1.0 - LEVEL) / (2.0 * pairs)))
        for pairs in (1.0, 0.5 * groups * (groups - 1))
    )
    if groups == 2:
        return low
    studentized = scipy.stats.studentized_range
    return float(
        brentq(lambda q: studentized.sf(q, groups, df) - (1.0 - LEVEL), 0.999 * low, 1.001 * high, xtol=1e-5)
    )
