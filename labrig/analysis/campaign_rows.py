"""The rows of a campaign on disk, which `labrig.campaign.store` writes, and the DataFrame that they make."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from labrig.record.json_lines import read_lines
from labrig.record.layout import CAMPAIGN

ROWS_FILE = "tasks.jsonl"
TABLE_FILE = "table.parquet"
BY_RULE = "by_rule"
"""How a campaign ended that its rule ended before all of its tasks were done."""
FIXED = ("task", "arm", "point", "repetition", "seed", "exit_status", "reason", "error")
"""What every row has, in this order; varied keys and values follow in the order in which they first appear."""


def read_rows(folder: Path) -> list[dict[str, Any]]:
    """Return the rows of a campaign in order, without a torn last line; none before the first task.

    Raises
    ------
    RecordError
        When a line is damaged; names it.
    """
    path = folder / ROWS_FILE
    return read_lines(path) if path.exists() else []


def make_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
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


def is_campaign(folder: Path) -> bool:
    """Return whether a folder is that of a campaign."""
    return (folder / CAMPAIGN).is_file()
