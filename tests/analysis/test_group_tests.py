"""Tests of means against published results, and what they do with too little."""

import numpy as np
import pytest
from scipy import stats

from labrig.analysis.statistics import compare_means, compare_pairs, has_spread
from tests.analysis.public_groups import PLANT_GROWTH, PUBLIC, PublicGroups


@pytest.mark.processors
@pytest.mark.parametrize("public", PUBLIC.values(), ids=PUBLIC)
def test_public_data_give_the_published_results(public: PublicGroups) -> None:
    """Welch's F, degrees of freedom and p, and p of pairs, are those of pingouin."""
    samples = list(public.samples.values())
    welch = compare_means(samples)
    assert welch is not None
    assert (welch.f, welch.df_within, welch.p) == pytest.approx(
        (public.f, public.df_within, public.p), rel=1e-9
    )
    assert welch.df_between == len(samples) - 1
    places = {name: place for place, name in enumerate(public.samples)}
    pairs = compare_pairs(samples)
    for (a, b), p in public.pairs.items():
        pair = pairs[places[a], places[b]]
        assert pair.p == pytest.approx(p, abs=1e-8)
        assert pair.difference == pytest.approx(np.mean(public.samples[a]) - np.mean(public.samples[b]))


@pytest.mark.processors
def test_an_interval_of_games_and_howell_is_that_of_scipy() -> None:
    """The quantile of a single pair is the one in scipy's table of all pairs."""
    samples = list(PLANT_GROWTH.samples.values())
    pair = compare_pairs(samples)[1, 2]
    whole = stats.tukey_hsd(*samples, equal_var=False).confidence_interval(0.95)
    low, high = np.asarray(whole.low), np.asarray(whole.high)
    assert pair.ci95 == pytest.approx((low[1, 2], high[1, 2]), rel=1e-5)


def test_too_little_gives_no_test() -> None:
    """Values without a spread are refused and not divided by."""
    assert compare_means([[1.0, 2.0]]) is None
    assert compare_means([[1.0, 2.0], [3.0, 3.0]]) is None
    assert not has_spread([27.6])
    assert not has_spread([27.6, 27.6])
    pairs = compare_pairs([[1.0, 1.0], [2.0, 2.0], [3.0, 4.0]])
    assert [pair.p is None for pair in pairs.values()] == [True, False, False]
