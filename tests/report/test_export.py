"""A run as tables that other programs read."""

import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from labrig.record.notes import annotate_run
from labrig.record.reader import Run, open_run
from labrig.report.tables import WRITERS, Tables, run_tables, write_tables
from tests.analysis.synthetic import NOW
from tests.record.runs import closed_run

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "tests" / "records"


@pytest.fixture(scope="module")
def run() -> Run:
    """The record that is kept under data/."""
    return open_run(KEPT / "steerability")


@pytest.fixture(scope="module")
def tables(run: Run) -> Tables:
    """Its tables."""
    return run_tables(run, run.result)


def test_every_table_has_units_in_its_names(run: Run, tables: Tables) -> None:
    """A point has a column a coordinate; a position of the rotation is in rad, of the others in mm."""
    assert {"run", "notes", "states", "events", "trials", "frames", "truth", "result"} <= set(tables)
    for name, columns in {
        "states": {"t_s", "insertion_mm", "rotation_rad", "linear_mm"},
        "measurements": {"tip_y_mm", "tip_z_mm", "tip_u_px", "radius_ci95_low_mm"},
        "specimens": {"ci95_low_mm", "ci95_high_mm", "mean_radius_mm"},
    }.items():
        assert columns <= set(tables[name].columns)
    moves = run.events[run.events["kind"] == "move"]
    assert not {"position", "speed", "asked_position", "asked_speed"} & set(moves.columns)
    turned = moves["axis"] == "rotation"
    assert moves["position_rad"].notna().tolist() == turned.tolist()
    assert moves["asked_speed_mm_s"].notna().tolist() == (~turned).tolist()


def test_csv_and_parquet_read_back_the_same(run: Run, tables: Tables, tmp_path: Path) -> None:
    """pandas reads the numbers that were written, to the last digit; whole numbers stay whole in Parquet."""
    write_tables(run, ["csv", "parquet"], tmp_path)
    file = tmp_path / "measurements"
    for read in (pd.read_csv(f"{file}.csv"), pd.read_parquet(f"{file}.parquet")):
        np.testing.assert_array_equal(read["radius_mm"], tables["measurements"]["radius_mm"])
        assert list(read.columns) == list(tables["measurements"].columns)
    assert pd.api.types.is_integer_dtype(pd.read_parquet(tmp_path / "frames.parquet")["frame"])
    assert b'"exit_status": "success"' in (tmp_path / "manifest.json").read_bytes()


def test_a_spreadsheet_finds_no_formula(tmp_path: Path) -> None:
    """Text that a spreadsheet would compute is made text; numbers in a text stay numbers."""
    notes = ["=1+1", "-x", "plain", "-1.5; 2e-3", "-1+2"]
    WRITERS["csv"](tmp_path, {"t": pd.DataFrame({"note": notes, "n": [-1.0, 2, 3, 4, 5]})})
    lines = ["note,n", "'=1+1,-1.0", "'-x,2.0", "plain,3.0", "-1.5; 2e-3,4.0", "'-1+2,5.0"]
    assert (tmp_path / "t.csv").read_text().splitlines() == lines


def test_the_example_for_matlab_finds_what_it_reads(run: Run, tmp_path: Path) -> None:
    """Each column that data/read_run.m names is in the run.mat of a sweep and an insertion."""
    script = (ROOT / "data" / "read_run.m").read_text(encoding="utf-8")
    aliases = {"states": "states", "measured": "measurements", "steps": "insertion_steps"}
    found: dict[str, set[str]] = {}
    for record in (run, open_run(KEPT / "insertion")):
        WRITERS["matlab"](tmp_path, run_tables(record, record.result))
        tables = scipy.io.loadmat(tmp_path / "run.mat", simplify_cells=True)
        found |= {name: {*columns} for name, columns in tables.items() if isinstance(columns, dict)}
    read = re.findall(r"(?:tables\.)?\b(\w+)\.([a-z]\w+)", re.sub(r"(?m)%.*$|'[^']*'", "", script))
    named = {(aliases.get(table, table), column) for table, column in read} - {
        ("tables", table) for table in found
    }
    assert len(named) > 12
    assert [(table, column) for table, column in named if column not in found.get(table, ())] == []


def test_the_lists_of_an_insertion_are_tables_of_their_own() -> None:
    """Tip and estimate at each picture, and obstacles, each with its trial; plans and turns are events."""
    insertion = open_run(KEPT / "insertion")
    tables = run_tables(insertion, insertion.result)
    steps = tables["insertion_steps"]
    assert {"trial", "frame", "tip_y_mm", "estimate_z_mm", "true_y_mm", "nis"} <= set(steps.columns)
    assert len(steps) == (tables["events"]["kind"] == "observation").sum() > 5
    assert {"plan", "flip"} <= set(tables["events"]["kind"])
    assert tables["insertion_obstacles"]["position_z_mm"].tolist() == [12.0]
    assert {"path_x_mm", "path_y_mm", "path_z_mm"} <= set(tables["truth_path"].columns)
    for name in set(tables) - {"events"}:
        texts: pd.DataFrame = tables[name].select_dtypes("string")
        assert not any(texts[column].str.startswith(("[{", "[[")).any() for column in texts), name


def test_what_people_say_is_exported(tmp_path: Path) -> None:
    """Tags and verdict stand in the table of the run, notes in one of their own."""
    path = Path(shutil.copytree(KEPT / "steerability", tmp_path / "run"))
    annotate_run(path, tags=["pilot", "cloudy"], verdict="doubtful", by="Chen", at=NOW)
    annotate_run(path, note="=gel 3", by="Yang", at=NOW)
    tables = run_tables(open_run(path), None)
    assert tables["run"].iloc[0][["tags", "verdict"]].tolist() == ["pilot, cloudy", "doubtful"]
    assert tables["notes"][["text", "by"]].values.tolist() == [["=gel 3", "Yang"]]
    WRITERS["csv"](tmp_path, tables)
    assert b"'=gel 3,Yang" in (tmp_path / "notes.csv").read_bytes()


@pytest.mark.parametrize("kept", [None, *sorted(KEPT.iterdir())], ids=lambda kept: kept and kept.name)
def test_equal_runs_give_equal_files(kept: Path | None, tmp_path: Path) -> None:
    """No export holds the time of day or where it was made; columns.csv has a sentence for each column, no other."""
    source = open_run(kept or closed_run(tmp_path))  # also a run without pictures and results
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_tables(source, WRITERS, tmp_path / name)
    first, second = ({file.name: file.read_bytes() for file in (tmp_path / name).iterdir()} for name in "ab")
    assert first == second
    assert {"run.csv", "states.parquet", "run.mat", "manifest.json"} <= set(first)
    told = {*pd.read_csv(tmp_path / "a/columns.csv").dropna(subset="meaning")["column"]}
    assert told == {name for table in run_tables(source, source.result).values() for name in table}


def test_long_names_of_columns_stay_apart_in_a_matlab_file(tmp_path: Path) -> None:
    """A field of MATLAB has at most 63 characters; two columns that begin alike keep a field each."""
    long = "sigma_" * 12
    WRITERS["matlab"](tmp_path, {"long": pd.DataFrame({f"{long}a": [1.0], f"{long}b": [2.0], "1 %": [3.0]})})
    read = scipy.io.loadmat(tmp_path / "run.mat", simplify_cells=True)["long"]
    assert sorted(read.values()) == [1.0, 2.0, 3.0]
