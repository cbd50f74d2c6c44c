"""Means, shares and differences of arms, checked against other libraries and by coverage."""

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from labrig.campaign.campaign_file import CampaignFile
from labrig.campaign.statistics import bound_share, compare_arms, ends_by_rule, judge_arm
from labrig.protocol.sections import Criterion

BY = Criterion("error_mm", 2.0)


def table(values: "dict[str, list[float | None]]", failed: int = 0) -> pd.DataFrame:
    """Return a table with these values of each arm; the first `failed` tasks of each ended with an error."""
    rows = [
        {
            "arm": arm,
            "point": 0,
            "repetition": number,
            "error_mm": value,
            "error": "it died" if number < failed else None,
            "exit_status": "success" if value is not None and value <= 2.0 else "failed",
            "reason": None if value is not None and value <= 2.0 else "target_missed",
        }
        for arm, listed in values.items()
        for number, value in enumerate(listed)
    ]
    return pd.DataFrame(rows)


def test_an_arm_has_mean_share_and_ends_of_the_tasks_that_did_not_fail() -> None:
    """A task without a value is beyond the tolerance, a failed one counts for nothing; no error is below 0."""
    found = judge_arm(table({"a": [9.0, 1.0, 3.0, None, 1.5]}, failed=1), "a", {}, BY)
    assert (found.tasks, found.failed, found.n) == (5, 1, 3)
    assert found.mean == pytest.approx((1.0 + 3.0 + 1.5) / 3)
    reference = stats.ttest_1samp([1.0, 3.0, 1.5], 0.0).confidence_interval(0.95)
    assert reference.low < 0.0
    assert found.ci95 == pytest.approx((0.0, reference.high))
    assert (found.within_tolerance, found.share) == (2, 0.5)
    assert found.ends == {"success": 2, "target_missed": 2}


def test_without_values_there_are_no_figures_and_the_interval_of_a_share_is_wilsons() -> None:
    """Such as of an arm whose tasks all failed; of all, the upper end of a share is 1."""
    found = judge_arm(table({"a": [1.0, 2.0]}, failed=2), "a", {}, BY)
    assert (found.n, found.mean, found.ci95, found.share, found.share_ci95) == (0, None, None, None, None)
    assert bound_share(20, 20) == (pytest.approx(0.8389, abs=1e-4), 1.0)
    assert bound_share(0, 0) is None


def test_differences_are_over_pairs_with_the_same_seed() -> None:
    """As a paired t test; a pair without one of its values is left out of the mean, not of the share."""
    values: dict[str, list[float | None]] = {"a": [1.0, 3.0, 1.2, None], "b": [1.5, 3.2, 2.4, 1.0]}
    (found,) = compare_arms(table(values), ("a", "b"), BY)
    reference = stats.ttest_rel([1.5, 3.2, 2.4], [1.0, 3.0, 1.2]).confidence_interval(0.95)
    assert (found.n, found.pairs) == (3, 4)
    assert found.ci95 == pytest.approx((reference.low, reference.high))
    assert found.share == pytest.approx(0.0)


def test_intervals_of_several_differences_are_wider_than_of_one() -> None:
    """They hold together."""
    random = np.random.default_rng(1)
    values = {name: random.normal(size=20).tolist() for name in "abcd"}
    alone = compare_arms(table({name: values[name] for name in "ab"}), "ab", BY)[0].ci95
    together = compare_arms(table(values), "abcd", BY)[0].ci95
    assert alone is not None
    assert together is not None
    assert together[1] - together[0] > alone[1] - alone[0]


def test_paired_shares_are_covered() -> None:
    """300 draws of 60 pairs with a known difference: the interval holds it in 95 %, give or take 3.5."""
    random = np.random.default_rng(2)
    held, true = 0, 0.1
    for _ in range(300):
        common = random.random(60) < 0.5
        a = np.where(common, 1.0, np.where(random.random(60) < 0.4, 1.0, 3.0))
        b = np.where(common, 1.0, np.where(random.random(60) < 0.6, 1.0, 3.0))
        (found,) = compare_arms(table({"a": a.tolist(), "b": b.tolist()}), ("a", "b"), BY)
        low, high = found.share_ci95 or (math.nan, math.nan)
        held += low <= true <= high
    assert 0.915 <= held / 300 <= 0.985


def rule(width: float, at_least: int = 30) -> CampaignFile:
    """Return a campaign of one arm with a rule."""
    stop = {"ci95_width_mm": width, "at_most": 10_000}
    keys = {"campaign": "c", "base": "p.yaml", "seed": 5, "repetitions": at_least, "stop_when": stop}
    return CampaignFile.model_validate(keys)


def ends(file: CampaignFile, values: Sequence[float]) -> bool:
    """Return whether a campaign ends with the rows of these values."""
    return ends_by_rule(file, BY, [{"arm": "a", "error": None, "error_mm": value} for value in values])


@given(st.lists(st.floats(-5, 5), min_size=30, max_size=60))
def test_the_rule_sees_the_interval_that_the_page_shows(values: list[float]) -> None:
    """It is met at a look just when the width is at most the wanted one."""
    found = judge_arm(table({"a": [*values]}), "a", {}, BY).ci95
    assert found is not None
    width = found[1] - found[0]
    for wanted, met in ((width * 1.001 + 1e-9, True), (width * 0.999 - 1e-9, False)):
        if wanted > 0:
            assert ends(rule(wanted, len(values)), values) is met


def test_the_rule_looks_at_numbers_of_repetitions_fixed_beforehand() -> None:
    """First where the file says, then after a quarter more: each look is a chance to stop too early."""
    narrow = [0.0, 1.0] * 15 + [0.5] * 200
    for width, end in ((0.5, 30), (0.3, 38), (0.25, 48), (0.16, 75)):
        assert next(n for n in range(len(narrow)) if ends(rule(width), narrow[:n])) == end


def test_a_mean_that_a_rule_stopped_is_still_covered() -> None:
    """300 campaigns of normal values that end at a width: the interval holds the mean in 91 % or more."""
    random, file, held = np.random.default_rng(3), rule(0.45), 0
    for _ in range(300):
        values = random.normal(size=1000).tolist()
        end = next(look for look in file.looks if ends(file, values[:look]))
        low, high = judge_arm(table({"a": values[:end]}), "a", {}, BY).ci95 or (math.nan, math.nan)
        held += low <= 0.0 <= high
    assert held / 300 >= 0.91
