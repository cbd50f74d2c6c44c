"""A campaign goes on to its end, or a rule's, and keeps what is done whatever happens."""

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from pandas.testing import assert_frame_equal

from labrig.campaign.run import compute_campaign
from labrig.campaign.statistics import ends_by_rule
from labrig.campaign.store import ROWS_FILE, TABLE_FILE, open_store
from labrig.campaign.tasks import LoadedCampaign, Task
from labrig.errors import DiskError, InputError, LockedError, OutputExistsError, RecordError
from labrig.record.layout import CAMPAIGN as CAMPAIGN_FILE
from tests.campaign.campaigns import Law, computing, load, write_campaign
from tests.disks import full_disk

ARMS = {"vary": {"policy.replan_every_mm": [5, 10]}}


def conduct(
    loaded: LoadedCampaign, place: Path, law: Law, stop_at: int | None = None
) -> tuple[int, int, bool]:
    """Conduct a campaign whose tasks follow a law; return how many were and are done, and whether a rule ended it."""
    told: list[int] = []

    def progress(done: int) -> None:
        told.append(done)
        if done == stop_at:
            raise KeyboardInterrupt

    with open_store(place, loaded.describe()) as store:
        with suppress(KeyboardInterrupt):
            compute_campaign(loaded, store, computing(law), progress)
        return told[0], len(store.rows), ends_by_rule(loaded.file, loaded.by, store.rows)


def read(loaded: LoadedCampaign, place: Path) -> pd.DataFrame:
    """Return the table of a campaign."""
    with open_store(place, loaded.describe()) as store:
        return store.write_table()


def by_seed(task: Task) -> float:
    """Return a number that depends on the seed."""
    return task.seed % 1000 / 300.0


def test_the_table_has_a_row_for_each_task_with_its_values(tmp_path: Path) -> None:
    """Arm, repetition, seed, the varied keys, how it ended and its quantities; one that fails has no values."""
    loaded = load(write_campaign(tmp_path, **ARMS, repetitions=3))
    failing = loaded.find_task(2).seed
    law = lambda task: float("inf") if task.seed == failing else by_seed(task)  # noqa: E731
    assert conduct(loaded, tmp_path / "out", law) == (0, 6, False)
    table = read(loaded, tmp_path / "out")
    seeds = table["seed"].tolist()
    assert table["policy.replan_every_mm"].tolist() == [5.0, 10.0] * 3
    assert table["repetition"].tolist() == [0, 0, 1, 1, 2, 2]
    assert seeds[0::2] == seeds[1::2] == sorted(set(seeds), key=seeds.index)
    assert table["error"].isna().tolist() == [seed != failing for seed in seeds]
    values = [None if seed == failing else seed % 1000 / 300.0 for seed in seeds]
    assert table["true_target_error_mm"].astype(object).where(table["error"].isna(), None).tolist() == values


def test_one_that_was_interrupted_goes_on_to_the_same_table(tmp_path: Path) -> None:
    """What was done is not computed again."""
    loaded = load(write_campaign(tmp_path, **ARMS, repetitions=10))
    conduct(loaded, tmp_path / "whole", by_seed)
    conduct(loaded, tmp_path / "broken", by_seed, stop_at=7)
    assert conduct(loaded, tmp_path / "broken", by_seed) == (7, 20, False)
    assert_frame_equal(read(loaded, tmp_path / "broken"), read(loaded, tmp_path / "whole"))


def test_a_rule_ends_it_at_the_same_task_however_often_it_was_interrupted(tmp_path: Path) -> None:
    """And once it has ended, it computes no more."""
    loaded = load(write_campaign(tmp_path, **ARMS, stop_when={"ci95_width_mm": 0.6, "at_most": 500}))
    _, count, by_rule = conduct(loaded, tmp_path / "whole", by_seed)
    assert by_rule
    assert 60 < count < 1000
    for stop_at in (10, 59, 60, count - 1):
        conduct(loaded, tmp_path / "broken", by_seed, stop_at)
    assert conduct(loaded, tmp_path / "broken", by_seed) == (count - 1, count, True)
    assert conduct(loaded, tmp_path / "broken", by_seed) == (count, count, True)


RULE = {"ci95_width_mm": 0.5, "at_most": 200}


@pytest.mark.parametrize(
    ("begun", "keys", "difference"),
    [
        (ARMS, {"vary": {"policy.replan_every_mm": [5, 20]}}, r"replan_every_mm\.1 is 10 there and 20 here"),
        (ARMS, {**ARMS, "seed": 2}, "campaign.seed is 1 there and 2 here"),
        ({}, {"set": {"target.sd_mm": 1}}, r"target\.sd_mm is 0\.0 there and 1\.0 here"),
        ({"stop_when": RULE}, {"stop_when": {**RULE, "ci95_width_mm": 1}}, "rule.ci95_width_mm is 0.5 there"),
        ({"stop_when": RULE}, {"stop_when": RULE, "repetitions": 40}, "rule.repetitions is 1 there"),
        ({}, {"stop_when": RULE}, "rule.ci95_width_mm is None there and 0.5 here"),
    ],
)
def test_what_decides_the_rows_is_fixed_before_the_first_of_them(
    tmp_path: Path, begun: dict[str, object], keys: dict[str, object], difference: str
) -> None:
    """Another file, or another rule to stop, is refused with the difference; until then it may change."""
    sound, other = load(write_campaign(tmp_path, **begun)), load(write_campaign(tmp_path, **keys))
    for loaded in (other, sound):
        with open_store(tmp_path / "out", loaded.describe()):
            pass
    conduct(sound, tmp_path / "out", by_seed, stop_at=1)
    with pytest.raises(InputError, match=difference) as refused:
        conduct(other, tmp_path / "out", by_seed)
    assert "--out" in refused.value.hint
    assert len(read(sound, tmp_path / "out")) == 1


