"""`labrig runs`: finding, annotating and comparing."""

import shutil
from pathlib import Path

import pytest

from labrig.record.lock import FileLock
from tests.cli.conftest import Labrig, SweepRun
from tests.record.runs import begin


@pytest.fixture
def shelf(sweep: SweepRun, tmp_path: Path) -> Path:
    """A folder with two copies of a sweep."""
    for name in ("one", "two"):
        shutil.copytree(sweep.run, tmp_path / name)
    return tmp_path


def test_runs_are_filtered_and_sorted(labrig: Labrig, shelf: Path) -> None:
    """The condition of the manual finds the runs, and lists the fields that it uses."""
    labrig("runs", "tag", shelf / "two", "-t", "pilot")
    done = labrig("runs", "--runs-dir", shelf, "--where", "gelatin_percent=19 and tag=pilot", "--json")
    (row,) = done.json()
    assert (Path(row["run"]).name, row["tags"]) == ("two", ["pilot"])
    assert row["fields"]["gelatin_percent"] == [10.0, 19.0]
    listed = labrig("runs", "--runs-dir", shelf, "--sort", "mean_radius_mm").out
    assert "mean_radius_mm" in listed
    assert "pilot" in listed


def test_results_are_columns_of_the_list(labrig: Labrig, shelf: Path) -> None:
    """A field that is asked for is a column, in the order of asking; an unknown one exits with 2."""
    done = labrig("runs", "--runs-dir", shelf, "--show", "mean_radius_mm", "--show", "seed")
    heads = done.out.splitlines()[0].split()
    assert heads.index("seed") == heads.index("mean_radius_mm") + 1
    refused = labrig("runs", "--runs-dir", shelf, "--show", "mean_radius")
    assert (refused.exit_code, "--show: no run has a field" in refused.err) == (2, True)


@pytest.mark.parametrize("condition", ["gelatin_percent", "gelatine_percent=13", "exit_status=success and"])
def test_a_condition_that_makes_no_sense_exits_with_2(condition: str, labrig: Labrig, shelf: Path) -> None:
    """An invalid condition exits with 2 and names the character."""
    done = labrig("runs", "--runs-dir", shelf, "--where", condition, "--json")
    assert done.exit_code == 2
    assert "character" in done.json()["error"]["message"]


def test_nothing_that_fits_is_no_error(labrig: Labrig, shelf: Path) -> None:
    """A condition that matches no run gives an empty list."""
    done = labrig("runs", "--runs-dir", shelf, "--where", "gelatin_percent=11")
    assert (done.exit_code, done.out, done.err) == (0, "", "no run matches\n")


def test_the_list_says_what_to_do_about_interrupted_runs(labrig: Labrig, tmp_path: Path) -> None:
    """The list names the command that resumes, withdraws or closes a run, or the process that writes it."""
    for name, experiment, kind in (
        ("a sweep", "steerability", "real"),
        ("needle", "roll-zero", "real"),
        ("other", "roll-zero", "simulated"),
    ):
        sources = {"rig": "the bench.yaml" if name == "needle" else None}
        begin(tmp_path / "writing", name, experiment=experiment, devices={"kind": kind}, sources=sources)
        shutil.copytree(tmp_path / "writing" / name, tmp_path / "runs" / name)
    done = labrig("runs", "--runs-dir", tmp_path / "runs")
    assert f"a sweep was interrupted; continue it: labrig resume '{tmp_path}/runs/a sweep'" in done.err
    assert f"labrig devices withdraw --rig 'the bench.yaml' --run {tmp_path}/runs/needle\n" in done.err
    assert f"other was interrupted; close it: labrig runs check {tmp_path}/runs/other --repair" in done.err
    with FileLock(tmp_path / "runs" / "other" / ".lock").acquire("labrig run"):
        done = labrig("runs", "--runs-dir", tmp_path / "runs", "--where", "run=other")
    assert "other is going on: labrig run (process" in done.err


def test_notes_and_verdict_are_kept_in_the_run(labrig: Labrig, shelf: Path) -> None:
    """A note, its revision and a verdict are appended to the run and read back with their author."""
    run = shelf / "one"
    labrig("runs", "note", run, "gel was cloudy", "--by", "Chen")
    labrig("runs", "note", run, "gel 3 was cloudy", "--revise", "1", "--by", "Yang")
    document = labrig(
        "runs", "verdict", run, "doubtful", "--reason", "cloudy", "--by", "Chen", "--json"
    ).json()
    assert (document["verdict"], document["verdict_reason"]) == ("doubtful", "cloudy")
    printed = labrig("runs", "note", run).out.splitlines()
    assert printed[0].startswith("1.1 ")
    assert printed[0].endswith("Chen: gel was cloudy")
    assert printed[1].endswith("Yang: gel 3 was cloudy")
    assert labrig("runs", "note", run, "text", "--revise", "7").exit_code == 2


def test_two_runs_are_compared(labrig: Labrig, shelf: Path) -> None:
    """A copy of a run has no differences; another analysis of it differs in its results."""
    document = labrig("runs", "diff", shelf / "one", shelf / "two", "--json").json()
    assert (document["identical"], document["differences"]) == (True, [])
    labrig("reanalyze", shelf / "two", "--set", "analysis.window_start_mm=6")
    found = labrig("runs", "diff", shelf / "one", shelf / "two", "--json").json()["differences"]
    assert {row["section"] for row in found} == {"results"}
    assert {"section": "results", "key": "settings.window_start_mm", "a": 4.0, "b": 6.0} in found
    printed = labrig("runs", "diff", shelf / "one", shelf / "two").out
    assert "mean_radius_mm" in printed
    assert max(map(len, printed.splitlines())) <= 100


def test_a_folder_that_is_no_run_exits_with_4(labrig: Labrig, tmp_path: Path) -> None:
    """Nothing is written into a folder that holds no run."""
    assert labrig("runs", "note", tmp_path, "text").exit_code == 4
    assert labrig("runs", "diff", tmp_path, tmp_path).exit_code == 4
    assert list(tmp_path.iterdir()) == []
