"""A campaign: its rows on disk, the DataFrame that they make, and what it is among measured runs.

Each task is a measurement, and each simulated block of gel its own. A campaign's folder has its document and its rows,
which `labrig.campaign.store` writes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from labrig.errors import RecordError
from labrig.input_file import MAX_RESULT_BYTES, parse_json, read_file
from labrig.record.catalogue import manifest_fields
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


TABLE = "tasks"
_NOT_MEASURED = frozenset({*FIXED, "trial", "specimen"})
_AGAIN = "restore it from a copy, or make the campaign again"


@dataclass(frozen=True, eq=False)
class MeasuredCampaign:
    """A campaign and its table, as comparisons and `load_runs` take it.

    Attributes
    ----------
    path : Path
        Its folder.
    name : str
        Its name; its path, where several have that name.
    document : Mapping
        What decided its rows.
    plan : Mapping
        How many tasks it is to have, and the quantity that its page compares; empty where it was not kept.
    ended_by_rule : bool
        Whether its rule ended it before all of them were done.
    tasks : DataFrame
        A row for each task.
    """

    path: Path
    name: str
    document: Mapping[str, object]
    plan: Mapping[str, object]
    ended_by_rule: bool
    tasks: pd.DataFrame
    number: int = 0
    settings: Mapping[str, object] = field(default_factory=dict)
    overrides: tuple[str, ...] = ()
    not_in_interval: tuple[str, ...] = ()
    is_simulated: bool = True
    verdict: str | None = None

    @property
    def experiment(self) -> str:
        """The experiment whose protocol it repeats."""
        protocol = self.document.get("protocol")
        return str(protocol.get("experiment")) if isinstance(protocol, Mapping) else "unknown"

    @property
    def left(self) -> int:
        """How many of its tasks are still to be done; 0 where its rule ended it."""
        planned = self.plan.get("tasks")
        return 0 if self.ended_by_rule or not isinstance(planned, int) else max(0, planned - len(self.tasks))

    @property
    def measure(self) -> str | None:
        """The quantity that its page compares; None where that was not kept."""
        measure = self.plan.get("measure")
        return measure if isinstance(measure, str) else None

    @property
    def exit_status(self) -> str:
        """`incomplete` while tasks are to be done, as of a run that has not ended; else `success`."""
        return "incomplete" if self.left else "success"

    @property
    def calibration(self) -> Mapping[str, str]:
        """The SHA-256 of each calibration file of its rig."""
        kept = self.document.get("calibration")
        return {str(name): str(sha) for name, sha in kept.items()} if isinstance(kept, Mapping) else {}

    @cached_property
    def fields(self) -> Mapping[str, Sequence[object]]:
        """The values of its base protocol and its rig by dotted path."""
        return manifest_fields({name: self.document.get(name) for name in ("protocol", "rig")})

    @property
    def columns(self) -> Mapping[str, tuple[str, ...]]:
        """The columns of its one table."""
        return {TABLE: tuple(map(str, self.tasks.columns))}

    @property
    def quantities(self) -> tuple[str, ...]:
        """The columns that may hold a quantity."""
        return tuple(name for name in self.columns[TABLE] if name not in _NOT_MEASURED)

    def find_table(self, column: str) -> str | None:
        """Return the name of its table if that has the column, or the column of `TABLE.COLUMN`; else None."""
        known = self.columns[TABLE]
        return TABLE if column in known or column.removeprefix(f"{TABLE}.") in known else None

    def read_measurements(self, table: str) -> pd.DataFrame:  # noqa: ARG002 - it has one
        """Return a row for each task, with the columns of `MeasuredRun.read_measurements`; failed ones are left out."""
        about = {
            "run": self.name,
            "experiment": self.experiment,
            "result": self.number,
            "started": None,
            "left_out": self.tasks["error"].map(lambda error: None if pd.isna(error) else str(error)),
            "trial": self.tasks["task"],
            "specimen": self.tasks["task"].map("task {}".format),
        }
        return pd.concat([pd.DataFrame(about, index=self.tasks.index), self.tasks], axis=1)


def is_campaign(folder: Path) -> bool:
    """Return whether a folder is that of a campaign."""
    return (folder / CAMPAIGN).is_file()


def open_measured_campaign(folder: Path) -> MeasuredCampaign:
    """Read a campaign: its document, and the rows that are there.

    Raises
    ------
    RecordError
        When the document or a row is damaged.
    """
    tasks = make_table(read_rows(folder))
    try:
        kept: Any = parse_json(read_file(folder / CAMPAIGN, MAX_RESULT_BYTES))
        document, plan = {**kept["document"]}, {**kept.get("plan", {})}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordError(f"{folder / CAMPAIGN} is damaged: {error}", _AGAIN) from error
    by_rule = kept.get("ended") == BY_RULE
    return MeasuredCampaign(folder, folder.resolve().name, document, plan, by_rule, tasks)
