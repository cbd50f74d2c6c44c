"""Tests of means against published results, and what they do with too little."""

import math

import numpy as np
import pytest
from scipy import stats

from labrig.analysis.group_tests import (
    compare_means,
    compare_pairs,
    compute_effect_size,
    fit_slope,
    has_spread,
)
from tests.analysis.public_groups import PLANT_GROWTH, PUBLIC, PublicGroups


@pytest.mark.processors
@pytest.mark.parametrize("public", PUBLIC.values(), ids=PUBLIC)
def test_public_data_give_the_published_results(public: PublicGroups) -> None:
    """Welch's F, degrees of freedom and p, and p and g of pairs, are those of pingouin."""
    samples = list(public.samples.values())
    welch = compare_means(samples)
    assert (welch.f, welch.df_within, welch.p) == pytest.approx(
        (public.f, public.df_within, public.p), rel=1e-9
    )
    assert welch.df_between == len(samples) - 1
    places = {name: place for place, name in enumerate(public.samples)}
    pairs = compare_pairs(samples)
    for (a, b), p in public.pairs.items():
        pair = pairs[places[a], places[b]]
        assert pair is not None
        assert pair.p == pytest.approx(p, abs=1e-8)
        assert pair.difference == pytest.approx(np.mean(public.samples[a]) - np.mean(public.samples[b]))
        size = compute_effect_size(public.samples[a], public.samples[b])
        # pingouin takes 1 - 3 / (4 n - 9) for the correction of small samples, which is exact to 2e-4 here.
        assert size is not None
        assert size.g == pytest.approx(public.hedges_g[a, b], rel=3e-4)


@pytest.mark.processors
def test_an_interval_of_games_and_howell_is_that_of_scipy() -> None:
    """The quantile of a single pair is the one in scipy's table of all pairs."""
    samples = list(PLANT_GROWTH.samples.values())
    pair = compare_pairs(samples)[1, 2]
    whole = stats.tukey_hsd(*samples, equal_var=False).confidence_interval(0.95)
    low, high = np.asarray(whole.low), np.asarray(whole.high)
    assert pair is not None
    assert pair.ci95 == pytest.approx((low[1, 2], high[1, 2]), rel=1e-5)


@pytest.mark.processors
def test_the_interval_of_g_holds_the_true_difference_as_often_as_it_says() -> None:
    """Of 2,000 pairs of three and four normal values a standard deviation apart, 95 % of the intervals hold it."""
    random = np.random.default_rng(3)
    holding = 0
    for _ in range(2000):
        size = compute_effect_size(list(random.normal(1.0, 1.0, 3)), list(random.normal(0.0, 1.0, 4)))
        assert size is not None
        assert size.ci95 is not None
        # The correction for small samples shrinks g and its interval alike, and not what it estimates.
        low, high = (end * math.sqrt(5 / 2) * math.gamma(2.0) / math.gamma(2.5) for end in size.ci95)
        holding += low <= 1.0 <= high
    assert holding / 2000 == pytest.approx(0.95, abs=0.015)


def test_a_slope_within_blocks_is_that_of_a_regression_with_a_level_for_each() -> None:
    """Slope, interval and p agree with least squares on indicator columns, and levels of blocks do not matter."""
    random = np.random.default_rng(1)
    blocks = ["a"] * 6 + ["b"] * 6
    x = np.tile(np.arange(6.0), 2)
    y = 0.3 * x + random.normal(0.0, 0.2, 12) + np.where(np.array(blocks) == "a", 0.0, 50.0)
    slope = fit_slope(x, y, blocks)
    design = np.column_stack([x, np.array(blocks) == "a", np.array(blocks) == "b"]).astype(float)
    fitted, squares, _, _ = np.linalg.lstsq(design, y)
    error = math.sqrt(squares[0] / 9 * np.linalg.inv(design.T @ design)[0, 0])
    assert slope is not None
    assert slope.slope == pytest.approx(fitted[0])
    assert slope.df == 9
    half = stats.t.ppf(0.975, 9) * error
    assert slope.ci95 == pytest.approx((fitted[0] - half, fitted[0] + half))
    assert slope.p == pytest.approx(2 * stats.t.sf(abs(fitted[0]) / error, 9))


def test_too_little_gives_no_test() -> None:
    """Values without a spread, or a slope over what does not vary, are refused and not divided by."""
    assert not has_spread([27.6])
    assert not has_spread([27.6, 27.6])
    assert compute_effect_size([1.0, 1.0], [2.0, 2.0]) is None
    pairs = compare_pairs([[1.0, 1.0], [2.0, 2.0], [3.0, 4.0]])
    assert [pair is None for pair in pairs.values()] == [True, False, False]
    assert fit_slope([1.0, 1.0, 1.0], [1.0, 2.0, 3.0], ["a"] * 3) is None
    assert fit_slope([1.0, 2.0], [1.0, 2.0], ["a"] * 2) is None
    beyond = compute_effect_size([1.0, 1.001], [500.0, 500.001])
    assert beyond is not None
    assert beyond.ci95 is None
