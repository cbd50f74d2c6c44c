"""The folder of a campaign: its rows as they come, a line of JSON each, and the file that says whose they are.

What is there after a kill or a full disk is the beginning of the table, and the next start goes on behind it.
`table.parquet` is made of the rows, for pandas and others.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from labrig.durable import disk_errors, temporary_file, write_atomically
from labrig.errors import DiskError, InputError, OutputExistsError, RecordError
from labrig.input_file import MAX_RESULT_BYTES, parse_json, read_file
from labrig.record.difference import find_differences
from labrig.record.json_lines import LineFile, encode_document, encode_line, read_lines
from labrig.record.layout import CAMPAIGN, LOCK
from labrig.record.lock import FileLock
from labrig.record.provenance import describe_change, describe_processor

ROWS_FILE = "tasks.jsonl"
TABLE_FILE = "table.parquet"
FIXED = ("task", "arm", "point", "repetition", "seed", "exit_status", "reason", "error")
"""What every row has, in this order; varied keys and values follow in the order in which they first appear."""
_ELSEWHERE = "name another folder with --out"

Row = Mapping[str, Any]


@dataclass(frozen=True)
class CampaignStore:
    """The folder of a campaign, of which this process is the only writer.

    Attributes
    ----------
    rows : list of mapping
        Of the tasks from 0 on, without a gap.
    change : str
        How the kernels of this process differ from those that made the first rows; empty if they do not.
    """

    folder: Path
    rows: list[Row]
    change: str
    _file: LineFile

    def append(self, row: Row) -> None:
        """Keep the row of the next task. Raises `DiskError` when it cannot be written; what is done stays done."""
        try:
            with disk_errors(self._file.path):
                self._file.append(encode_line(row))
        except DiskError as error:
            hint = f"{error.hint}; {len(self.rows)} tasks are done, and the same command goes on behind them"
            raise error.reword(error.message, hint) from error
        self.rows.append(row)

    def write_table(self) -> pd.DataFrame:
        """Write `table.parquet` of the rows that are done, and return it. Raises `DiskError`."""
        table, file = make_table(self.rows), self.folder / TABLE_FILE
        with disk_errors(file), temporary_file(file) as temporary:
            table.to_parquet(temporary, index=False)
            temporary.replace(file)
        return table


@contextmanager
def open_store(folder: Path, document: Mapping[str, object]) -> Iterator[CampaignStore]:
    """Begin a campaign in a folder, which is made if it is not there, or go on with it.

    Parameters
    ----------
    document : mapping
        All that decides the rows, as JSON.

    Raises
    ------
    OutputExistsError
        When something else is there.
    InputError
        When rows of another campaign are there, or of another installation; names the difference.
    RecordError
        When its files are damaged.
    LockedError
        When another process writes there.
    DiskError
        When the folder cannot be read or written.
    """
    path, rows_path = folder / CAMPAIGN, folder / ROWS_FILE
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        names = sorted(file.name for file in folder.iterdir() if not file.name.startswith("."))
    if names and not path.exists():
        raise OutputExistsError(f"{folder} holds {names[0]} and no campaign", _ELSEWHERE)
    with FileLock(folder / LOCK).acquire("labrig campaign"):
        rows: list[Row] = [*read_lines(rows_path)] if rows_path.exists() else []
        if [row.get("task") for row in rows] != list(range(len(rows))):
            raise RecordError(
                f"{rows_path} lacks rows between others", f"restore it from a copy, or {_ELSEWHERE}"
            )
        change = ""
        if rows:
            change = _require_same(path, document)
        else:
            write_atomically(path, encode_document({**document, "processor": describe_processor()}))
        with disk_errors(rows_path):
            file = LineFile(rows_path)
        try:
            yield CampaignStore(folder, rows, change, file)
        finally:
            with suppress(OSError):  # a power cut may cost the last of them then, and they are computed again
                file.sync()
            file.close()


def _require_same(path: Path, document: Mapping[str, object]) -> str:
    """Refuse to go on with rows that another document decided; return how the kernels differ."""
    try:
        kept: Any = parse_json(read_file(path, MAX_RESULT_BYTES))
        processor = kept.pop("processor", None)
    except (OSError, ValueError, AttributeError) as error:
        raise RecordError(f"{path} is damaged: {error}", _ELSEWHERE) from error
    for key, (there, here) in find_differences(kept, document):
        name = key.removeprefix("installation.")
        told = f"holds another campaign: {key} is {there} there and {here} here"
        if name != key:
            told = f"was begun with another version of {name.replace('source_sha256', 'labrig')}"
        hint = f"its page and table stay; go on with what it was begun with, or {_ELSEWHERE} to begin anew"
        raise InputError(f"{path.parent} {told}", hint)
    return describe_change(processor, describe_processor())


def make_table(rows: Sequence[Row]) -> pd.DataFrame:
    """Return rows as a table, a column of one type for each of their names; what a row lacks is missing."""
    names = dict.fromkeys([*FIXED, *(name for row in rows for name in row)])
    return pd.DataFrame({name: _make_column([row.get(name) for row in rows]) for name in names})


def _make_column(values: Sequence[Any]) -> "pd.Series[Any]":
    kinds = {type(value) for value in values if value is not None}
    if kinds == {bool}:
        return pd.Series(values, dtype="boolean")
    if kinds == {int}:
        return pd.Series(values, dtype="Int64")
    if kinds and kinds <= {int, float}:
        return pd.Series(values, dtype="float64")
    return pd.Series([None if value is None else str(value) for value in values], dtype="string")
