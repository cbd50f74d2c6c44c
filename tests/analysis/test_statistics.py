"""Mean, spread and interval, and tests of means against published results."""

import math

import numpy as np
import pytest
from scipy import stats

from labrig.analysis.statistics import (
    add_roll_uncertainty,
    compare_means,
    compare_pairs,
    compute_spread,
    has_spread,
)

# Dobson (1983), PlantGrowth of R: weights of plants with a control and two treatments. pingouin's `welch_anova` and
# `pairwise_gameshowell` printed the numbers; R's `oneway.test` prints the same F, degrees of freedom and p.
GROWTH = (
    [4.17, 5.58, 5.18, 6.11, 4.50, 4.61, 5.17, 4.53, 5.33, 5.14],
    [4.81, 4.17, 4.41, 3.59, 5.87, 3.83, 6.03, 4.89, 4.32, 4.69],
    [6.31, 5.12, 5.54, 5.50, 5.37, 5.29, 4.92, 6.15, 5.80, 5.26],
)
WELCH = (5.18097240811319, 17.12841861664413, 0.017392821490169984)
GAMES_HOWELL = {(0, 1): 0.4745549222, (0, 2): 0.1128891769, (1, 2): 0.0237034547}


@pytest.mark.parametrize(
    ("values", "mean", "sd", "half"),
    [((1.0, 2.0, 3.0), 2.0, 1.0, 2.4841), ((28.3,), 28.3, None, None), ((), None, None, None)],
)
def test_a_spread_is_that_of_the_tables(values, mean, sd, half):
    """1, 2, 3: t(0.975, 2) = 4.303 puts the interval at 2 -+ 2.484; a single value has no spread, and none no mean."""
    found = compute_spread(values)
    assert (found.n, found.mean, found.sd) == (len(values), mean, sd)
    expected = None if mean is None or half is None else pytest.approx((mean - half, mean + half), abs=1e-4)
    assert found.ci95 == expected


def test_the_interval_covers_as_often_as_it_says():
    """The 95 % intervals of 4000 samples of 18 normal radii hold the true mean in 95 % of cases, within 1.5 %."""
    random = np.random.default_rng(20260)
    samples = random.normal(27.6, 0.4, (4000, 18))
    ends = np.array([compute_spread(list(sample)).ci95 for sample in samples]) - 27.6
    assert np.mean(ends[:, 0] * ends[:, 1] < 0) == pytest.approx(0.95, abs=0.015)


def test_the_roll_moves_both_ends_of_an_interval_where_the_camera_is_known():
    """Perspective is linear in the roll; its share is independent of the scatter, and shared by all insertions.

    Without a camera it moves the lower end alone: at two degrees by 1 - cos(1.96 x 2 degrees), 0.23 %.
    """
    both = (28.2 - math.hypot(0.2, 0.294), 28.2 + math.hypot(0.2, 0.294))
    assert add_roll_uncertainty((28.0, 28.4), 2.0, 0.15) == pytest.approx(both)
    assert add_roll_uncertainty((28.0, 28.4), 2.0) == pytest.approx((28.0 * 0.99766, 28.4), abs=1e-3)
    assert add_roll_uncertainty((28.0, 28.4), 0.0) == (28.0, 28.4)
    assert add_roll_uncertainty(None, 2.0) is None


@pytest.mark.processors
def test_public_data_give_the_published_results():
    """Welch's F, degrees of freedom and p, and p of pairs, are those of pingouin; an interval of a pair is scipy's."""
    welch = compare_means(GROWTH)
    assert welch is not None
    assert (welch.f, welch.df_within, welch.p) == pytest.approx(WELCH, rel=1e-9)
    assert welch.df_between == 2.0
    pairs = compare_pairs(GROWTH)
    whole = stats.tukey_hsd(*GROWTH, equal_var=False).confidence_interval(0.95)
    low, high = np.asarray(whole.low), np.asarray(whole.high)
    for (a, b), p in GAMES_HOWELL.items():
        assert pairs[a, b].p == pytest.approx(p, abs=1e-8)
        assert pairs[a, b].difference == pytest.approx(np.mean(GROWTH[a]) - np.mean(GROWTH[b]))
        assert pairs[a, b].ci95 == pytest.approx((low[a, b], high[a, b]), rel=1e-5)


def test_too_little_gives_no_test():
    """Values without a spread are refused and not divided by."""
    assert compare_means([[1.0, 2.0]]) is None
    assert compare_means([[1.0, 2.0], [3.0, 3.0]]) is None
    assert not has_spread([27.6])
    assert not has_spread([27.6, 27.6])
