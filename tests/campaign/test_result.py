"""The result of a campaign and its page: what they state, and how often that holds."""

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from labrig.campaign.campaign_file import CampaignFile
from labrig.campaign.figures import draw_map
from labrig.campaign.page import write_page
from labrig.campaign.result import CampaignResult, make_result
from labrig.campaign.statistics import (
    bound_share,
    compare_arms,
    correlate,
    count_alike,
    ends_by_rule,
    judge_arm,
)
from labrig.campaign.store import make_table
from labrig.campaign.tasks import LoadedCampaign, Task, make_row
from labrig.protocol.sections import Criterion
from tests.campaign.campaigns import Law, computing, load, write_campaign
from tests.report.conftest import HOSTILE

NOW = datetime(2026, 11, 23, tzinfo=UTC)
INFINITE = float("inf")
PLACE = "target.position_mm"
OVER_TARGETS = {
    "sample": {"method": "sobol", "n": 16, "keys": {f"{PLACE}.2": [80, 105], f"{PLACE}.1": [-4, 8]}}
}


def found(loaded: LoadedCampaign, law: Law) -> tuple[CampaignResult, pd.DataFrame]:
    """Return the result and the table of a campaign whose tasks follow a law."""
    table = make_table(list(map(make_row, loaded.list_tasks(), computing(law)(loaded.list_tasks()))))
    return make_result(loaded, table, file=Path("table.parquet")), table


def test_the_worst_cases_are_named_with_the_command_that_makes_them(tmp_path: Path) -> None:
    """Failures first, then the largest; with every changed key, quoted for a shell, and the seed."""
    keys = {"vary": {"policy.replan_every_mm": [5, 10]}, "set": {"policy.near_mm": 0}, "repetitions": 3}
    loaded = load(write_campaign(tmp_path, **keys))
    without = loaded.find_task(2).seed
    result, table = found(loaded, lambda task: None if task.seed == without else task.seed % 100 / 50.0)
    first, second, *valued = result.worst
    assert (first.value, first.task, second.value, second.task) == (None, 2, None, 3)
    assert [case.value for case in valued] == sorted(table["true_target_error_mm"].dropna(), reverse=True)[:3]
    assert first.command[:3] == ("labrig", "run", str(loaded.base))
    assert first.command[-6:] == (
        "--seed", str(without), "--set", "policy.near_mm=0", "--set", "policy.replan_every_mm=5"
    )  # fmt: skip
    table.loc[table["true_target_error_mm"].idxmax(), "exit_status"] = "failed"
    table["true_target_error_mm"] += 9
    result = make_result(loaded, table, file=Path())
    page = write_page(tmp_path, loaded, result, table, NOW).read_text(encoding="utf-8")
    assert (result.worst[0].end, "Wrong successes (3), and failures, 2 of 3" in page) == ("success", True)


def test_the_page_shows_arms_differences_errors_and_a_map(tmp_path: Path) -> None:
    """A sample of two keys has a map with the obstacles; failed tasks are counted; what a user wrote stays text."""
    keys = {
        "title": HOSTILE,
        "arms": {HOSTILE[:60]: {"policy.replan_every_mm": 5}, "b": {}},
        **OVER_TARGETS,
    }
    loaded = load(write_campaign(tmp_path, **keys))
    failing = loaded.find_task(3).seed
    result, table = found(loaded, lambda task: INFINITE if task.seed == failing else task.seed % 100 / 30.0)
    page = write_page(tmp_path, loaded, result, table, NOW).read_text(encoding="utf-8")
    assert (result.failed, (tmp_path / "map-1.pdf").is_file()) == (2, True)
    for text in ("a process died", "Differences from ", "Map of “b”", "16 by a Sobol sequence"):
        assert text in page
    assert not [text for text in (HOSTILE, "<script>alert", "mathdefault") if text in page]
    assert "“b”: as the base protocol." in page
    assert "<td>Replan after this much insertion</td>" in page


ARMS = {"vary": {"policy.replan_every_mm": [5, 10, 20]}}


def spread(task: Task) -> float:
    """Return a value that depends on the seed."""
    return task.seed % 100 / 30.0


def worse_at_20(task: Task) -> float:
    """Return a value that is larger by 5 in one of the arms."""
    return spread(task) + 5.0 * (task.arm.name == "replan_every_mm=20")


