"""The table of a campaign as it grows: parts, resumption, damage, strangers, full disks and object stores."""

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import fsspec
import pandas as pd
import pytest
from moto.server import ThreadedMotoServer
from pandas.testing import assert_frame_equal

from labrig.campaign.store import CampaignPlan, CampaignStore
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


def write(place: Path | str, *parts: list[dict[str, Any]]) -> pd.DataFrame:
    """Write parts, each by a process of its own as far as the store can tell, and return the table."""
    for part in parts:
        with CampaignStore.open(str(place), CAMPAIGN, PLAN) as store:
            store.append(part)
    with CampaignStore.open(str(place), CAMPAIGN, PLAN) as store:
        return store.read()


def test_the_table_does_not_depend_on_its_parts(tmp_path: Path) -> None:
    """Rows are read back with the same columns and types however they came; a failed task has no values."""
    whole = write(tmp_path / "whole", ROWS)
    apart = write(tmp_path / "apart", ROWS[:1], ROWS[1:2], ROWS[2:])
    assert_frame_equal(whole, apart)
    assert list(whole.columns[7:]) == ["error_mm", "arrived", "turns", "near", "word"]
    assert list(whole["seed"]) == [2**32 - 1 - task for task in range(4)]
    assert whole["error_mm"].tolist()[1:] == [1.0, 0.5, 0.25]
    assert whole["turns"].isna().tolist() == [True, False, True, False]
    assert (str(whole["turns"].dtype), str(whole["arrived"].dtype)) == ("Int64", "boolean")
    assert whole.loc[0, "error"] == "a worker died"
    assert whole.loc[0, ["error_mm", "arrived", "word"]].isna().all()


def test_rows_are_read_a_part_at_a_time(tmp_path: Path) -> None:
    """Each part has the columns and types of the whole table, also those that only later parts have values of."""
    write(tmp_path, ROWS[:2], ROWS[2:])
    with CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN) as store:
        first, second = store.iter_parts()
        assert (store.done, len(first), len(second)) == (4, 2, 2)
        assert first.dtypes.equals(store.read().dtypes)
        assert first["word"].isna().all()


def test_a_campaign_that_was_begun_goes_on_behind_its_rows(tmp_path: Path) -> None:
    """An empty folder is begun; later the leading tasks are done, and rows of others are refused."""
    with CampaignStore.open(str(tmp_path / "new"), CAMPAIGN, PLAN) as store:
        assert (store.done, len(store.read())) == (0, 0)
        store.append(ROWS[:2])
    with CampaignStore.open(str(tmp_path / "new"), CAMPAIGN, PLAN) as store:
        assert store.done == 2
        with pytest.raises(ValueError, match="expected those from 2 on"):
            store.append([row(3)])
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        CAMPAIGN_FILE,
        "part-000000.parquet",
    ]


def test_another_campaign_is_refused_with_the_difference(tmp_path: Path) -> None:
    """A folder keeps one campaign; what differs is named with both values, and nothing is written."""
    write(tmp_path, ROWS)
    other = {**CAMPAIGN, "grid": {"replan_mm": [10, 30]}}
    with pytest.raises(
        InputError, match=r"grid\.replan_mm is \[10, 20\] there and \[10, 30\] here"
    ) as refused:
        CampaignStore.open(str(tmp_path), other, PLAN)
    assert "--out" in refused.value.hint
    assert len(write(tmp_path)) == 4


RULE = {"ci95_width_mm": 0.5, "at_most": 200}


def test_a_plan_may_grow_but_not_below_what_is_done(tmp_path: Path) -> None:
    """The file of the campaign has the plan that was given last; fewer tasks than are done are refused."""
    write(tmp_path, ROWS)
    more = replace(PLAN, tasks=2000, measure="turns")
    CampaignStore.open(str(tmp_path), CAMPAIGN, more).close()
    assert json.loads((tmp_path / CAMPAIGN_FILE).read_text())["plan"] == asdict(more)
    with pytest.raises(InputError, match="holds 4 tasks, and the file asks for 3"):
        CampaignStore.open(str(tmp_path), CAMPAIGN, replace(PLAN, tasks=3))
    assert len(write(tmp_path)) == 4


