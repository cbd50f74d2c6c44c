"""`labrig compare`: what it prints, writes and refuses."""

import csv
import io
import json
from pathlib import Path

import pytest

from labrig.record.notes import annotate_run
from tests.analysis.measured_runs import write_measured_run
from tests.cli.conftest import Labrig
from tests.record.runs import ENDED, flip_bit
from tests.report.conftest import HOSTILE

SOFT, HARD = ("gel A", 10.0), ("gel B", 19.0)


@pytest.fixture
def runs_dir(tmp_path: Path) -> Path:
    """Return a folder with two runs of two needles in two gels."""
    folder = tmp_path / "runs"
    write_measured_run(folder, "a", {SOFT: (28.0, 28.4, 28.3), HARD: (27.0, 27.2, 27.5)})
    write_measured_run(folder, "b", {SOFT: (28.1, 28.3, 28.6), HARD: (26.8, 27.2, None)}, needle_id="N2")
    return folder


def test_a_comparison_prints_its_document_and_writes_page_and_tables(
    labrig: Labrig, runs_dir: Path, tmp_path: Path
) -> None:
    """The keys that others rely on; one tidy row for each measurement; an existing folder is not overwritten."""
    command = ("compare", "a", "b", "--runs-dir", runs_dir, "--out", tmp_path / "out", "--json")
    done = labrig(*command)
    document = done.json()
    assert (done.exit_code, document["quantity"], len(document["groups"]), len(document["pairs"])) == (
        0,
        "radius_mm",
        4,
        6,
    )
    assert document["groups"][0].keys() >= {"name", "n", "runs", "mean", "sd", "ci95"}
    assert document["welch_anova"].keys() >= {"f", "df_between", "df_within", "p"}
    assert document["pairs"][0].keys() >= {"a", "b", "difference", "ci95", "p"}
    assert document["report"] == str(tmp_path / "out" / "report.html")
    table = (tmp_path / "out" / "measurements.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(io.StringIO(table)))
    written = json.loads((tmp_path / "out" / "measurements.json").read_text(encoding="utf-8"))["measurements"]
    assert (len(rows), len(written), rows[0]["group"]) == (12, 12, "N1, 10 % gelatin")
    assert [float(row["value"]) for row in rows[:3]] == [28.0, 28.4, 28.3]
    assert labrig(*command).json()["error"]["type"] == "OutputExistsError"


def test_the_page_shows_what_people_wrote_as_text(labrig: Labrig, tmp_path: Path) -> None:
    """Markup in the name of a needle, of a specimen or of a verdict is shown, and a formula in a cell is none."""
    radii = {(HOSTILE, 10.0): (28.0, 28.4), ("=1+1", 19.0): (27.0, 27.2)}
    run = write_measured_run(tmp_path, "a", radii, needle_id=HOSTILE)
    annotate_run(run, verdict="doubtful", note=HOSTILE, by="somebody", at=ENDED)
    done = labrig("compare", run, "--by", "specimen", "--by", "needle", "--out", tmp_path / "out")
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert done.exit_code == 0
    assert "<script" not in html
    assert "&lt;script&gt;" in html
    assert "a was judged doubtful" in html
    assert "\n=1+1" not in (tmp_path / "out" / "measurements.csv").read_text(encoding="utf-8")
    assert "=1+1, &lt;script" in html


def test_a_damaged_run_is_left_out_and_told(labrig: Labrig, runs_dir: Path, tmp_path: Path) -> None:
    """The others are compared all the same; the exit code says that something is wrong."""
    flip_bit(runs_dir / "b" / "analysis" / "001" / "measurements.csv")
    done = labrig("compare", "--where", "seed=7", "--runs-dir", runs_dir, "--out", tmp_path / "out", "--json")
    document = done.json()
    assert done.exit_code == 4
    assert [run["run"] for run in document["used"]] == ["a"]
    assert document["left_out"][0]["run"].endswith("b")
    assert "left out" in done.err


def test_a_run_without_result_is_left_out_and_told(labrig: Labrig, runs_dir: Path, tmp_path: Path) -> None:
    """Named, it is wrong input; among those that fit a condition it is told alone."""
    write_measured_run(runs_dir, "c", {SOFT: (28.0,)}, result=False)
    found = labrig("compare", "--where", "seed=7", "--runs-dir", runs_dir, "--out", tmp_path / "x", "--json")
    named = labrig("compare", "a", "c", "--runs-dir", runs_dir, "--out", tmp_path / "y", "--json")
    assert (found.exit_code, named.exit_code) == (0, 2)
    assert ["has no result" in run["reason"] for run in found.json()["left_out"]] == [True]
