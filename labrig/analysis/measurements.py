"""The measurements of runs as one table: what their results list, with the trials of the record."""

import io
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any, TypeAlias

import pandas as pd
from pydantic import BaseModel, ConfigDict, ValidationError

from labrig.analysis.measured_campaign import MeasuredCampaign, is_campaign, open_measured_campaign
from labrig.analysis.result import RESULT_FILE, TABLES_FILE
from labrig.errors import InputError, LabrigError, RecordError
from labrig.input_file import MAX_RESULT_BYTES, parse_json, read_file
from labrig.lab import choose_runs_dir
from labrig.record.catalogue import find_runs, manifest_fields
from labrig.record.manifest import is_simulated
from labrig.record.reader import Run, open_run
from labrig.record.tables import unescape_formula
from labrig.text import format_count

_AGAIN = "make a new result with `labrig reanalyze`"
# Names that may look like numbers.
_TEXT = ("specimen", "needle_id")
_NOT_MEASURED = frozenset(
    {"trial", "frame", "hole", "gelatin_percent", "accepted", "found", "image", "role", "reason", *_TEXT}
)


@dataclass(frozen=True)
class LeftOut:
    """A run that is not among the measurements, and why."""

    run: Path
    error: LabrigError


class _Stamp(BaseModel):
    """What a result states of itself."""

    model_config = ConfigDict(extra="ignore")

    settings: dict[str, Any] = {}
    overrides: tuple[str, ...] = ()
    not_in_interval: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """A run and one of its results, whose tables are read when they are asked for.

    Attributes
    ----------
    run : Run
        The run.
    name : str
        Its name; its path, where several runs have that name.
    number : int
        Of the result.
    settings : Mapping
        Of the measurement.
    overrides : tuple of str
        Changes to the protocol after the run.
    not_in_interval : tuple of str
        Sources of error that the result knows nothing of.
    columns : Mapping
        Of each table that names trials, the columns.
    """

    run: Run
    name: str
    number: int
    settings: Mapping[str, Any]
    overrides: tuple[str, ...]
    not_in_interval: tuple[str, ...]
    columns: Mapping[str, tuple[str, ...]]

    @property
    def path(self) -> Path:
        """The folder of the run."""
        return self.run.path

    @property
    def experiment(self) -> str:
        """The experiment of the run."""
        return str(self.run.manifest.get("experiment"))

    @property
    def exit_status(self) -> str:
        """How the run ended."""
        return str(self.run.manifest.get("exit_status"))

    @property
    def verdict(self) -> str | None:
        """What a person judged of it; None if nobody did."""
        return self.run.annotations.verdict

    @property
    def calibration(self) -> Mapping[str, str]:
        """The SHA-256 of each calibration file of the run."""
        return self.run.calibration_hashes

    @property
    def is_simulated(self) -> bool:
        """Whether its drives and camera were simulated."""
        return is_simulated(self.run.manifest)

    @cached_property
    def fields(self) -> Mapping[str, Sequence[object]]:
        """The values of manifest and protocol by dotted path, and tags and verdict."""
        annotations = self.run.annotations
        return {
            **manifest_fields(self.run.manifest),
            **{
                f"protocol.{path}": values
                for path, values in manifest_fields(dict(self.run.protocol)).items()
            },
            "tag": list(annotations.tags),
            "verdict": [annotations.verdict],
        }

    def find_table(self, column: str) -> str | None:
        """Return the first table that has a column, or the table of `TABLE.COLUMN`; None without one."""
        table, _, name = column.rpartition(".")
        return next(
            (known for known, names in self.columns.items() if name in names and table in {"", known}), None
        )

    @property
    def quantities(self) -> tuple[str, ...]:
        """The columns that may hold a quantity: those with a unit in their name, or a ratio."""
        return tuple(
            name
            for table, names in self.columns.items()
            for name in (
                column if table == next(iter(self.columns)) else f"{table}.{column}" for column in names
            )
            if name.rpartition(".")[2] not in _NOT_MEASURED
        )

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
        rows = self._read_rows(table)
        trials = _read_trials(self.run)
        rows = _take_final_rows(rows, trials)
        added = [name for name in trials.columns if name not in rows.columns or name == "trial"]
        if not trials.empty:
            rows = rows.merge(trials[added], on="trial", how="left")
        about = {
            "run": self.name,
            "experiment": self.experiment,
            "result": self.number,
            "started": [_find_time(self.run, t_s) for t_s in rows.get("start_t_s", [None] * len(rows))],
            "left_out": _explain_left_out(self.run, rows["trial"]),
        }
        rest = rows.drop(columns=["start_t_s", "final_frame"], errors="ignore")
        return pd.concat([pd.DataFrame(about, index=rest.index), rest], axis=1)

    def _read_rows(self, table: str) -> pd.DataFrame:
        path = self.run.path / f"analysis/{self.number:03d}/{table}.csv"
        try:
            rows = pd.read_csv(
                io.BytesIO(read_file(path, MAX_RESULT_BYTES)),
                dtype=dict.fromkeys(_TEXT, str),
                keep_default_na=False,
                na_values=[""],
            )
        except (OSError, ValueError) as error:
            raise RecordError(f"{path} cannot be read: {error}", _AGAIN) from error
        texts = rows.select_dtypes(exclude=["number", "bool"]).columns
        for name in texts:
            rows[name] = rows[name].map(unescape_formula, na_action="ignore")
        return rows


