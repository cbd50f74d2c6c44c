"""The measurements of runs as one table: what their results list, with the trials of the record."""

import io
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import BaseModel, ValidationError

from labrig.analysis.result import RESULT_FILE, TABLES_FILE
from labrig.errors import InputError, LabrigError, RecordError
from labrig.input_file import MAX_RESULT_BYTES, parse_json, read_file
from labrig.lab import choose_runs_dir
from labrig.protocol.model import Model
from labrig.record.catalogue import list_runs, manifest_fields
from labrig.record.condition import Fields
from labrig.record.layout import is_simulated
from labrig.record.reader import Run, open_run
from labrig.record.tables import unescape_formula

_AGAIN = "make a new result with `labrig reanalyze`"
# Names that may look like numbers.
_TEXT = ("specimen", "needle_id")
_NOT_MEASURED = frozenset(
    {
        "trial",
        "frame",
        "hole",
        "gelatin_percent",
        "accepted",
        "found",
        "image",
        "role",
        "reason",
        *_TEXT,
    }
)


@dataclass(frozen=True)
class LeftOut:
    """A run that is not among the measurements, and why."""

    run: Path
    error: LabrigError


class _Stamp(BaseModel):
    """What a result states of itself; more is ignored."""

    settings: dict[str, Any] = {}
    overrides: tuple[str, ...] = ()
    not_in_interval: tuple[str, ...] = ()


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
    """A run and its newest result, whose tables are read when they are asked for.

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
    columns : Mapping
        Of each table that names trials, the columns.
    """

    run: Run
    about: UsedRun
    settings: Mapping[str, Any]
    not_in_interval: tuple[str, ...]
    columns: Mapping[str, tuple[str, ...]]

    @property
    def name(self) -> str:
        """Its name among the others."""
        return self.about.run

    @cached_property
    def fields(self) -> Fields:
        """The values of manifest, protocol and notes by dotted path."""
        manifest = {**self.run.manifest, "protocol": self.run.protocol}
        return manifest_fields(manifest, self.run.annotations)

    def find_column(self, quantity: str) -> tuple[str, str] | None:
        """Return the first table and column of a quantity, `COLUMN` or `TABLE.COLUMN`; None without one."""
        found = ((table, quantity.removeprefix(f"{table}.")) for table in self.columns)
        return next(((table, name) for table, name in found if name in self.columns[table]), None)

    @property
    def quantities(self) -> list[str]:
        """The columns that may hold a quantity, those of the first table by their name alone."""
        first = next(iter(self.columns), None)
        return [
            name if table == first else f"{table}.{name}"
            for table, names in self.columns.items()
            for name in names
            if name not in _NOT_MEASURED
        ]

    def read_measurements(self, table: str) -> pd.DataFrame:
        """Return the rows of a table that count, one for each trial or imported picture.

        Columns: `run`, `experiment`, `result`, `started` (UTC; of an import, of the run), `left_out` (why a person had
        the trial not evaluated; else empty), those of the table, then those of the beginning of each trial that the
        table lacks.

        Raises
        ------
        RecordError
            When the table cannot be read.
        """
        about, trials = self.about, _read_trials(self.run)
        path = self.run.path / f"analysis/{about.result:03d}/{table}.csv"
        rows = _take_final_rows(_read_csv(path), trials)
        if not trials.empty:
            added = [name for name in trials.columns if name not in rows.columns or name == "trial"]
            rows = rows.merge(trials[added], on="trial", how="left")
        times = rows["start_t_s"] if "start_t_s" in rows else [None] * len(rows)
        whole = rows.drop(columns=["start_t_s", "final_frame"], errors="ignore").assign(
            run=about.run,
            experiment=about.experiment,
            result=about.result,
            started=pd.Series([_find_time(self.run, t_s) for t_s in times], rows.index, dtype=object),
            left_out=pd.Series(_explain_left_out(self.run, rows["trial"]), rows.index, dtype=object),
        )
        first = ["run", "experiment", "result", "started", "left_out"]
        return whole[[*first, *(name for name in whole if name not in first)]]