@pytest.mark.parametrize(
    ("keys", "law", "stated"),
    [
        (
            {**ARMS, "repetitions": 9},
            worse_at_20,
            ("Replanning every 20 mm gave a larger mean true error at the target than every 5 mm, by <b>5.00 mm</b> "
            "(95 % interval 5.00 to 5.00 mm, 9 pairs). 10 mm cannot be told from 5 mm."),
        ),
        ({**ARMS, "repetitions": 9}, spread, "cannot tell replanning every 10 mm or every 20 mm from every 5 mm"),
        (ARMS, worse_at_20, "No difference from replan every 5 mm has an interval"),
        (OVER_TARGETS, lambda _: 3.0, "All of the other 16 targets lie within 29 mm of the edge of the obstacle at z"),
        ({"repetitions": 9}, spread, "The mean true error at the target is 1."),
        ({}, lambda _: 1.25, "One task has a value of the true error at the target: 1.25 mm. That tells no spread."),
        ({"sample": {"method": "latin-hypercube", "n": 40, "keys": {"planner.radius_mm": [24, 31]}}},
         lambda task: None if task.drawn["planner.radius_mm"] > 28.4 else spread(task),
         "\">Being stopped before the insertion to the target goes with a larger planned radius."),
        ({"sample": {"method": "sobol", "n": 16, "keys": {"rig.world.needle.backlash_mm": [0.5, 6]}}},
         spread, "Upright and green: what the insertion takes for granted."),
        (ARMS, lambda _: INFINITE, "No task has a value of the true error at the target."),
    ],
)  # fmt: skip
def test_the_page_claims_what_its_intervals_hold(
    tmp_path: Path, keys: dict[str, object], law: Law, stated: str
) -> None:
    """A difference whose interval excludes 0, or that none does; no arm is called the best."""
    loaded = load(write_campaign(tmp_path, **keys))
    page = write_page(tmp_path, loaded, *found(loaded, law), NOW).read_text(encoding="utf-8")
    assert stated in " ".join(page.split())


def test_one_value_has_neither_an_interval_nor_a_quantile(tmp_path: Path) -> None:
    """Nor has one pair; a dash stands there, and the caption says why."""
    result, _ = found(load(write_campaign(tmp_path, **ARMS)), spread)
    assert {(arm.ci95, arm.sd, arm.q90) for arm in result.arms} == {(None, None, None)}
    assert {(pair.ci95, pair.share_ci95) for pair in result.pairs} == {(None, None)}
    assert all(pair.mean == pair.share == 0.0 for pair in result.pairs)


def test_an_unfinished_page_says_so_beside_its_intervals(tmp_path: Path) -> None:
    """A look that nobody planned is one more chance to stop too early."""
    loaded = load(write_campaign(tmp_path, **ARMS, repetitions=4))
    result, table = found(loaded, spread)
    half = make_result(loaded, table.head(7), file=Path("table.parquet"))
    page = write_page(tmp_path, loaded, half, table.head(7), NOW).read_text(encoding="utf-8")
    assert (result.ended, "7 of 12 are done." in page) == ("complete", True)
    assert "makes them hold less often than 95\u00a0%" in page


def test_the_share_of_a_field_stands_where_its_points_are() -> None:
    """Rows go along y: what reaches the target with a large x and a small y is right below, not left above."""
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20)))
    table = pd.DataFrame({"x": x, "y": y, "error_mm": np.where((x > 0.5) & (y < 0.5), 1.0, 3.0)})
    result = cast("CampaignResult", SimpleNamespace(measure="error_mm", tolerance=2.0))
    axes = draw_map(result, table, {"x": (0, 1), "y": (0, 1)}, (), "map").figure.axes[0]
    shares = np.asarray(axes.collections[0].get_array())
    assert (shares[0, -1], shares[-1, 0], shares[0, 0], shares[-1, -1]) == (1.0, 0.0, 0.0, 0.0)


BY = Criterion("error_mm", 2.0)


