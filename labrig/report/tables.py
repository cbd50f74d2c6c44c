"""A run as tables for other programs: CSV, Parquet and MATLAB; pictures are not copied.

A unit stands in the name of each column, one value in each cell, and a list in a table of its own. Every format holds
the same tables.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io

from labrig.durable import disk_errors, write_atomically
from labrig.record.json_lines import encode_document
from labrig.record.reader import Run
from labrig.record.tables import encode_csv, split_vectors

Tables = dict[str, pd.DataFrame]
_Row = tuple[Mapping[str, Any], Mapping[str, Any], int]
"""A row, what identifies the whole that it is part of, and its number within that."""

_ABOUT = ("run", "experiment", "title", "exit_status", "reason", "started", "ended", "seed", "operator")
_NOTE = ("text", "by", "at")
# The provenance of a result and the variations of a plane map stay in result.json.
_LEFT_OUT = frozenset({"schema_version", "inputs", "provenance", "variations"})
_COLUMNS = Path(__file__).with_name("columns.csv")
_MAT_LONGEST_NAME = 63
_MAT_HEADER = b"MATLAB 5.0 MAT-file, written by labrig".ljust(116)


def write_tables(run: Run, formats: Iterable[str], folder: Path) -> None:
    """Write a run and its newest result into a folder, in each of the formats `csv`, `parquet` and `matlab`.

    `columns.csv` says what each column of labrig's own experiments means, with its unit.

    Raises
    ------
    RecordError
        When record or result are damaged.
    DiskError
        When a file cannot be written.
    """
    tables = run_tables(run, run.result)
    write_atomically(folder / "manifest.json", encode_document(run.manifest))
    with disk_errors(folder):
        for form in formats:
            WRITERS[form](folder, tables)
        known, names = pd.read_csv(_COLUMNS), {name for table in tables.values() for name in table}
        write_csv(folder, {"columns": known[known["column"].isin(names)]})


def run_tables(run: Run, result: Mapping[str, Any] | None) -> Tables:
    """Return everything in a run as tables.

    Parameters
    ----------
    result : Mapping or None
        The document of a result. Its single values become the table `result`, each list of rows a table of its own:
        `measurements`, `specimens`, `insertions` ...

    Returns
    -------
    dict
        `run` (one row: its ending and its annotations), `notes`, `states`, `events`, `trials`, `frames`, `truth` if
        there is one, then those of the result. A list in a row becomes a table of its own, such as `insertion_steps`
        or `truth_path`, whose rows name their trial.
    """
    said = run.annotations
    about = {key: run.manifest.get(key) for key in _ABOUT}
    about |= {"tags": ", ".join(said.tags), "verdict": said.verdict}
    tables = {
        "run": pd.DataFrame([about]),
        "notes": pd.DataFrame([vars(note) for note in said.notes], columns=list(_NOTE)),
        "states": run.states,
        "events": run.events,
        "frames": run.frame_table,
        "trials": run.trials,
    }
    for name, table in (("trials", run.trials), ("truth", run.truth)):
        if not table.empty:
            tables |= _split_lists(name, _number(table.to_dict("records")))
    if result is not None:
        found = _join_keys(result)
        tables["result"] = pd.DataFrame(
            [{name: value for name, value in found.items() if not _is_list_of(value, Mapping | list)}]
        )
        for name, rows in found.items():
            if _is_list_of(rows, Mapping):
                tables |= _split_lists(name, _number(rows))
    return {name: split_vectors(table).apply(_make_plain) for name, table in tables.items()}


def _join_keys(document: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return a nested document as one; an underscore joins the names."""
    joined: dict[str, Any] = {}
    for key, value in document.items():
        if key not in _LEFT_OUT:
            name = f"{path}{key}"
            joined |= _join_keys(value, f"{name}_") if isinstance(value, Mapping) else {name: value}
    return joined


def _number(rows: Iterable[Mapping[Any, Any]]) -> list[_Row]:
    return [(row, {}, number) for number, row in enumerate(rows)]


