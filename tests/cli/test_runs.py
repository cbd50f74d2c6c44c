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


def test_runs_are_filtered(labrig: Labrig, shelf: Path) -> None:
    """The condition of the manual finds the runs; verdicts, notes and tags are columns where there are any."""
    labrig("runs", "annotate", shelf / "two", "--tag", "pilot")
    done = labrig("runs", "--runs-dir", shelf, "--where", "gelatin_percent=19 and tag=pilot", "--json")
    (row,) = done.json()
    assert (Path(row["run"]).name, row["tags"]) == ("two", ["pilot"])
    heads, *rows = labrig("runs", "--runs-dir", shelf).out.splitlines()
    assert heads.split()[-1] == "tags"
    assert [line.split()[-1] for line in sorted(rows)] == ["-", "pilot"]


def test_nothing_that_fits_is_no_error(labrig: Labrig, shelf: Path) -> None:
    """A condition that matches no run gives an empty list."""
    done = labrig("runs", "--runs-dir", shelf, "--where", "gelatin_percent=11")
    assert (done.exit_code, done.out, done.err) == (0, "", "no run matches\n")


def test_the_list_says_what_to_do_about_interrupted_runs(labrig: Labrig, tmp_path: Path) -> None:
    """Withdraw a needle that may be in tissue first, then continue; or who writes it. One that is judged is done."""
    for name, experiment, kind in (
        ("a sweep", "steerability", "bench"),
        ("needle", "roll-zero", "bench"),
        ("other", "roll-zero", "simulated"),
    ):
        sources = {"rig": "the bench.yaml" if name != "other" else None}
        made = {"experiment": experiment, "devices": {"kind": kind}, "sources": sources}
        planned = 3 if name == "a sweep" else 0
        recorder = begin(tmp_path / "writing", name, trials_planned=planned, **made)  # type: ignore[arg-type]
        recorder.event("trial_start", 0.0, trial=0)
        shutil.copytree(tmp_path / "writing" / name, tmp_path / "runs" / name)
    said = labrig("runs", "--runs-dir", tmp_path / "runs").err
    place = f"{tmp_path}/runs"
    assert (
        "a sweep was interrupted; take out a needle that is still in tissue: "
        f"labrig devices withdraw --rig 'the bench.yaml' --run '{place}/a sweep'\n"
        f"  then continue it: labrig resume '{place}/a sweep'" in said
    )
    assert f"labrig devices withdraw --rig 'the bench.yaml' --run {place}/needle\n" in said
    assert f"labrig runs annotate {place}/other --verdict bad" in said
    labrig("runs", "annotate", f"{place}/needle", "--verdict", "bad")
    with FileLock(tmp_path / "runs" / "other" / ".lock").acquire("labrig run"):
        said = labrig("runs", "--runs-dir", tmp_path / "runs").err
    assert "other is going on: labrig run (process" in said
    assert "needle was interrupted" not in said


def test_what_people_say_is_kept_in_the_run(labrig: Labrig, shelf: Path) -> None:
    """Tags, notes and a verdict are added to runs, and read back with their author."""
    runs = (shelf / "one", shelf / "two")
    said = ("--tag", "pilot", "--note", "gel was cloudy", "--verdict", "doubtful", "--by", "Chen")
    assert labrig("runs", "annotate", *runs, *said).exit_code == 0
    assert labrig("runs", "annotate", runs[0], "--untag", "pilot", "--note", "gel 3").exit_code == 0
    rows = labrig("runs", "annotate", *runs, "--json").json()
    assert [(row["tags"], row["verdict"], len(row["notes"])) for row in rows] == [
        ([], "doubtful", 2),
        (["pilot"], "doubtful", 1),
    ]
    assert rows[1]["notes"][0]["by"] == "Chen"
    assert labrig("runs", "annotate", runs[0], "--untag", "other").exit_code == 2
    assert labrig("runs", "annotate", shelf, "--note", "text").exit_code == 4


def test_a_run_is_shown_with_its_events(labrig: Labrig, shelf: Path) -> None:
    """What it is, how it ended, what people say of it, and a sentence for each event with its rig time."""
    labrig("runs", "annotate", shelf / "one", "--note", "gel was cloudy", "--by", "Chen")
    document = labrig("runs", "show", shelf / "one", "--json").json()
    assert (document["exit_status"], document["experiment"]) == ("success", "steerability")
    assert document["notes"][0]["text"] == "gel was cloudy"
    assert document["result"]["mean_radius_mm"] > 20
    told = labrig("runs", "show", shelf / "one").out
    assert "Chen: gel was cloudy" in told
    assert len(document["events"]) > len(told.splitlines()) > 10
    assert "trial 1" in told