def table(values: "dict[str, list[float | None]]", failed: int = 0) -> pd.DataFrame:
    """Return a table with these values of each arm; the first `failed` tasks of each ended with an error."""
    listed = [(arm, number, value) for arm in values for number, value in enumerate(values[arm])]
    found = pd.DataFrame(listed, columns=["arm", "repetition", "error_mm"])
    reached = found["error_mm"] <= 2.0
    return found.assign(
        point=0,
        error=found["repetition"].map(lambda number: "it died" if number < failed else None),
        exit_status=reached.map({True: "success", False: "failed"}),
        reason=reached.map({True: None, False: "target_missed"}),
    )


def test_an_arm_has_mean_share_and_ends_of_the_tasks_that_did_not_fail() -> None:
    """Without a value it is beyond the tolerance, a failed one counts for nothing; no error is below 0."""
    found = judge_arm(table({"a": [9.0, 1.0, 3.0, None, 1.5]}, failed=1), "a", {}, BY)
    assert (found.tasks, found.failed, found.n) == (5, 1, 3)
    assert found.mean == pytest.approx((1.0 + 3.0 + 1.5) / 3)
    reference = stats.ttest_1samp([1.0, 3.0, 1.5], 0.0).confidence_interval(0.95)
    assert reference.low < 0.0
    assert found.ci95 == pytest.approx((0.0, reference.high))
    assert (found.within_tolerance, found.share) == (2, 0.5)
    assert found.ends == {"success": 2, "target_missed": 2}
    assert count_alike(pd.Series(["0.51 mm off", "b", "10.20 mm off"])) == {"… mm off": 2, "b": 1}


def test_without_values_there_are_no_figures_and_the_interval_of_a_share_is_wilsons() -> None:
    """Such as of an arm whose tasks all failed; of all, the upper end of a share is 1."""
    found = judge_arm(table({"a": [1.0, 2.0]}, failed=2), "a", {}, BY)
    assert (found.n, found.mean, found.ci95, found.share, found.share_ci95) == (0, None, None, None, None)
    assert (bound_share(20, 20), bound_share(0, 0)) == ((pytest.approx(0.8389, abs=1e-4), 1.0), None)


def test_the_rank_correlation_tells_which_sampled_key_matters() -> None:
    """1 for a key with which the measure rises, however bent, and none from fewer than ten values."""
    rows = table({"a": [0.1, 0.2, 0.5, 0.9, 1.0, 1.2, 1.3, 5.0, 7.0, 50.0]}).assign(steps=range(10))
    assert correlate(rows, ("steps",), BY)["error_mm"] == {"steps": pytest.approx(1.0)}
    assert correlate(rows[:9], ("steps",), BY) == {}
    lost = rows.assign(error_mm=rows["error_mm"].where(rows["steps"] > 1), broken_off=rows["steps"] == 9)
    found = correlate(lost, ("steps",), BY)
    assert found["error_mm"] == {"steps": pytest.approx(1.0)}  # what never came to its end has no error
    assert found["broken_off"]["steps"] > 0.5 > -0.5 > found["without_value"]["steps"]
    arm = judge_arm(lost, "a", {}, BY)
    assert (arm.n, arm.broken_off, arm.within_tolerance, arm.false_successes) == (7, 1, 5, 0)
    assert (arm.mean, arm.ends["broken_off"]) == (pytest.approx(2.27, abs=0.2), 1)


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
    """200 draws of 60 pairs with a known difference: the interval holds it in 95 %, give or take 3.5."""
    random = np.random.default_rng(2)
    held, true = 0, 0.1
    for _ in range(200):
        common = random.random(60) < 0.5
        a = np.where(common, 1.0, np.where(random.random(60) < 0.4, 1.0, 3.0))
        b = np.where(common, 1.0, np.where(random.random(60) < 0.6, 1.0, 3.0))
        (found,) = compare_arms(table({"a": a.tolist(), "b": b.tolist()}), ("a", "b"), BY)
        low, high = found.share_ci95 or (math.nan, math.nan)
        held += low <= true <= high
    assert 0.915 <= held / 200 <= 0.985


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
    random, file, held = np.random.default_rng(3), rule(0.6), 0
    for _ in range(300):
        values = random.normal(size=400).tolist()
        end = next(look for look in file.looks if ends(file, values[:look]))
        low, high = judge_arm(table({"a": values[:end]}), "a", {}, BY).ci95 or (math.nan, math.nan)
        held += low <= 0.0 <= high
    assert held / 300 >= 0.91