def test_a_rule_is_fixed_before_the_first_task(tmp_path: Path) -> None:
    """Until then it may change; later another one, or none, is refused with the difference, and the rows stay."""
    ruled = replace(PLAN, rule=RULE)
    CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN).close()
    with CampaignStore.open(str(tmp_path), CAMPAIGN, ruled) as store:
        store.append(ROWS)
    for rule, difference in (
        ({**RULE, "ci95_width_mm": 0.6}, r"rule\.ci95_width_mm is 0\.5 there and 0\.6 here"),
        (None, "and null here"),
    ):
        with pytest.raises(InputError, match=difference) as refused:
            CampaignStore.open(str(tmp_path), CAMPAIGN, replace(PLAN, rule=rule))
        assert "fixed before the first task" in refused.value.hint
    with CampaignStore.open(str(tmp_path), CAMPAIGN, ruled) as store:
        assert store.done == 4


def test_a_table_is_not_written_where_it_would_be_forgotten() -> None:
    """The memory of a process ends with it."""
    with pytest.raises(InputError, match="would be lost"):
        CampaignStore.open("memory://shelf/campaign", CAMPAIGN, PLAN)


def test_rows_of_another_labrig_are_not_continued(tmp_path: Path) -> None:
    """A campaign that another version began is refused: its rows would have other bits."""
    write(tmp_path, ROWS)
    document = json.loads((tmp_path / CAMPAIGN_FILE).read_text())
    document["installation"]["labrig"] = "0.0.9"
    (tmp_path / CAMPAIGN_FILE).write_text(json.dumps(document))
    with pytest.raises(InputError, match=r'labrig is "0\.0\.9" there') as refused:
        CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN)
    assert "--out" in refused.value.hint


def test_a_campaign_that_goes_on_with_other_kernels_says_so(tmp_path: Path) -> None:
    """It goes on, and tells which kernels its first rows were made with."""
    write(tmp_path, ROWS[:2])
    document = json.loads((tmp_path / CAMPAIGN_FILE).read_text())
    document["processor"]["blas_numpy"] = "OpenBLAS Atom"
    (tmp_path / CAMPAIGN_FILE).write_text(json.dumps(document))
    with CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN) as store:
        assert store.change.startswith("made with OpenBLAS Atom, and this is OpenBLAS ")
        assert store.done == 2


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    """A folder with other files is no place for a campaign."""
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputExistsError, match=r"holds notes\.txt and no campaign"):
        CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN)


def test_a_torn_last_part_is_done_again(tmp_path: Path) -> None:
    """Of a last part whose writing was cut short no row counts; the same tasks replace it."""
    write(tmp_path, ROWS[:2], ROWS[2:])
    torn = tmp_path / "part-000001.parquet"
    torn.write_bytes(torn.read_bytes()[:-20])
    with CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN) as store:
        assert (store.done, store.torn) == (2, torn.name)
        store.append(ROWS[2:])
        assert (store.done, store.torn) == (4, None)
    assert len(write(tmp_path)) == 4


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda folder: (folder / "part-000001.parquet").write_bytes(b"PAR1"),
            r"part-000001\.parquet is damaged",
        ),
        (lambda folder: (folder / "part-000001.parquet").unlink(), r"part-000001\.parquet is missing"),
        (
            lambda folder: (folder / "part-000002.parquet").replace(folder / "part-000001.parquet"),
            r"part-000001\.parquet is not the part of this campaign that begins at task 1",
        ),
        (lambda folder: (folder / CAMPAIGN_FILE).write_text("{"), r"campaign\.json is damaged"),
    ],
)
def test_a_part_that_is_damaged_missing_or_elsewhere_is_named(
    tmp_path: Path, spoil: Any, message: str
) -> None:
    """Any part but the last must be there, whole and in its place; nothing is repaired silently."""
    write(tmp_path, ROWS[:1], ROWS[1:2], ROWS[2:])
    spoil(tmp_path)
    with pytest.raises(RecordError, match=message):
        CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN)


