"""Campaigns among measured runs: which arms are told apart, by which quantity, and what is not finished."""

from contextlib import suppress
from pathlib import Path

import pytest

from labrig.analysis.comparison import ComparedRuns, compare_runs
from labrig.analysis.measurements import open_measured_runs
from labrig.campaign.conduct import conduct_campaign
from labrig.campaign.run import open_store
from labrig.campaign.tasks import CampaignTasks
from tests.campaign.campaigns import computing, load, write_campaign
from tests.campaign.test_conduct import Told, by_seed

ARMS: dict[str, dict[str, object]] = {"default": {}, "near": {"policy.near_mm": 1}}


def make(folder: Path, name: str, stop_at: int | None = None, **keys: object) -> Path:
    """Return the folder of a campaign with these keys, which may be stopped at a task."""
    loaded = load(write_campaign(folder, campaign=name, **{"arms": ARMS, "repetitions": 3, **keys}))
    with (
        open_store(loaded, folder / name) as store,
        suppress(KeyboardInterrupt),
    ):
        conduct_campaign(CampaignTasks(loaded), store, computing(by_seed), Told(stop_at))
    return folder / name


def compare(*campaigns: Path, **options: object) -> ComparedRuns:
    """Compare campaigns."""
    return compare_runs(open_measured_runs(campaigns)[0], **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("by", [(), ("arm",)])
def test_arms_of_different_campaigns_are_told_apart(tmp_path: Path, by: tuple[str, ...]) -> None:
    """Whatever their names, by the name of their campaign."""
    first, second = make(tmp_path, "first"), make(tmp_path, "second", seed=2)
    groups = compare(first, second, by=by).comparison.groups
    assert [(group.name, group.n) for group in groups] == [
        ("first, arm default", 3),
        ("first, arm near", 3),
        ("second, arm default", 3),
        ("second, arm near", 3),
    ]
    assert [group.name for group in compare(first, by=by).comparison.groups] == ["arm default", "arm near"]


def test_campaigns_are_compared_by_the_quantity_of_their_pages(tmp_path: Path) -> None:
    """Unless these differ."""
    first = make(tmp_path, "first", measure="replans")
    assert compare(first).comparison.quantity == "replans"


def test_a_campaign_that_is_not_finished_is_named(tmp_path: Path) -> None:
    """With how many of its tasks are done; one that is done is not."""
    half = compare(make(tmp_path, "half", stop_at=4)).comparison
    assert "The campaign half is not finished: 4 of 6 tasks are done." in half.warnings
    assert half.used[0].exit_status == "incomplete"
    whole = compare(make(tmp_path, "whole")).comparison
    assert not any("finished" in sentence for sentence in whole.warnings)
    assert whole.used[0].exit_status == "success"


def test_a_campaign_that_its_rule_ended_is_finished(tmp_path: Path) -> None:
    """Although tasks are left."""
    rule = {"ci95_width_mm": 100, "at_most": 200}
    folder = make(tmp_path, "ruled", stop_when=rule)
    loaded = load(tmp_path / "campaign-tried.yaml")
    assert "not finished" in " ".join(compare(folder).comparison.warnings)
    with open_store(loaded, folder) as store:
        assert store.done == 60
        store.note_end()
    assert "not finished" not in " ".join(compare(folder).comparison.warnings)
