"""Tests of means of several groups that do not assume equal variances.

scipy has the tests; the first of them loads `scipy.stats`, which takes half a second. What it does not return is
computed here: the degrees of freedom of Welch's test, and the quantile of the studentized range for a single pair.
scipy's table of all pairs takes a fifth of a second for each.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, special

FloatArray = NDArray[np.float64]
Samples = Sequence[Sequence[float]]

LEVEL = 0.95


@dataclass(frozen=True)
class WelchTest:
    """Welch's test of equal means."""

    f: float
    df_between: float
    df_within: float
    p: float


@dataclass(frozen=True)
class PairTest:
    """The difference of two means, a - b, with its simultaneous interval and p by Games and Howell."""

    difference: float
    ci95: tuple[float, float]
    p: float
    df: float


@dataclass(frozen=True)
class Slope:
    """A slope within blocks, with its 95 % interval, p of no slope, and degrees of freedom."""

    slope: float
    ci95: tuple[float, float]
    p: float
    df: int


def has_spread(sample: Sequence[float]) -> bool:
    """Return whether a sample has at least two values that are not all the same to the last digits."""
    if len(sample) < 2:
        return False
    return float(np.ptp(sample)) > 1e-12 * max(1.0, float(np.max(np.abs(sample))))


def compare_means(samples: Samples) -> WelchTest:
    """Return Welch's ANOVA (1951) of samples that all have a spread."""
    found = scipy.stats.f_oneway(*samples, equal_var=False)
    return WelchTest(
        float(found.statistic), len(samples) - 1.0, _find_welch_freedom(samples), float(found.pvalue)
    )


def _find_welch_freedom(samples: Samples) -> float:
    """Return the second degrees of freedom of Welch's test, equation 30 of his paper, which scipy keeps to itself."""
    n = np.array([len(sample) for sample in samples], dtype=np.float64)
    weight = n / np.array([np.var(sample, ddof=1) for sample in samples])
    groups = len(samples)
    return float((groups**2 - 1) / (3.0 * np.sum((1.0 - weight / weight.sum()) ** 2 / (n - 1))))


def compare_pairs(samples: Samples) -> dict[tuple[int, int], PairTest | None]:
    """Return the test of each pair by Games and Howell; None for a pair without any spread.

    Each sample has at least two values. Keys are the numbers of two samples, the smaller first.
    """
    with np.errstate(all="ignore"):  # a pair without spread is 0 / 0
        p = scipy.stats.tukey_hsd(*samples, equal_var=False).pvalue
    return {
        (a, b): _compare_pair(samples[a], samples[b], float(p[a, b]), len(samples))
        if has_spread(samples[a]) or has_spread(samples[b])
        else None
        for a in range(len(samples))
        for b in range(a + 1, len(samples))
    }


def _compare_pair(a: Sequence[float], b: Sequence[float], p: float, groups: int) -> PairTest:
    squares = np.var(a, ddof=1) / len(a), np.var(b, ddof=1) / len(b)
    df = float(sum(squares) ** 2 / (squares[0] ** 2 / (len(a) - 1) + squares[1] ** 2 / (len(b) - 1)))
    difference = float(np.mean(a) - np.mean(b))
    half = _find_range_quantile(groups, df) * math.sqrt(sum(squares) / 2.0)
    return PairTest(difference, (difference - half, difference + half), p, df)


def _find_range_quantile(groups: int, df: float) -> float:
    """Return the quantile of the studentized range; Student's t for two means and Bonferroni's bound enclose it."""
    alpha = 1.0 - LEVEL
    low = math.sqrt(2.0) * float(special.stdtrit(df, 1.0 - alpha / 2.0))
    if groups == 2:
        return low
    high = math.sqrt(2.0) * float(special.stdtrit(df, 1.0 - alpha / (groups * (groups - 1))))
    return float(
        optimize.brentq(
            lambda q: scipy.stats.studentized_range.sf(q, groups, df) - alpha,
            0.999 * low,
            1.001 * high,
            xtol=1e-5,
        )
    )


def fit_slope(x: ArrayLike, y: ArrayLike, blocks: Sequence[object]) -> Slope | None:
    """Return the slope of y over x that all blocks share, each with a level of its own.

    Centring both on the means of their block leaves this slope to a plain regression, which then counts the levels as
    free though they are fitted: its error is corrected for that.

    Returns
    -------
    Slope or None
        None if x does not vary within blocks, or too few values are left.
    """
    inside = np.column_stack([_centre(x, blocks), _centre(y, blocks)])
    df = len(inside) - len(set(blocks)) - 1
    if df < 1 or not has_spread(list(inside[:, 0])):
        return None
    fit = scipy.stats.linregress(inside[:, 0], inside[:, 1])
    error = float(fit.stderr) * math.sqrt((len(inside) - 2) / df)
    slope = float(fit.slope)
    half = error * float(special.stdtrit(df, (1 + LEVEL) / 2))
    p = 2.0 * float(special.stdtr(df, -abs(slope / error))) if error > 0 else float(slope == 0.0)
    return Slope(slope, (slope - half, slope + half), p, df)


def _centre(values: ArrayLike, blocks: Sequence[object]) -> FloatArray:
    """Return values without the mean of their block."""
    numbers = {block: number for number, block in enumerate(dict.fromkeys(blocks))}
    places = np.array([numbers[block] for block in blocks])
    every = np.asarray(values, dtype=np.float64)
    means: FloatArray = np.bincount(places, every) / np.bincount(places)
    centred: FloatArray = every - means[places]
    return centred