def test_a_bit_that_flipped_in_a_part_is_found(tmp_path: Path) -> None:
    """The pages of a part have checksums, which are compared when it is read."""
    write(tmp_path, [row(task, error_mm=task / 7) for task in range(200)])
    part = tmp_path / "part-000000.parquet"
    content = bytearray(part.read_bytes())
    content[200] ^= 1
    part.write_bytes(content)
    with (
        CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN) as store,
        pytest.raises(RecordError, match="is damaged"),
    ):
        store.read()


def test_a_second_process_is_refused(tmp_path: Path) -> None:
    """Only one labrig writes a campaign in a folder at a time."""
    with (
        CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN),
        pytest.raises(LockedError, match="in use by labrig campaign"),
    ):
        CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN)
    CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN).close()


def test_a_full_disk_costs_the_rows_at_hand_alone(tmp_path: Path) -> None:
    """A part that does not fit is not there; the rows before it are, and later the campaign goes on."""
    with CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN) as store:
        store.append(ROWS[:2])
        with full_disk(100), pytest.raises(DiskError) as refused:
            store.append(ROWS[2:])
        assert "2 tasks are done, and the same command goes on behind them" in refused.value.hint
    assert len(write(tmp_path, ROWS[2:])) == 4


def test_a_column_has_values_of_one_kind(tmp_path: Path) -> None:
    """A text among numbers is refused, in the same part or a later one, and nothing of it is written."""
    with CampaignStore.open(str(tmp_path), CAMPAIGN, PLAN) as store:
        store.append([row(0, turns=1)])
        with pytest.raises(InputError, match="turns"):
            store.append([row(1, turns="many")])
        with pytest.raises(InputError, match="turns"):
            store.append([row(1, turns=2), row(2, turns="many")])
        assert store.done == 1
        store.append([row(1, turns=2)])


@pytest.fixture(scope="module")
def server() -> Iterator[ThreadedMotoServer]:
    """An object store on the loopback."""
    moto = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    moto.start()
    yield moto
    moto.stop()


@pytest.fixture
def bucket(server: ThreadedMotoServer, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The URL of a new bucket, with what a lab's environment says of its store."""
    host, port = server.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "lab")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "lab")
    files = fsspec.filesystem("s3")
    files.mkdir("lab")
    yield "s3://lab/campaigns/replanning"
    files.rm("lab", recursive=True)


def test_a_campaign_lies_in_an_object_store(bucket: str, tmp_path: Path) -> None:
    """At a URL a campaign is begun and continued as in a folder, and its table is the same."""
    assert_frame_equal(write(bucket, ROWS[:2], ROWS[2:]), write(tmp_path, ROWS))
    with pytest.raises(InputError, match="holds another campaign"):
        CampaignStore.open(bucket, {}, PLAN)


def test_a_second_writer_in_an_object_store_overwrites_nothing(bucket: str) -> None:
    """Where nothing can be locked, the writer that is late is refused, and the part of the other stays."""
    with (
        CampaignStore.open(bucket, CAMPAIGN, PLAN) as store,
        CampaignStore.open(bucket, CAMPAIGN, PLAN) as other,
    ):
        other.append(ROWS[:3])
        with pytest.raises(LockedError, match=r"part-000000\.parquet is there already"):
            store.append(ROWS[:1])
    assert len(write(bucket)) == 3


def test_a_store_that_goes_away_keeps_what_is_done(
    bucket: str, server: ThreadedMotoServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bucket that is gone is an error with the way on; once it is back, the campaign goes on where it was."""
    files = fsspec.filesystem("s3")
    with CampaignStore.open(bucket, CAMPAIGN, PLAN) as store:
        store.append(ROWS[:2])
        kept = {name: files.cat_file(name) for name in files.find("lab")}
        files.rm("lab", recursive=True)
        with pytest.raises(DiskError) as refused:
            store.append(ROWS[2:])
        assert "2 tasks are done" in refused.value.hint
    files.mkdir("lab")
    for name, content in kept.items():
        files.pipe_file(name, content)
    assert len(write(bucket, ROWS[2:])) == 4
