"""The result of a campaign and its page: what they state, and that what a user wrote stays text."""

from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest

from labrig.campaign.figures import draw_map
from labrig.campaign.page import write_page
from labrig.campaign.result import CampaignResult, make_result
from labrig.campaign.store import make_table
from labrig.campaign.tasks import LoadedCampaign, Task, make_row
from tests.campaign.campaigns import Law, computing, load, write_campaign
from tests.report.conftest import HOSTILE

NOW = datetime(2026, 11, 23, tzinfo=UTC)
INFINITE = float("inf")
PLACE = "target.position_mm"


def found(loaded: LoadedCampaign, law: Law) -> tuple[CampaignResult, pd.DataFrame]:
    """Return the result and the table of a campaign whose tasks follow a law."""
    outcomes = computing(law)(loaded.list_tasks())
    table = make_table(list(map(make_row, loaded.list_tasks(), outcomes)))
    return make_result(loaded, table, file=Path("table.parquet")), table


def test_the_worst_cases_are_named_with_the_command_that_makes_them(tmp_path: Path) -> None:
    """Those without a value first, then the largest; with every changed key, quoted for a shell, and the seed."""
    keys = {"vary": {"policy.replan_every_mm": [5, 10]}, "set": {"policy.near_mm": 0}, "repetitions": 20}
    loaded = load(write_campaign(tmp_path, **keys))
    without = loaded.find_task(6).seed
    result, table = found(loaded, lambda task: None if task.seed == without else task.seed % 100 / 50.0)
    first, second, third, *_ = result.worst
    assert (first.value, first.task, second.value, second.task) == (None, 6, None, 7)
    assert third.value == table["true_target_error_mm"].max()
    assert first.command[:3] == ("labrig", "run", str(loaded.base))
    assert first.command[-6:] == (
        "--seed", str(without), "--set", "policy.near_mm=0", "--set", "policy.replan_every_mm=5"
    )  # fmt: skip


def test_the_page_shows_arms_differences_errors_and_a_map(tmp_path: Path) -> None:
    """A sample of two keys with a tolerance has a map with the obstacles; failed tasks are counted with their error."""
    keys = {
        "vary": {"policy.replan_every_mm": [5, 10]},
        "sample": {"method": "sobol", "n": 16, "keys": {f"{PLACE}.2": [80, 105], f"{PLACE}.1": [-4, 8]}},
    }
    loaded = load(write_campaign(tmp_path, **keys))
    failing = loaded.find_task(3).seed
    result, table = found(loaded, lambda task: INFINITE if task.seed == failing else task.seed % 100 / 30.0)
    page = write_page(tmp_path, loaded, result, table, NOW).read_text(encoding="utf-8")
    assert result.failed == 2
    stated = (
        "a process died",
        "Differences from replan every 5 mm",
        "Map of replan every 10 mm",
        "16 by sobol",
    )
    assert all(text in page for text in stated)
    assert (tmp_path / "map-1.pdf").is_file()
    assert "mathdefault" not in page


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
            "1 of 2 arms differs from replan every 5 mm in the mean true error at the target: replan every 20 mm is 5",
        ),
        ({**ARMS, "repetitions": 9}, spread, "cannot tell them apart"),
        (ARMS, worse_at_20, "No difference from replan every 5 mm has an interval"),
        ({"repetitions": 9}, spread, "The mean true error at the target is 1."),
        (
            {},
            lambda _: 1.25,
            "One task has a value of the true error at the target: 1.25 mm. That tells no spread.",
        ),
        ({**ARMS, "repetitions": 2}, lambda _: None, "No task has a value of the true error at the target."),
        (ARMS, lambda _: INFINITE, "No task has a value of the true error at the target."),
    ],
)
def test_the_page_claims_what_its_intervals_hold(
    tmp_path: Path, keys: dict[str, object], law: Law, stated: str
) -> None:
    """A difference whose interval excludes 0, or that none does; no arm is called the best."""
    loaded = load(write_campaign(tmp_path, **keys))
    page = write_page(tmp_path, loaded, *found(loaded, law), NOW).read_text(encoding="utf-8")
    assert stated in page


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
    part = table.head(7)
    half = make_result(loaded, part, file=Path("table.parquet"))
    page = write_page(tmp_path, loaded, half, part, NOW).read_text(encoding="utf-8")
    assert result.ended == "complete"
    assert "7 of 12 are done." in page
    assert "makes them hold less often than 95 %" in page


def test_what_a_user_wrote_stays_text_on_the_page(tmp_path: Path) -> None:
    """Title, names of arms, and values."""
    arms: dict[str, dict[str, object]] = {HOSTILE[:60]: {}, "b": {}}
    loaded = load(write_campaign(tmp_path, title=HOSTILE, arms=arms))
    result, table = found(loaded, lambda _: 1.0)
    page = write_page(tmp_path, loaded, result, table, NOW).read_text(encoding="utf-8")
    assert HOSTILE not in page
    assert "<script>alert" not in page


def test_the_share_of_a_field_stands_where_its_points_are() -> None:
    """Rows go along y: what reaches the target with a large x and a small y is right below, not left above."""
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20)))
    table = pd.DataFrame({"x": x, "y": y, "error_mm": np.where((x > 0.5) & (y < 0.5), 1.0, 3.0)})
    result = cast("CampaignResult", SimpleNamespace(measure="error_mm", tolerance=2.0))
    axes = draw_map(result, table, ("x", "y"), (), "map").figure.axes[0]
    shares = np.asarray(axes.collections[0].get_array())
    assert (shares[0, -1], shares[-1, 0], shares[0, 0], shares[-1, -1]) == (1.0, 0.0, 0.0, 0.0)