def test_it_goes_on_with_more_repetitions_and_another_judgement(tmp_path: Path) -> None:
    """Which leave the rows that are there as they are."""
    conduct(load(write_campaign(tmp_path, repetitions=2)), tmp_path / "out", by_seed)
    more = load(write_campaign(tmp_path, repetitions=5, tolerance=1.0, title="More", measure="replans"))
    assert conduct(more, tmp_path / "out", by_seed) == (2, 5, False)
    assert conduct(load(write_campaign(tmp_path)), tmp_path / "out", by_seed) == (5, 5, False)


def test_a_measure_that_no_task_has_is_refused_with_those_there_are(tmp_path: Path) -> None:
    """At the first task, or at the rows that are there; what is done stays done."""
    misspelt = load(write_campaign(tmp_path, repetitions=2, measure="true_target_eror_mm"))
    sound = load(write_campaign(tmp_path, repetitions=2))
    for done in (0, 2):
        with pytest.raises(InputError, match="no number 'true_target_eror_mm'") as refused:
            conduct(misspelt, tmp_path / "out", by_seed)
        assert "did you mean true_target_error_mm? name one of: true_target_error_mm" in refused.value.hint
        assert len(read(misspelt, tmp_path / "out")) == done
        conduct(sound, tmp_path / "out", by_seed)


CAMPAIGN = {"base": "insertion.yaml", "installation": {"labrig": "1.0"}}


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


def write(place: Path, rows: list[dict[str, Any]], **document: object) -> pd.DataFrame:
    """Write rows behind those that are there, and return the table."""
    with open_store(place, {**CAMPAIGN, **document}) as store:
        for new in rows:
            store.append(new)
        return store.write_table()


def test_a_column_has_one_type_and_the_table_does_not_depend_on_how_its_rows_came(tmp_path: Path) -> None:
    """A failed task has no values; the folder holds three files."""
    whole = write(tmp_path / "whole", ROWS)
    for part in (ROWS[:1], ROWS[1:2], ROWS[2:]):
        apart = write(tmp_path / "apart", part)
    assert_frame_equal(whole, apart)
    assert list(whole.columns[8:]) == ["error_mm", "arrived", "turns", "near", "word"]
    assert list(whole["seed"]) == [2**32 - 1 - task for task in range(4)]
    assert whole["error_mm"].tolist()[1:] == [1.0, 0.5, 0.25]
    assert (str(whole["turns"].dtype), str(whole["arrived"].dtype)) == ("Int64", "boolean")
    assert whole.loc[0, "error"] == "a worker died"
    assert whole.loc[0, ["error_mm", "arrived", "word"]].isna().all()
    names = sorted(path.name for path in (tmp_path / "whole").iterdir() if not path.name.startswith("."))
    assert names == [CAMPAIGN_FILE, TABLE_FILE, ROWS_FILE]


def test_rows_of_another_labrig_are_not_continued_and_those_of_other_kernels_are_named(
    tmp_path: Path,
) -> None:
    """Of another version they would have other bits; another process, or a folder of something else, is refused."""
    write(tmp_path, ROWS[:2])
    with pytest.raises(InputError, match=r"was begun with another version of labrig$"):
        write(tmp_path, [], installation={"labrig": "1.1"})
    document = json.loads((tmp_path / CAMPAIGN_FILE).read_text())
    document["processor"]["blas_numpy"] = "OpenBLAS Atom"
    (tmp_path / CAMPAIGN_FILE).write_text(json.dumps(document))
    with open_store(tmp_path, CAMPAIGN) as store:
        assert "OpenBLAS Atom, and this is " in store.change
        with pytest.raises(LockedError, match="in use by labrig campaign"):
            write(tmp_path, [])
    (tmp_path / "other" / "mine").mkdir(parents=True)
    with pytest.raises(OutputExistsError, match="holds mine and no campaign"):
        write(tmp_path / "other", [])


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
        write(tmp_path, [])


def test_a_torn_last_line_or_a_full_disk_costs_that_row_alone(tmp_path: Path) -> None:
    """Those before it are there, and the campaign goes on behind them."""
    with open_store(tmp_path, CAMPAIGN) as store:
        store.append(ROWS[0])
        with full_disk(100), pytest.raises(DiskError) as refused:
            store.append(ROWS[1])
        assert "1 tasks are done, and the same command goes on behind them" in refused.value.hint
    assert len(write(tmp_path, ROWS[1:3])) == 3
    file = tmp_path / ROWS_FILE
    file.write_bytes(file.read_bytes()[:-5])
    assert_frame_equal(write(tmp_path, ROWS[2:]), write(tmp_path / "whole", ROWS))
