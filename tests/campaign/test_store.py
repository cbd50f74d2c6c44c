"""The table of a campaign as it grows: resumption, damage, strangers and full disks."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from pandas.testing import assert_frame_equal

from labrig.campaign.store import ROWS_FILE, TABLE_FILE, CampaignPlan, CampaignStore
from labrig.errors import DiskError, InputError, LockedError, OutputExistsError, RecordError
from labrig.record.layout import CAMPAIGN as CAMPAIGN_FILE
from tests.disks import full_disk

CAMPAIGN = {"base": "insertion.yaml", "grid": {"replan_mm": [10, 20]}}
PLAN = CampaignPlan(arms=2, tasks=1000, measure="error_mm", rule=None)


def row(task: int, **values: Any) -> dict[str, Any]:
    """Return the row of a task that succeeded."""
    fixed = {"task": task, "arm": "a", "repetition": 0, "seed": 2**32 - 1 - task, "exit_status": "success"}
    return {**fixed, "reason": None, "error": None, **values}


ROWS = [
    row(0) | {"exit_status": None, "error": "a worker died"},
    row(1, error_mm=1, arrived=True, turns=3, near=None),
    row(2, error_mm=0.5, arrived=None, turns=None, word="plan"),
    row(3, error_mm=0.25, arrived=False, turns=4, word="retreat"),
]


def write(place: Path, *parts: list[dict[str, Any]]) -> pd.DataFrame:
    """Write parts, each by a process of its own as far as the store can tell, and return the table."""
    for part in parts:
        with CampaignStore.open(place, CAMPAIGN, PLAN) as store:
            store.append(part)
    with CampaignStore.open(place, CAMPAIGN, PLAN) as store:
        return store.write_table()


def test_the_table_does_not_depend_on_its_parts(tmp_path: Path) -> None:
    """Rows are read back with the same columns and types however they came; a failed task has no values."""
    whole = write(tmp_path / "whole", ROWS)
    apart = write(tmp_path / "apart", ROWS[:1], ROWS[1:2], ROWS[2:])
    assert_frame_equal(whole, apart)
    assert list(whole.columns[8:]) == ["error_mm", "arrived", "turns", "near", "word"]
    assert list(whole["seed"]) == [2**32 - 1 - task for task in range(4)]
    assert whole["error_mm"].tolist()[1:] == [1.0, 0.5, 0.25]
    assert whole["turns"].isna().tolist() == [True, False, True, False]
    assert (str(whole["turns"].dtype), str(whole["arrived"].dtype)) == ("Int64", "boolean")
    assert whole.loc[0, "error"] == "a worker died"
    assert whole.loc[0, ["error_mm", "arrived", "word"]].isna().all()


def test_a_campaign_that_was_begun_goes_on_behind_its_rows(tmp_path: Path) -> None:
    """An empty folder is begun; later the leading tasks are done, and rows of others are refused."""
    with CampaignStore.open(tmp_path / "new", CAMPAIGN, PLAN) as store:
        assert (store.done, len(store.write_table())) == (0, 0)
        store.append(ROWS[:2])
    with CampaignStore.open(tmp_path / "new", CAMPAIGN, PLAN) as store:
        assert store.done == 2
        with pytest.raises(ValueError, match="expected those from 2 on"):
            store.append([row(3)])
    names = sorted(path.name for path in (tmp_path / "new").iterdir() if not path.name.startswith("."))
    assert names == [CAMPAIGN_FILE, TABLE_FILE, ROWS_FILE]


def test_another_campaign_is_refused_with_the_difference(tmp_path: Path) -> None:
    """A folder keeps one campaign; what differs is named with both values, and nothing is written."""
    write(tmp_path, ROWS)
    other = {**CAMPAIGN, "grid": {"replan_mm": [10, 30]}}
    with pytest.raises(InputError, match=r"grid\.replan_mm\.1 is 20 there and 30 here") as refused:
        CampaignStore.open(tmp_path, other, PLAN)
    assert "--out" in refused.value.hint
    assert len(write(tmp_path)) == 4


RULE = {"ci95_width_mm": 0.5, "at_most": 200}


def test_a_plan_may_grow_but_not_below_what_is_done(tmp_path: Path) -> None:
    """The file of the campaign has the plan that was given last; fewer tasks than are done are refused."""
    write(tmp_path, ROWS)
    more = replace(PLAN, tasks=2000, measure="turns")
    with CampaignStore.open(tmp_path, CAMPAIGN, more):
        pass
    assert json.loads((tmp_path / CAMPAIGN_FILE).read_text())["plan"] == asdict(more)
    with pytest.raises(InputError, match="holds 4 tasks, and the file asks for 3"):
        CampaignStore.open(tmp_path, CAMPAIGN, replace(PLAN, tasks=3))
    assert len(write(tmp_path)) == 4


def test_a_rule_is_fixed_before_the_first_task(tmp_path: Path) -> None:
    """Until then it may change; later another one, or none, is refused with the difference, and the rows stay."""
    ruled = replace(PLAN, rule=RULE)
    with CampaignStore.open(tmp_path, CAMPAIGN, PLAN):
        pass
    with CampaignStore.open(tmp_path, CAMPAIGN, ruled) as store:
        store.append(ROWS)
    for rule, difference in (
        ({**RULE, "ci95_width_mm": 0.6}, r"rule\.ci95_width_mm is 0\.5 there and 0\.6 here"),
        (None, "is 0.5 there and None here"),
    ):
        with pytest.raises(InputError, match=difference) as refused:
            CampaignStore.open(tmp_path, CAMPAIGN, replace(PLAN, rule=rule))
        assert "fixed before the first task" in refused.value.hint
    with CampaignStore.open(tmp_path, CAMPAIGN, ruled) as store:
        assert store.done == 4


def test_rows_of_another_labrig_are_not_continued(tmp_path: Path) -> None:
    """A campaign that another version began is refused: its rows would have other bits."""
    write(tmp_path, ROWS)
    document = json.loads((tmp_path / CAMPAIGN_FILE).read_text())
    document["installation"]["labrig"] = "0.0.9"
    (tmp_path / CAMPAIGN_FILE).write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"labrig is 0\.0\.9 there") as refused:
        CampaignStore.open(tmp_path, CAMPAIGN, PLAN)
    assert "--out" in refused.value.hint


def test_a_campaign_that_goes_on_with_other_kernels_says_so(tmp_path: Path) -> None:
    """It goes on, and tells which kernels its first rows were made with."""
    write(tmp_path, ROWS[:2])
    document = json.loads((tmp_path / CAMPAIGN_FILE).read_text())
    document["processor"]["blas_numpy"] = "OpenBLAS Atom"
    (tmp_path / CAMPAIGN_FILE).write_text(json.dumps(document))
    with CampaignStore.open(tmp_path, CAMPAIGN, PLAN) as store:
        assert store.change.startswith("made with OpenBLAS Atom, and this is OpenBLAS ")
        assert store.done == 2


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    """A folder with other files is no place for a campaign."""
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputExistsError, match=r"holds notes\.txt and no campaign"):
        CampaignStore.open(tmp_path, CAMPAIGN, PLAN)


def test_a_torn_last_line_is_done_again(tmp_path: Path) -> None:
    """A row whose writing was cut short does not count; the same task replaces it."""
    write(tmp_path, ROWS)
    file = tmp_path / ROWS_FILE
    file.write_bytes(file.read_bytes()[:-5])
    with CampaignStore.open(tmp_path, CAMPAIGN, PLAN) as store:
        assert store.done == 3
        store.append(ROWS[3:])
    assert len(write(tmp_path)) == 4


def _cut_middle(lines: list[bytes]) -> list[bytes]:
    return [lines[0], lines[1][:9], *lines[2:]]


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        (ROWS_FILE, _cut_middle, r"tasks\.jsonl:2: the line is damaged"),
        (ROWS_FILE, lambda lines: [lines[0], *lines[2:]], "lacks rows between others"),
        (CAMPAIGN_FILE, lambda _: [b"{"], r"campaign\.json is damaged"),
    ],
)
def test_what_is_damaged_or_missing_is_named(
    tmp_path: Path, name: str, spoil: Callable[[list[bytes]], list[bytes]], message: str
) -> None:
    """Nothing is repaired silently."""
    write(tmp_path, ROWS)
    file = tmp_path / name
    file.write_bytes(b"\n".join(spoil(file.read_bytes().split(b"\n"))))
    with pytest.raises(RecordError, match=message):
        CampaignStore.open(tmp_path, CAMPAIGN, PLAN)


def test_a_second_process_is_refused(tmp_path: Path) -> None:
    """Only one labrig writes a campaign in a folder at a time."""
    with (
        CampaignStore.open(tmp_path, CAMPAIGN, PLAN),
        pytest.raises(LockedError, match="in use by labrig campaign"),
    ):
        CampaignStore.open(tmp_path, CAMPAIGN, PLAN)
    with CampaignStore.open(tmp_path, CAMPAIGN, PLAN):
        pass


def test_a_full_disk_costs_the_rows_at_hand_alone(tmp_path: Path) -> None:
    """A part that does not fit is not there; the rows before it are, and later the campaign goes on."""
    with CampaignStore.open(tmp_path, CAMPAIGN, PLAN) as store:
        store.append(ROWS[:2])
        with full_disk(100), pytest.raises(DiskError) as refused:
            store.append(ROWS[2:])
        assert "2 tasks are done, and the same command goes on behind them" in refused.value.hint
    assert len(write(tmp_path, ROWS[2:])) == 4
