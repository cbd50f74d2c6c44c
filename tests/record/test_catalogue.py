"""Listing runs."""

import contextlib
import json
import shutil
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path

import pytest

from labrig.errors import InputError
from labrig.record.annotations import tag_run
from labrig.record.catalogue import RunSummary, list_runs
from labrig.record.json_lines import encode_document
from tests.record.runs import ENDED, STARTED, begin, closed_run, fill, interrupted_run


def test_runs_are_listed_newest_first(tmp_path: Path) -> None:
    """The row of a run says what it was, how it ended and how far it came."""
    for day in (1, 3, 2):
        closed_run(tmp_path, f"run {day}", started=STARTED + timedelta(days=day))
    summaries = list_runs(tmp_path)
    assert [summary.run.name for summary in summaries] == ["run 3", "run 2", "run 1"]
    assert summaries[2] == RunSummary(
        tmp_path / "run 1", "import", "success", "2026-03-03T09:30:00+00:00", 2, 3
    )


def test_trials_of_an_interrupted_run_are_counted(tmp_path: Path) -> None:
    """What an unfinished manifest does not know is read from the events, a torn last line aside."""
    path = interrupted_run(tmp_path)
    with (path / "events.jsonl").open("ab") as events:
        events.write(b'{"kind":"trial_st')
    (summary,) = list_runs(tmp_path)
    assert (summary.exit_status, summary.trials_done) == ("incomplete", 2)


def test_damaged_runs_are_listed_as_damaged(tmp_path: Path) -> None:
    """A broken manifest and broken events each give a row, after the good ones."""
    closed_run(tmp_path, "good")
    (closed_run(tmp_path, "broken manifest") / "manifest.json").write_text("{")
    (interrupted_run(tmp_path, "broken events") / "events.jsonl").write_text("?\n")
    rows = {summary.run.name: summary for summary in list_runs(tmp_path)}
    assert list(rows) == ["good", "broken events", "broken manifest"]
    assert rows["broken manifest"] == RunSummary(
        tmp_path / "broken manifest", None, "damaged", None, None, None
    )
    assert rows["broken events"].exit_status == "damaged"


def test_a_run_of_a_newer_labrig_is_listed_as_such(tmp_path: Path) -> None:
    """A newer schema is no damage; what its other members mean is not guessed."""
    manifest = closed_run(tmp_path) / "manifest.json"
    document = json.loads(manifest.read_text())
    manifest.write_bytes(encode_document(document | {"schema_version": 2}))
    assert list_runs(tmp_path) == [RunSummary(tmp_path / "run", "import", "newer", None, None, None)]


def test_trials_are_stated_with_both_numbers_or_none(tmp_path: Path) -> None:
    """A manifest that does not say how many trials were done gives no `None of 3`."""
    manifest = closed_run(tmp_path) / "manifest.json"
    document = json.loads(manifest.read_text())
    manifest.write_bytes(encode_document(document | {"trials_done": None}))
    (summary,) = list_runs(tmp_path)
    assert (summary.trials_done, summary.trials_planned) == (None, None)


def test_other_folders_and_links_are_left_out(tmp_path: Path) -> None:
    """A folder without a manifest is no run, and a link out of the runs folder is not followed."""
    outside = closed_run(tmp_path / "elsewhere")
    runs = tmp_path / "runs"
    (runs / "notes").mkdir(parents=True)
    (runs / "readme.txt").write_text("")
    (runs / "linked").symlink_to(outside)
    assert list_runs(runs) == []


def test_a_folder_that_does_not_exist_yet_has_no_runs(tmp_path: Path) -> None:
    """Before the first run there are none."""
    assert list_runs(tmp_path / "runs") == []


def test_a_file_is_no_folder_of_runs(tmp_path: Path) -> None:
    """A file where a folder should be is named."""
    (tmp_path / "runs").write_text("")
    with pytest.raises(InputError, match="cannot list"):
        list_runs(tmp_path / "runs")


INDEX = ".catalogue.sqlite3"


