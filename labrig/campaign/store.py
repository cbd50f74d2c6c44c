"""The rows of a campaign as they come, a line of JSON each, and the file that says whose they are.

That file also has the plan: how many tasks there are to be, and the rule that may end it earlier. More tasks may be
added to a plan; a rule is fixed before the first of them. What is there after a kill or a full disk is the beginning of
the table, and the next start goes on behind it. `table.parquet` is made of the rows, for pandas and others.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import pandas as pd

from labrig.analysis.engine import describe_installation, describe_kernels
from labrig.durable import (
    disk_errors,
    find_temporaries,
    temporary_file,
    write_atomically,
)
from labrig.errors import DiskError, InputError, OutputExistsError, RecordError
from labrig.input_file import MAX_RESULT_BYTES, parse_json, read_file
from labrig.record.difference import find_differences
from labrig.record.json_lines import LineFile, encode_document, encode_line, read_lines
from labrig.record.layout import CAMPAIGN, LOCK
from labrig.record.lock import FileLock
from labrig.record.processor import describe_change

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


_ELSEWHERE = "name another folder with --out"


@dataclass(frozen=True)
class CampaignPlan:
    """How much of a campaign there is to be; unlike what decides its rows, it may grow.

    Attributes
    ----------
    arms : int
    tasks : int
        All of them, if no rule ends it earlier.
    measure : str
        The quantity that its page compares.
    rule : Mapping or None
        The rule that may end it earlier, as JSON, with all that it looks at; None: there is none.
    """

    arms: int
    tasks: int
    measure: str
    rule: Mapping[str, Any] | None


class CampaignStore:
    """The folder of a campaign, of which this process is the only writer.

    Attributes
    ----------
    folder : Path
    done : int
        How many tasks have their rows: those from 0 on, without a gap.
    change : str
        How the kernels of this process differ from those that the campaign began with; empty if they do not.
    """

    _file: LineFile

    def __init__(self, folder: Path, lock: FileLock) -> None:
        self.folder = folder
        self.done = 0
        self.change = ""
        self._lock = lock
        self._content: dict[str, Any] = {}

    @classmethod
    def open(cls, folder: Path, document: Mapping[str, Any], plan: CampaignPlan) -> Self:
        """Begin a campaign, or go on with it.

        Parameters
        ----------
        folder : Path
            Made if it is not there. Once in use, it holds nothing but this campaign.
        document : Mapping
            All that decides the rows, as JSON holds it.
        plan : CampaignPlan
            How many rows there are to be, and when it ends.

        Raises
        ------
        OutputExistsError
            When something else is there.
        InputError
            When another campaign is there, or this one begun by another installation or with another rule, or more
            tasks of it are done than are planned; names the difference.
        RecordError
            When its files are damaged.
        LockedError
            When another process writes there.
        DiskError
            When the folder cannot be read or written.
        """
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as held:
            lock = FileLock(folder / LOCK).acquire("labrig campaign")
            held.callback(lock.release)
            store = cls(folder, lock)
            store._begin(json.loads(json.dumps(document, allow_nan=False)), plan)
            store._open_rows()
            held.callback(store._file.close)
            store._keep_plan(plan)
            held.pop_all()
        return store

    def __enter__(self) -> Self:
        """Return the open store."""
        return self

    def __exit__(self, *_: object) -> None:
        """Force the rows to disk, and let other processes write there."""
        with suppress(OSError):  # a power cut may cost the last of them then, and they are computed again
            self._file.sync()
        self._file.close()
        self._lock.release()

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Keep the rows of the next tasks.

        Parameters
        ----------
        rows : sequence of mapping
            `task` counts on from `done`; the other values are numbers, truth values, texts, None where there is none.

        Raises
        ------
        DiskError
            When they cannot be written; what is done stays done.
        """
        tasks = [row["task"] for row in rows]
        if tasks != list(range(self.done, self.done + len(rows))):
            raise ValueError(f"rows of tasks {tasks[:3]}..., expected those from {self.done} on")
        try:
            with disk_errors(self._file.path):
                self._file.append(b"".join(map(encode_line, rows)))
        except DiskError as error:
            hint = f"{error.hint}; {self.done} tasks are done, and the same command goes on behind them"
            raise error.reword(error.message, hint) from error
        self.done += len(rows)

    @property
    def table_file(self) -> Path:
        """Where `write_table` puts the table."""
        return self.folder / TABLE_FILE

    @property
    def ended_by_rule(self) -> bool:
        """Whether a rule ended the campaign before all of its tasks were done."""
        return self._content.get("ended") == BY_RULE

    def note_end(self) -> None:
        """Keep that a rule ended the campaign before all of its tasks were done. Raises `DiskError`."""
        if not self.ended_by_rule:
            self._write_document({**self._content, "ended": BY_RULE})

    def read_rows(self) -> list[dict[str, Any]]:
        """Return the rows that are done, in order. Raises `RecordError`."""
        return read_rows(self.folder)

    def write_table(self) -> pd.DataFrame:
        """Write `table.parquet` of the rows that are done, and return it. Raises `RecordError`, `DiskError`."""
        table = make_table(self.read_rows())
        with disk_errors(self.table_file), temporary_file(self.table_file) as temporary:
            table.to_parquet(temporary, index=False)
            temporary.replace(self.table_file)
        return table

    def _begin(self, document: Mapping[str, Any], plan: CampaignPlan) -> None:
        """Write the file of the campaign, or compare it with the one that is there."""
        with disk_errors(self.folder):
            for left in find_temporaries(self.folder):
                left.unlink()
            names = sorted(path.name for path in self.folder.iterdir() if not path.name.startswith(LOCK))
        if CAMPAIGN not in names:
            if names:
                raise OutputExistsError(f"{self.folder} holds {names[0]} and no campaign", _ELSEWHERE)
            self._write_document(
                {
                    "sha256": _digest(document),
                    "installation": describe_installation(),
                    "processor": describe_kernels(),
                    "plan": asdict(plan),
                    "document": document,
                }
            )
            return
        kept = self._content = self._read_document()
        if kept.get("sha256") != _digest(document):
            difference = _find_difference(kept.get("document"), document)
            raise InputError(f"{self.folder} holds another campaign: {difference}", _ELSEWHERE)
        if kept.get("installation") != describe_installation():
            difference = _find_difference(kept.get("installation"), describe_installation())
            raise InputError(
                f"{self.folder} was begun by another installation, whose rows may differ: {difference}",
                f"install that one again, or {_ELSEWHERE}",
            )
        self.change = describe_change(kept.get("processor"), describe_kernels())

    def _keep_plan(self, plan: CampaignPlan) -> None:
        """Compare the plan with the one that is kept, and keep it if it has changed."""
        kept, here = self._content.get("plan"), asdict(plan)
        if kept == here:
            return
        if self.done > plan.tasks:
            raise InputError(
                f"{self.folder} holds {self.done} tasks, and the file asks for {plan.tasks}",
                f"ask for as many as there are, or more; or {_ELSEWHERE}",
            )
        if self.done and isinstance(kept, Mapping) and kept.get("rule") != here["rule"]:
            difference = _find_difference({"rule": kept.get("rule")}, {"rule": here["rule"]})
            raise InputError(
                f"{self.folder} was begun with another rule to stop: {difference}",
                f"a rule is fixed before the first task: put it back as it was, or {_ELSEWHERE}",
            )
        self._write_document({**self._content, "plan": here})

    def _write_document(self, content: Mapping[str, Any]) -> None:
        write_atomically(self.folder / CAMPAIGN, encode_document(content))
        self._content = dict(content)

    def _read_document(self) -> dict[str, Any]:
        path = self.folder / CAMPAIGN
        try:
            kept = parse_json(read_file(path, MAX_RESULT_BYTES))
        except (OSError, ValueError) as error:
            raise RecordError(f"{path} is damaged: {error}", _ELSEWHERE) from error
        return dict(kept) if isinstance(kept, Mapping) else {}

    def _open_rows(self) -> None:
        """Open the rows, and count those that are there; the task of a torn last line is computed again."""
        rows, path = self.read_rows(), self.folder / ROWS_FILE
        if [row.get("task") for row in rows] != list(range(len(rows))):
            raise RecordError(f"{path} lacks rows between others", f"restore it from a copy, or {_ELSEWHERE}")
        self.done = len(rows)
        with disk_errors(path):
            self._file = LineFile.reopen(path) if path.exists() else LineFile.create(path)


def _digest(document: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _find_difference(kept: object, given: object) -> str:
    """Return the first place where two values of JSON differ, with both values."""
    for key, there, here in find_differences(kept, given):
        return f"{key} is {there} there and {here} here"
    return "its file differs"