Measured: TypeAlias = MeasuredRun | MeasuredCampaign
"""What comparisons take: a run with a result, or a campaign."""


def open_measured_run(path: Path) -> MeasuredRun:
    """Open a run with its newest result.

    Raises
    ------
    InputError
        When it has no result.
    RecordError
        When the run or the result is damaged.
    """
    run = open_run(path)
    if run.damage:
        first = run.damage[0]
        raise RecordError(f"{path} is damaged: {first.where}: {first.message}", first.hint)
    if not run.result_numbers:
        raise InputError(f"{path} has no result", f"make one with: labrig reanalyze {path}")
    number = run.result_numbers[-1]
    folder = run.result_dir(number)
    stamp = _read_stamp(folder / RESULT_FILE)
    return MeasuredRun(
        run,
        path.resolve().name,
        number,
        stamp.settings,
        stamp.overrides,
        stamp.not_in_interval,
        _list_columns(folder),
    )


def open_measured_runs(
    paths: Sequence[Path], progress: Callable[[float], None] = lambda _: None
) -> tuple[list[Measured], list[LeftOut]]:
    """Open runs and campaigns, each once; those that cannot be used are returned with the reason, not raised."""
    measured: list[Measured] = []
    left_out = []
    once = list({path.resolve(): path for path in paths}.values())
    for done, path in enumerate(once, start=1):
        try:
            measured.append(_open_measured(path))
        except LabrigError as error:
            left_out.append(LeftOut(path, error))
        progress(done / len(once))
    names = Counter(run.name for run in measured)
    return [run if names[run.name] == 1 else replace(run, name=str(run.path)) for run in measured], left_out


def _open_measured(path: Path) -> Measured:
    if is_campaign(path):
        return open_measured_campaign(path)
    return open_measured_run(path)


class Measurements(pd.DataFrame):
    """The measurements of runs; in a notebook it also says of how many, and which runs are left out and why."""

    def _repr_html_(self) -> str:
        """Return the table with what it holds above it."""
        left_out = self.attrs.get("left_out", {})
        count = self["run"].nunique() if "run" in self.columns else 0
        said = f"<p>{format_count(len(self), 'measurement')} of {format_count(count, 'run')}</p>"
        reasons = "".join(f"<li>{escape(run)}: {escape(reason)}</li>" for run, reason in left_out.items())
        return f"{said}{f'<p>Left out:</p><ul>{reasons}</ul>' if reasons else ''}{self.to_html(max_rows=20)}"


def load_runs(
    where: str | None = None, *, runs_dir: Path | str | None = None, table: str | None = None
) -> Measurements:
    """Return the measurements of runs as one table, a row for each trial or imported picture.

    Parameters
    ----------
    where : str or None
        The condition that a run has to fit, as for `labrig runs --where`; None: every run.
    runs_dir : Path, str or None
        Folder of the runs, or of one campaign; None: the runs that `labrig runs` lists.
    table : str or None
        The table of the results; None: the first one that each lists, as `measurements` or `insertions`.

    Returns
    -------
    Measurements
        A DataFrame: `run`, `experiment`, `result`, `started`, then the columns of the tables, with their units. A row
        that was not accepted has `accepted` false. `attrs["left_out"]` has the reason for each run without
        measurements, of which a warning tells.

    Raises
    ------
    InputError
        When the condition cannot be read.
    """
    measured, left_out = open_measured_runs(_find_runs(where, runs_dir))
    reasons = {str(run.run): run.error.message for run in left_out}
    tables = []
    for run in measured:
        wanted = next(iter(run.columns), None) if table is None else table
        if wanted is None or wanted not in run.columns:
            reasons[str(run.path)] = "its result has no such table of measurements"
        else:
            tables.append(run.read_measurements(wanted))
    if reasons:
        warnings.warn(f"{len(reasons)} runs are left out: see attrs['left_out']", stacklevel=2)
    joined = Measurements(join_measurements(tables))
    joined.attrs["left_out"] = reasons
    return joined


def _find_runs(where: str | None, runs_dir: Path | str | None) -> list[Path]:
    folder = choose_runs_dir().path if runs_dir is None else Path(runs_dir)
    if not is_campaign(folder):
        return [found.summary.run for found in find_runs(folder, where)]
    if where is not None:
        raise InputError(
            f"{folder} is a campaign, which has no runs to choose from",
            "leave out the condition, and choose among the rows of the table",
        )
    return [folder]


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