def test_the_index_is_made_again_when_it_is_lost_or_spoilt(tmp_path: Path) -> None:
    """Without the index, with a part of it flipped, and with something else in its place the list is the same."""
    closed_run(tmp_path, "one")
    interrupted_run(tmp_path, "two")
    expected = list_runs(tmp_path)
    index = tmp_path / INDEX
    good = index.read_bytes()
    flipped = bytearray(good)
    for position in range(0, len(flipped), 7):
        flipped[position] ^= 0x10
    # With a byte that is no text in its own words, SQLite fails in saying what is wrong.
    no_text = good.replace(b"CREATE TABLE", b"CREAT\xc5 TABLE")
    for spoilt in (b"", b"no database", bytes(flipped), good[: len(good) // 2], no_text):
        index.write_bytes(spoilt)
        assert list_runs(tmp_path) == expected
        assert list_runs(tmp_path) == expected
    index.unlink()
    assert list_runs(tmp_path) == expected


def test_an_index_of_another_labrig_is_made_anew(tmp_path: Path) -> None:
    """A newer or older format of it is thrown away, and not read."""
    closed_run(tmp_path)
    expected = list_runs(tmp_path)
    for version in (0, 99):
        with contextlib.closing(sqlite3.connect(tmp_path / INDEX)) as index, index:
            index.executescript(
                f"DROP TABLE runs; CREATE TABLE runs (name TEXT); PRAGMA user_version = {version}"
            )
        assert list_runs(tmp_path) == expected


def test_a_folder_that_cannot_be_written_is_listed(tmp_path: Path) -> None:
    """With an index that only reads, and with a folder in its place, the list is the same."""
    closed_run(tmp_path, "one")
    list_runs(tmp_path)
    (tmp_path / INDEX).chmod(0o444)
    closed_run(tmp_path, "two")
    assert sorted(run.run.name for run in list_runs(tmp_path)) == ["one", "two"]
    (tmp_path / INDEX).unlink()
    (tmp_path / INDEX).mkdir()
    assert sorted(run.run.name for run in list_runs(tmp_path)) == ["one", "two"]


def test_two_processes_list_at_once(tmp_path: Path) -> None:
    """Eight listings at the same time say the same, and leave an index that is whole."""
    for number in range(20):
        closed_run(tmp_path, f"run-{number}")
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(list_runs, [tmp_path] * 8))
    assert all(summary == found[0] for summary in found)
    with contextlib.closing(sqlite3.connect(tmp_path / INDEX)) as index:
        assert index.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert index.execute("SELECT count(*) FROM runs").fetchone() == (20,)


def test_a_changed_row_of_the_index_is_not_believed(tmp_path: Path) -> None:
    """A value that was changed in the database fails its checksum and is read again from the run."""
    closed_run(tmp_path)
    expected = list_runs(tmp_path)
    with contextlib.closing(sqlite3.connect(tmp_path / INDEX)) as index, index:
        index.execute("UPDATE runs SET line = replace(line, 'success', 'failure')")
    assert list_runs(tmp_path) == expected


def test_the_list_follows_the_folders(tmp_path: Path) -> None:
    """Trials that are added, a run that is closed, tagged, renamed or removed show in the next list."""
    recorder = begin(tmp_path, "run")
    assert [summary.trials_done for summary in list_runs(tmp_path)] == [0]
    fill(recorder, trials=1)
    assert [summary.trials_done for summary in list_runs(tmp_path)] == [1]
    recorder.close("success", "", ENDED)
    assert [summary.exit_status for summary in list_runs(tmp_path)] == ["success"]
    tag_run(tmp_path / "run", ["pilot"], remove=False, by="Chen", at=ENDED)
    assert [summary.tags for summary in list_runs(tmp_path)] == [("pilot",)]
    (tmp_path / "run").rename(tmp_path / "renamed")
    assert [summary.run.name for summary in list_runs(tmp_path)] == ["renamed"]
    shutil.rmtree(tmp_path / "renamed")
    assert list_runs(tmp_path) == []


def test_an_index_that_is_a_link_is_left_alone(tmp_path: Path) -> None:
    """The index is not written through a link out of the folder."""
    runs = tmp_path / "runs"
    closed_run(runs)
    (tmp_path / "outside").write_text("mine")
    (runs / INDEX).symlink_to(tmp_path / "outside")
    assert [summary.exit_status for summary in list_runs(runs)] == ["success"]
    assert (tmp_path / "outside").read_text() == "mine"
