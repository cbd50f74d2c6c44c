"""Listing runs."""

import json
from datetime import timedelta
from pathlib import Path

import pytest

from labrig.errors import InputError
from labrig.record import RunSummary, encode_document, list_runs
from tests.record.runs import STARTED, closed_run, interrupted_run


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