def _open_run(path: Path) -> Measured:
    """Open a run with its newest result. Raises `InputError` when it has none, `RecordError` when it is damaged."""
    run = open_run(path)
    if run.damage:
        first = run.damage[0]
        raise RecordError(f"{path} is damaged: {first.where}: {first.message}", first.hint)
    if not run.result_numbers:
        raise InputError(f"{path} has no result", f"make one with: labrig reanalyze {path}")
    number = run.result_numbers[-1]
    folder = run.result_dir(number)
    stamp = _read_stamp(folder / RESULT_FILE)
    about = UsedRun(
        run=path.resolve().name,
        experiment=str(run.manifest.get("experiment")),
        result=number,
        overrides=stamp.overrides,
        exit_status=str(run.manifest.get("exit_status")),
        verdict=run.annotations.verdict,
        simulated=is_simulated(run.manifest),
    )
    return Measured(run, about, stamp.settings, stamp.not_in_interval, _list_columns(folder))


def _read_csv(path: Path) -> pd.DataFrame:
    try:
        rows = pd.read_csv(
            io.BytesIO(read_file(path, MAX_RESULT_BYTES)),
            dtype=dict.fromkeys(_TEXT, str),
            keep_default_na=False,
            na_values=[""],
        )
    except (OSError, ValueError) as error:
        raise RecordError(f"{path} cannot be read: {error}", _AGAIN) from error
    for name in rows.select_dtypes(exclude=["number", "bool"]).columns:
        rows[name] = rows[name].map(unescape_formula, na_action="ignore")
    return rows


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
            about = run.about.model_copy(update={"run": str(run.run.path)})
            measured[place] = replace(run, about=about)
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
        `run`, `experiment`, `result`, `started`, then the columns of the tables, with their units. A row
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
        wanted = next(iter(run.columns), None) if table is None else table
        if wanted is None or wanted not in run.columns:
            reasons[str(run.run.path)] = "its result has no such table of measurements"
        else:
            tables.append(run.read_measurements(wanted))
    if reasons:
        warnings.warn(f"{len(reasons)} runs are left out: see attrs['left_out']", stacklevel=2)
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


def _read_stamp(path: Path) -> _Stamp:
    try:
        return _Stamp.model_validate(parse_json(read_file(path, MAX_RESULT_BYTES)))
    except (OSError, ValueError) as error:
        reason = "it is no result" if isinstance(error, ValidationError) else str(error)
        raise RecordError(f"{path} cannot be read: {reason}", _AGAIN) from error


def _list_columns(folder: Path) -> dict[str, tuple[str, ...]]:
    """Return the columns of each table that names trials."""
    path = folder / TABLES_FILE
    try:
        listed: Any = parse_json(read_file(path, MAX_RESULT_BYTES))
        tables = {
            str(name): tuple(str(column["name"]) for column in table["columns"])
            for name, table in listed.items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordError(f"{path} cannot be read: {error}", _AGAIN) from error
    return {name: columns for name, columns in tables.items() if "trial" in columns}


def _read_trials(run: Run) -> pd.DataFrame:
    """Return the trials of a run: what they began with, and their final picture; lists are left out."""
    trials = run.trials.drop(columns=["stop_t_s", "exit_status"], errors="ignore")
    lists = [
        name for name in trials.columns if trials[name].map(lambda cell: isinstance(cell, list | dict)).any()
    ]
    return trials.drop(columns=lists)


def _take_final_rows(rows: pd.DataFrame, trials: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each trial: of several, that of the trial's final picture; rows without a trial stay."""
    several = rows["trial"].notna() & rows.duplicated("trial", keep=False)
    if "frame" not in rows.columns or not several.any():
        return rows
    finals = set(trials["final_frame"].dropna()) if "final_frame" in trials.columns else set()
    return rows[~several | rows["frame"].isin(finals)]


def _explain_left_out(run: Run, trials: "pd.Series[float]") -> list[str | None]:
    """Return why each trial is not to be evaluated; None if it is, or for a picture without a trial."""
    decisions = run.decisions
    return [None if pd.isna(trial) else decisions.explain_left_out(int(trial)) or None for trial in trials]


def _find_time(run: Run, t_s: float | None) -> str | None:
    """Return the calendar time of a rig time; None for a run that does not say when it began."""
    moment = run.find_moment(0.0 if t_s is None or pd.isna(t_s) else float(t_s))
    return None if moment is None else moment.isoformat(timespec="seconds")
