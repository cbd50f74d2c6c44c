"""`labrig export`."""

import shutil
from pathlib import Path

import cv2
import pytest

from tests.cli.conftest import ROOT, Labrig
from tests.record.runs import closed_run

FIRST = ROOT / "tests" / "records" / "steerability"


def test_all_formats_are_written_at_once(labrig: Labrig, tmp_path: Path) -> None:
    """The written files are named, and a second export is refused without --force."""
    formats = ("--format", "csv", "--format", "parquet", "--format", "matlab")
    document = labrig("export", FIRST, *formats, "--out", tmp_path / "out", "--json").json()
    names = set(document["files"])
    assert {"states.csv", "measurements.parquet", "run.mat", "manifest.json"} <= names
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    again = labrig("export", FIRST, "--format", "csv", "--out", tmp_path / "out", "--json")
    assert (again.exit_code, again.json()["error"]["type"]) == (2, "OutputExistsError")
    assert labrig("export", FIRST, "--format", "csv", "--out", tmp_path / "out", "--force").exit_code == 0


@pytest.mark.parametrize("form", ["csv", "record"])
@pytest.mark.parametrize("out", ["", "/", "/tables", "/../run"])
def test_a_run_is_not_exported_into_itself(form: str, out: str, labrig: Labrig, tmp_path: Path) -> None:
    """The run and its folders are refused as the destination, also with --force, and nothing is written."""
    run = tmp_path / "run"
    shutil.copytree(FIRST, run)
    (tmp_path / "same").symlink_to(run)
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*")}
    for place in (run, tmp_path / "same"):
        done = labrig("export", run, "--format", form, "--out", f"{place}{out}", "--force", "--json")
        assert (done.exit_code, done.json()["error"]["type"]) == (2, "InputError")
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*")} == before


def test_an_export_replaces_no_other_run(labrig: Labrig, tmp_path: Path) -> None:
    """Tables never replace a run, nor a record another record, even with --force; a copy of the same run is renewed."""
    assert labrig("export", FIRST, "--format", "record", "--out", tmp_path / "copy").exit_code == 0
    other = closed_run(tmp_path)
    manifest = (other / "manifest.json").read_bytes()
    tables = labrig("export", FIRST, "--format", "csv", "--out", tmp_path / "copy", "--force", "--json")
    assert (tables.exit_code, tables.json()["error"]["type"]) == (2, "OutputExistsError")
    record = labrig("export", FIRST, "--format", "record", "--out", other, "--force", "--json")
    assert (record.exit_code, record.json()["error"]["type"]) == (2, "OutputExistsError")
    assert (other / "manifest.json").read_bytes() == manifest
    again = ("export", FIRST, "--format", "record", "--out", tmp_path / "copy")
    assert labrig(*again).exit_code == 2
    assert labrig(*again, "--force").exit_code == 0
    assert labrig("runs", "check", tmp_path / "copy").exit_code == 0


def test_an_export_has_a_folder_of_its_own(
    labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without --out it is data/exports/RUN."""
    monkeypatch.chdir(tmp_path)
    done = labrig("export", FIRST, "--format", "csv", "--json")
    assert (done.exit_code, done.json()["out"]) == (0, f"data/exports/{FIRST.name}")
    assert (tmp_path / "data" / "exports" / FIRST.name / "states.csv").is_file()


def test_tables_in_the_folder_of_runs_are_no_run(labrig: Labrig, tmp_path: Path) -> None:
    """In a folder with a run, its copy and its tables, only the first two are listed."""
    runs = tmp_path / "runs"
    shutil.copytree(FIRST, runs / "first")
    assert (
        labrig(
            "export", runs / "first", "--format", "csv", "--format", "parquet", "--out", runs / "tables"
        ).exit_code
        == 0
    )
    assert labrig("export", runs / "first", "--format", "record", "--out", runs / "copy").exit_code == 0
    shutil.copytree(runs / "copy", runs / ".copy-unfinished")
    for condition in ((), ("--where", "exit_status=success")):
        listed = labrig("runs", "--runs-dir", runs, *condition, "--json").json()
        assert sorted(Path(row["run"]).name for row in listed) == ["copy", "first"]


def test_an_insertion_is_exported_as_a_film(labrig: Labrig, tmp_path: Path) -> None:
    """It has every picture of a step, in colour; a sweep has no film."""
    records = ROOT / "tests" / "records"
    out = labrig("export", records / "insertion", "--format", "film", "--out", tmp_path, "--force", "--json")
    assert out.json()["files"] == ["insertion-1.mp4"]
    film = cv2.VideoCapture(str(tmp_path / "insertion-1.mp4"))
    read, first = film.read()
    assert read
    assert abs(first[..., 2].astype(int) - first[..., 0]).max() > 100
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) > 20
    refused = labrig("export", records / "steerability", "--format", "film", "--out", tmp_path / "none")
    assert refused.exit_code == 2
    assert "film" in refused.err
