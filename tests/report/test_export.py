"""A run as tables that other programs read."""

import io
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from labrig.analysis import load_result
from labrig.record import Run, open_run, with_numbers_apart
from labrig.report.export import FORMATS, run_tables
from tests.record.runs import closed_run

DATA = Path(__file__).parents[2] / "data"


@pytest.fixture(scope="module")
def run() -> Run:
    """The record that is kept under data/."""
    return open_run(DATA / "first-record")


@pytest.fixture(scope="module")
def tables(run: Run) -> dict[str, pd.DataFrame]:
    """Its tables."""
    return run_tables(run, load_result(run))


def test_every_table_has_units_in_its_names(tables: dict[str, pd.DataFrame]) -> None:
    """States, truth and measurements say in what they are; a point has a column a coordinate."""
    assert {"states", "events", "trials", "frames", "truth", "measurements", "specimens"} == set(tables)
    assert {"t_s", "insertion_mm", "rotation_rad", "linear_mm"} <= set(tables["states"].columns)
    assert {"tip_y_mm", "tip_z_mm", "tip_u_px", "radius_ci95_low_mm"} <= set(tables["measurements"].columns)
    assert {"ci95_low_mm", "ci95_high_mm", "mean_radius_mm"} <= set(tables["specimens"].columns)


def test_positions_of_events_have_the_unit_of_their_axis(run: Run) -> None:
    """A position of the rotation is in rad, of the others in mm."""
    moves = run.events[run.events["kind"] == "move"]
    assert not {"position", "speed", "asked_position", "asked_speed"} & set(moves.columns)
    turned = moves["axis"] == "rotation"
    assert moves["position_rad"].notna().tolist() == turned.tolist()
    assert moves["asked_speed_mm_s"].notna().tolist() == (~turned).tolist()


def test_csv_reads_back_the_same(run: Run, tables: dict[str, pd.DataFrame]) -> None:
    """pandas reads from each CSV the numbers that were written, to the last digit."""
    files = FORMATS["csv"](run, tables)
    read = pd.read_csv(io.BytesIO(files["measurements.csv"]))
    np.testing.assert_array_equal(read["radius_mm"], tables["measurements"]["radius_mm"])
    assert list(read.columns) == list(tables["measurements"].columns)
    assert b'"exit_status": "success"' in files["manifest.json"]


def test_a_spreadsheet_finds_no_formula(run: Run) -> None:
    """Text that a spreadsheet would compute is made text."""
    files = FORMATS["csv"](run, {"t": pd.DataFrame({"note": ["=1+1", "-x", "plain"], "n": [-1.0, 2, 3]})})
    assert files["t.csv"].decode().splitlines() == ["note,n", "'=1+1,-1.0", "'-x,2.0", "plain,3.0"]


def test_parquet_keeps_numbers_and_kinds(run: Run, tables: dict[str, pd.DataFrame]) -> None:
    """A Parquet file gives the same numbers, and whole numbers stay whole."""
    files = FORMATS["parquet"](run, tables)
    read = pd.read_parquet(io.BytesIO(files["measurements.parquet"]))
    np.testing.assert_array_equal(read["radius_mm"], tables["measurements"]["radius_mm"])
    assert pd.api.types.is_integer_dtype(pd.read_parquet(io.BytesIO(files["frames.parquet"]))["frame"])


def test_matlab_finds_what_the_example_asks_for(run: Run, tables: dict[str, pd.DataFrame]) -> None:
    """Every struct and field that data/read_run.m names is in run.mat, each column as long as its table."""
    (content,) = FORMATS["mat"](run, tables).values()
    mat = scipy.io.loadmat(io.BytesIO(content), struct_as_record=False)
    script = (DATA / "read_run.m").read_text(encoding="utf-8")
    tables_of = {"states": "states", "measured": "measurements", "final": "measurements"}
    asked = re.findall(r"\b(states|measured|final)\.(\w+)", script)
    assert len(asked) > 10
    for variable, field in asked:
        column = getattr(mat[tables_of[variable]][0, 0], field)
        assert column.shape == (len(tables[tables_of[variable]]), 1)
    for name in re.findall(r"tables\.(\w+)", script):
        assert name in mat
    assert {"run", "experiment", "exit_status"} <= set(re.findall(r"tables\.run\.(\w+)", script))
    radii = mat["measurements"][0, 0].radius_mm[:, 0]
    np.testing.assert_array_equal(radii, tables["measurements"]["radius_mm"].to_numpy(float, na_value=np.nan))
    assert mat["run"][0, 0].exit_status[0] == "success"


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
def test_equal_runs_give_equal_files(kind: str, run: Run, tables: dict[str, pd.DataFrame]) -> None:
    """No export holds the time of day or where it was made."""
    assert FORMATS[kind](run, tables) == FORMATS[kind](run, tables)


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
def test_a_run_without_pictures_and_results_is_exported(kind: str, tmp_path: Path) -> None:
    """Tables without rows are written like any other."""
    run = open_run(closed_run(tmp_path))
    tables = {name: table.iloc[:0] for name, table in run_tables(run, None).items()}
    assert FORMATS[kind](run, tables)


def test_only_vectors_of_a_known_kind_are_taken_apart() -> None:
    """A list of another length, of words, or of several lengths stays as it is."""
    table = pd.DataFrame({
        "tip_mm": [[1.0, 2.0], None], "centre_mm": [[1.0, 2.0, 3.0]] * 2, "names": [["a", "b"]] * 2,
        "path_mm": [[1.0, 2.0], [1.0, 2.0, 3.0]], "n": [1, 2],
    })  # fmt: skip
    apart = with_numbers_apart(table)
    assert list(apart.columns) == [
        "tip_y_mm", "tip_z_mm", "centre_x_mm", "centre_y_mm", "centre_z_mm", "names", "path_mm", "n"
    ]  # fmt: skip
    assert apart["tip_z_mm"].tolist()[0] == 2.0
    assert apart["tip_z_mm"].isna().tolist() == [False, True]