def _split_lists(name: str, rows: Sequence[_Row]) -> Tables:
    """Return a table and those of the lists in its cells, whose rows name their trial, or else its number from 0."""
    columns = dict.fromkeys(chain.from_iterable(row for row, _, _ in rows))
    lists = [
        column
        for column in columns
        if any(_is_list_of(row.get(column), Mapping | list) for row, _, _ in rows)
    ]
    bare = ({**part, **{key: cell for key, cell in row.items() if key not in lists}} for row, part, _ in rows)
    tables, singular = {name: pd.DataFrame(list(bare))}, name.removesuffix("s")
    for column in lists:
        items: list[_Row] = []
        for row, part, number in rows:
            key = {"trial": row["trial"]} if "trial" in row else {singular.rpartition("_")[2]: number}
            inner = row.get(column)
            items += [
                (item if isinstance(item, Mapping) else {column: item}, {**part, **key}, place)
                for place, item in enumerate(inner if isinstance(inner, list) else ())
            ]
        tables |= _split_lists(f"{singular}_{re.sub('_(mm|px)$', '', column)}", items)
    return tables


def _is_list_of(value: object, kind: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, kind) for item in value)


def _make_plain(column: "pd.Series[Any]") -> "pd.Series[Any]":
    """Return a column in which each cell is a number, a text, true, false or empty."""
    if column.dtype != object:
        return column
    plain = column.map(
        lambda cell: json.dumps(cell, ensure_ascii=False) if isinstance(cell, list | dict) else cell
    )
    plain = plain.convert_dtypes()
    if plain.dtype == "boolean":
        return plain
    return plain.astype("float64" if pd.api.types.is_numeric_dtype(plain.dtype) else "string")


def write_csv(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write a CSV file for each table, in UTF-8; unknown values are empty."""
    for name, table in tables.items():
        (folder / f"{name}.csv").write_bytes(encode_csv(table))


def write_parquet(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write a Parquet file for each table."""
    for name, table in tables.items():
        table.to_parquet(folder / f"{name}.parquet", engine="pyarrow", index=False)


def write_mat(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write one MATLAB file (version 5), `run.mat`: a struct for each table, a field for each column.

    Text is a cell array, in the one row of `run` a text; an unknown number is NaN. Truth values become numbers if some
    are unknown.
    """
    content: dict[str, Any] = {name: _make_struct(table) for name, table in tables.items()}
    content["run"] = {name: str(cells[0]) for name, cells in content.get("run", {}).items()}
    path = folder / "run.mat"
    scipy.io.savemat(path, content, long_field_names=True, oned_as="column", do_compression=True)
    # scipy writes the time of day and the platform into the header; equal runs must give equal files.
    with path.open("r+b") as file:
        file.write(_MAT_HEADER)


def _make_struct(table: pd.DataFrame) -> dict[str, Any]:
    """Return the columns by valid names, each once: long ones are cut, and then numbered."""
    fields: dict[str, Any] = {}
    for column in table.columns:
        name = re.sub(r"^(?![a-zA-Z])", "x", re.sub(r"\W", "_", str(column), flags=re.ASCII))[
            :_MAT_LONGEST_NAME
        ]
        fields[f"{name[:-4]}_{len(fields):03d}" if name in fields else name] = _make_cells(table[column])
    return fields


def _make_cells(column: "pd.Series[Any]") -> np.ndarray[Any, Any]:
    if pd.api.types.is_bool_dtype(column.dtype) and not column.isna().any():
        return column.to_numpy(dtype=bool)
    if pd.api.types.is_numeric_dtype(column.dtype):
        return column.to_numpy(dtype=np.float64, na_value=np.nan)
    return column.fillna("").astype(str).to_numpy(dtype=object)


WRITERS: Mapping[str, Callable[[Path, Mapping[str, pd.DataFrame]], None]] = {
    "csv": write_csv,
    "parquet": write_parquet,
    "matlab": write_mat,
}
