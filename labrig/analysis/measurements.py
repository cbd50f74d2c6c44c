"""The measurements of runs as one table: what their results list, with the trials of the record."""

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from labrig.analysis.result import TABLES_FILE
from labrig.errors import InputError, LabrigError, RecordError
from labrig.lab import choose_runs_dir
from labrig.protocol.model import Model
from labrig.record.catalogue import list_runs, manifest_fields
from labrig.record.condition import Fields
from labrig.record.layout import is_simulated, read_document
from labrig.record.reader import Run, open_run, read_result_table
from labrig.record.results import read_result

_NOT_MEASURED = frozenset({
    "trial", "frame", "hole", "gelatin_percent", "accepted", "found", "image", "role", "reason", "specimen",
    "needle_id",
})  # fmt: skip
_FIRST = ("run", "experiment", "result", "started", "left_out")


@dataclass(frozen=True)
class LeftOut:
    """A run that is not among the measurements, and why."""

    run: Path
    error: LabrigError


class UsedRun(Model):
    """A run of a comparison: which of its results, and what is to be known of it."""

    run: str
    experiment: str
    result: int
    overrides: tuple[str, ...]
    exit_status: str
    verdict: str | None
    simulated: bool


@dataclass(frozen=True, eq=False)
class Measured:
    """A run and its newest result.

    Attributes
    ----------
    run : Run
        The run.
    about : UsedRun
        Its name (its path, where several have that name), and what has to be read with its numbers.
    settings : Mapping
        Of the measurement.
    not_in_interval : tuple of str
        Sources of error that the result knows nothing of.
    tables : Mapping
        Those that name trials.
    """

    run: Run
    about: UsedRun
    settings: Mapping[str, Any]
    not_in_interval: tuple[str, ...]
    tables: Mapping[str, pd.DataFrame]

    @property
    def name(self) -> str:
        """Its name among the others."""
        return self.about.run

    def rename(self, name: str) -> "Measured":
        """Return the run with another name among the others."""
        return replace(self, about=self.about.model_copy(update={"run": name}))

    @cached_property
    def fields(self) -> Fields:
        """The values of manifest, protocol and notes by dotted path."""
        return manifest_fields({**self.run.manifest, "protocol": self.run.protocol}, self.run.annotations)

    def find_column(self, quantity: str) -> tuple[str, str] | None:
        """Return the first table and column of a quantity, `COLUMN` or `TABLE.COLUMN`; None without one."""
        found = ((table, quantity.removeprefix(f"{table}.")) for table in self.tables)
        return next(((table, name) for table, name in found if name in self.tables[table]), None)

    @property
    def quantities(self) -> list[str]:
        """The columns that may hold a quantity, those of the first table by their name alone."""
        first = next(iter(self.tables), None)
        return [
            name if table == first else f"{table}.{name}"
            for table, rows in self.tables.items()
            for name in map(str, rows)
            if name not in _NOT_MEASURED
        ]

    def list_measurements(self, table: str) -> pd.DataFrame:
        """Return the rows of a table that count, one for each trial or imported picture.

        Columns: `run`, `experiment`, `result`, `started` (UTC; of an import, of the run), `left_out` (why a person had
        the trial not evaluated; else empty), those of the table, then those of the beginning of each trial that the
        table lacks.
        """
        rows, trials = self.tables[table], self.run.trials.drop(columns=["stop_t_s", "exit_status"])
        # A list is no value to group by.
        trials = trials.loc[:, ~trials.map(lambda cell: isinstance(cell, list | dict)).any().astype(bool)]
        added = [name for name in map(str, trials) if name not in rows or name == "trial"]
        rows = rows.astype({"trial": "Int64"}).merge(trials[added], on="trial", how="left")
        # Of a trial with several pictures the final one counts, if one was taken as such.
        several = rows["final_frame"].notna() & rows.duplicated("trial", keep=False)
        if "frame" in rows:
            rows = rows[~several | (rows["frame"] == rows["final_frame"]).fillna(value=False)]
        times_s = rows["start_t_s"].astype("float64").fillna(0.0)
        decisions = self.run.decisions
        whole = rows.drop(columns=["start_t_s", "final_frame"]).assign(
            **self.about.model_dump(include={"run", "experiment", "result"}),
            started=times_s.map(self.run.find_moment).map(
                lambda at: at.isoformat(timespec="seconds"), "ignore"
            ),
            left_out=rows["trial"].map(
                lambda trial: decisions.explain_left_out(int(trial)) or None, "ignore"
            ),
        )
        return whole[[*_FIRST, *(name for name in whole if name not in _FIRST)]]


