"""Export a run as tables for other programs: CSV, Parquet and MATLAB; pictures are not copied.

Every format holds the same tables, those of `labrig.report.tables`.
"""

import io
import json
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io

from labrig.durable import write_atomically
from labrig.errors import InputError
from labrig.record.json_lines import encode_document
from labrig.record.reader import Run
from labrig.record.tables import escape_formula
from labrig.report.tables import is_unknown, run_tables

Files = dict[str, bytes]

MANIFEST_FILE = "manifest.json"
MAT_FILE = "run.mat"

_MAT_LONGEST_NAME = 63
_MAT_MOST_BYTES = 2**31


def write_tables(run: Run, formats: Iterable[str], folder: Path) -> None:
    """Write a run and its newest result into a folder, in each of the formats `csv`, `parquet` and `matlab`.

    Raises
    ------
    RecordError
        When record or result are damaged.
    DiskError
        When a file cannot be written.
    """
    tables = run_tables(run, run.result)
    for name in formats:
        for file, content in FORMATS[name](run, tables).items():
            write_atomically(folder / file, content)


def export_csv(run: Run, tables: Mapping[str, pd.DataFrame]) -> Files:
    """Return a CSV file for each table, in UTF-8; unknown values are empty."""
    files = {
        f"{name}.csv": table.map(escape_formula).to_csv(index=False, lineterminator="\n").encode()
        for name, table in tables.items()
    }
    return {MANIFEST_FILE: encode_document(run.manifest), **files}


def export_parquet(run: Run, tables: Mapping[str, pd.DataFrame]) -> Files:
    """Return a Parquet file for each table."""
    files = {f"{name}.parquet": _encode_parquet(table) for name, table in tables.items()}
    return {MANIFEST_FILE: encode_document(run.manifest), **files}


def export_mat(run: Run, tables: Mapping[str, pd.DataFrame]) -> Files:
    """Return one MATLAB file (version 5): a struct for each table, a field for each column; `run` holds the manifest.

    Text is a cell array, an unknown number NaN; truth values become numbers if some are unknown.

    Raises
    ------
    InputError
        When a column exceeds the 2 GB of that format.
    """
    content: dict[str, object] = {
        name: {
            field: _make_mat_column(table[column])
            for field, column in zip(_name_mat_fields(table), table.columns, strict=True)
        }
        for name, table in tables.items()
    }
    about = (
        {str(key): _make_mat_text(value) for key, value in tables["run"].iloc[0].items()}
        if "run" in tables
        else {}
    )
    content["run"] = {**about, "manifest_json": json.dumps(run.manifest, ensure_ascii=False)}
    largest = max((table.memory_usage(deep=True).max() for table in tables.values()), default=0)
    if largest >= _MAT_MOST_BYTES:
        raise InputError(
            f"a column of {run.path} has {largest / 1e9:.1f} GB; a MATLAB file holds 2 GB a column",
            "take --format parquet, which MATLAB reads with parquetread",
        )
    buffer = io.BytesIO()
    target: Any = buffer  # the stubs know only paths
    scipy.io.savemat(target, content, long_field_names=True, oned_as="column", do_compression=True)
    # scipy writes the time of day and the platform into the header; equal runs must give equal files.
    return {MAT_FILE: _MAT_HEADER + buffer.getvalue()[len(_MAT_HEADER) :]}


FORMATS: Mapping[str, Callable[[Run, Mapping[str, pd.DataFrame]], Files]] = {
    "csv": export_csv,
    "parquet": export_parquet,
    "matlab": export_mat,
}

_MAT_HEADER = b"MATLAB 5.0 MAT-file, written by labrig".ljust(116)


def _encode_parquet(table: pd.DataFrame) -> bytes:
    buffer = io.BytesIO()
    table.to_parquet(buffer, engine="pyarrow", index=False)
    return buffer.getvalue()


def _name_mat_fields(table: pd.DataFrame) -> list[str]:
    """Return a valid name of a MATLAB field for each column, each once: long ones are cut, and then numbered."""
    names: list[str] = []
    for column in table.columns:
        plain = re.sub(r"\W", "_", str(column), flags=re.ASCII)
        name = (plain if plain[:1].isalpha() else f"x{plain}")[:_MAT_LONGEST_NAME]
        if name in names:
            end = f"_{len(names)}"
            name = f"{name[: _MAT_LONGEST_NAME - len(end)]}{end}"
        names.append(name)
    return names


def _make_mat_column(column: "pd.Series[Any]") -> np.ndarray[Any, Any]:
    if pd.api.types.is_bool_dtype(column.dtype) and not column.isna().any():
        return column.to_numpy(dtype=bool)
    if pd.api.types.is_numeric_dtype(column.dtype):
        return column.to_numpy(dtype=np.float64, na_value=np.nan)
    cells = np.empty(len(column), dtype=object)
    cells[:] = [_make_mat_text(value) for value in column]
    return cells


def _make_mat_text(value: object) -> str:
    return "" if is_unknown(value) else str(value)