def _open_run(path: Path) -> Measured:
    """Open a run with its newest result. Raises `InputError` when it has none, `RecordError` when it is damaged."""
    run = open_run(path)
    if run.damage:
        first = run.damage[0]
        raise RecordError(f"{path} is damaged: {first.where}: {first.message}", first.hint)
    if not run.result_numbers:
        raise InputError(f"{path} has no result", f"make one with: labrig reanalyze {path}")
    return read_measured(run, run.result_numbers[-1])


def read_measured(run: Run, number: int) -> Measured:
    """Return a run with its result of this number. Raises `RecordError` when that cannot be read."""
    folder = run.result_dir(number)
    result, listed = read_result(folder), read_document(folder / TABLES_FILE)
    names = [
        name for name, table in listed.items() if any(one["name"] == "trial" for one in table["columns"])
    ]
    about = UsedRun(
        run=run.path.resolve().name,
        experiment=str(run.manifest.get("experiment")),
        result=number,
        overrides=tuple(result.get("overrides", ())),
        exit_status=str(run.manifest.get("exit_status")),
        verdict=run.annotations.verdict,
        simulated=is_simulated(run.manifest),
    )
    tables = {name: read_result_table(folder / f"{name}.csv") for name in names}
    return Measured(run, about, result["settings"], tuple(result.get("not_in_interval", ())), tables)


def open_measured_runs(
    paths: Sequence[Path], progress: Callable[[float], None] = lambda _: None
) -> tuple[list[Measured], list[LeftOut]]:
    """Open runs, each once; those that cannot be used are returned with the reason, not raised."""
    measured: list[Measured] = []
    left_out = []
    once = list({path.resolve(): path for path in paths}.values())
    for done, path in enumerate(once, start=1):
        try:
            measured.append(_open_run(path))
        except LabrigError as error:
            left_out.append(LeftOut(path, error))
        progress(done / len(once))
    names = Counter(run.name for run in measured)
    for place, run in enumerate(measured):
        if names[run.name] > 1:
            measured[place] = run.rename(str(run.run.path))
    return measured, left_out


def load_runs(
    where: str | None = None, *, runs_dir: Path | str | None = None, table: str | None = None
) -> pd.DataFrame:
    """Return the measurements of runs as one table, a row for each trial or imported picture.

    Parameters
    ----------
    where : str or None
        The condition that a run has to fit, as for `labrig runs --where`; None: every run.
    runs_dir : Path, str or None
        Folder of the runs; None: the runs that `labrig runs` lists.
    table : str or None
        The table of the results; None: the first one that each lists, as `measurements` or `insertions`.

    Returns
    -------
    DataFrame
        `run`, `experiment`, `result`, `started` (when the trial began: when the run did, plus rig time, which in a
        simulation is not the computer's), then the columns of the tables, with their units. A row
        that was not accepted has `accepted` false. `attrs["left_out"]` has the reason for each run without
        measurements, of which a warning tells.

    Raises
    ------
    InputError
        When the condition cannot be read.
    """
    folder = choose_runs_dir().path if runs_dir is None else Path(runs_dir)
    measured, left_out = open_measured_runs([summary.run for summary in list_runs(folder, where)])
    reasons = {str(run.run): run.error.message for run in left_out}
    tables = []
    for run in measured:
        wanted = next(iter(run.tables), None) if table is None else table
        if wanted is None or wanted not in run.tables:
            reasons[str(run.run.path)] = "its result has no such table of measurements"
        else:
            tables.append(run.list_measurements(wanted))
    if reasons:
        named = ", ".join([*(Path(run).name for run in reasons)][:3] + ["..."] * (len(reasons) > 3))
        warnings.warn(f"runs left out ({len(reasons)}): {named}; see attrs['left_out']", stacklevel=2)
    joined = join_measurements(tables)
    joined.attrs["left_out"] = reasons
    return joined


def join_measurements(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Return tables below each other; a column that a table lacks is empty in its rows."""
    known = [table for table in tables if not table.empty]
    names = dict.fromkeys(name for table in known for name in table.columns)
    # Columns without any value would decide the type of the joined one.
    joined = (
        pd.concat([table.dropna(axis="columns", how="all") for table in known], ignore_index=True)
        if known
        else pd.DataFrame()
    )
    return joined.reindex(columns=list(names))
