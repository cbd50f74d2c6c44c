"""The result of an analysis: its model, its files in `RUN/analysis/NNN/`, and reading them back.

`result.json` is written last: a folder without it is no result. `centre_lines.npz` holds the arrays (no pickle), so
that pages are drawn without measuring again. The CSV files hold the tables of the JSON for spreadsheets.
"""

import io
import math
import shutil
import zipfile
import zlib
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Generic, Literal, Self, TypeAlias, TypeVar, Union, get_args, get_origin

import numpy as np
import pandas as pd
from pydantic import ValidationError

from labrig.durable import write_atomically
from labrig.errors import InputError, RecordError
from labrig.input_file import MAX_RESULT_BYTES, read_file
from labrig.protocol.model import Model
from labrig.record.events import Decisions
from labrig.record.json_lines import encode_document
from labrig.record.reader import Run
from labrig.record.tables import encode_csv, split_vectors
from labrig.vision.curvature import CentreLine
from labrig.vision.error_budget import ErrorBudget

RESULT_FILE = "result.json"
TABLES_FILE = "tables.json"
LINES_FILE = "centre_lines.npz"

Point = tuple[float, float]
CentreLines: TypeAlias = Mapping[int, CentreLine]
"""By the number of the frame."""
_BLANK: Mapping[Any, Any] = {Point: (None, None), ErrorBudget: ErrorBudget().model_dump()}
"""What stands in a table for a value that is not known, so that it has its columns."""
_MOST_CELLS = 300
_AGAIN = "make a new result with `labrig reanalyze`"


def tabulate(model: type[Model], rows: Iterable[Model], without: Container[str] = ()) -> pd.DataFrame:
    """Return models as a table with a number, or a text, in each cell: see `split_vectors`."""
    fields = {name: field for name, field in model.model_fields.items() if not field.exclude}
    names = [name for name in fields if name not in without]
    table = pd.DataFrame((row.model_dump(include=set(names)) for row in rows), columns=names, dtype=object)
    for name in names:
        for kind in _BLANK.keys() & set(get_args(fields[name].annotation)):
            table[name] = [_BLANK[kind] if cell is None else cell for cell in table[name]]
    return split_vectors(table).map(_join_texts)


def _join_texts(cell: object) -> object:
    return "; ".join(map(str, cell)) if isinstance(cell, tuple) else cell


class LeftOutTrials(Model):
    """How many trials a person had left out: skipped before they started, marked as bad, or made again."""

    skipped: int = 0
    marked_bad: int = 0
    repeated: int = 0

    @classmethod
    def of(cls, decisions: Decisions) -> Self:
        """Count the trials that these decisions leave out; one that is bad and was made again counts as bad."""
        bad = decisions.bad.keys()
        return cls(
            skipped=len(decisions.skipped), marked_bad=len(bad), repeated=len(decisions.repeated - bad)
        )


NOTHING_LEFT_OUT = LeftOutTrials()


class Result(Model):
    """The members of every result: its parent, settings, inputs and provenance.

    `left_out` counts the trials that are not evaluated because a person decided so. `damage` lists what was missing
    from the record or changed when the result was made, `where: what` each.
    """

    schema_version: Literal[1] = 1
    parent: int | None
    created: str
    settings: Any
    overrides: tuple[str, ...]
    inputs: dict[str, str]
    provenance: dict[str, Any]
    damage: tuple[str, ...] = ()
    left_out: LeftOutTrials = NOTHING_LEFT_OUT

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The tables of the result by name; each is also written as CSV."""
        return {}

    def list_members(self, settings: Mapping[str, Any] | Model) -> dict[str, Any]:
        """Return the members that every result has, of which nothing but the settings of the measurement is new."""
        return {**{name: getattr(self, name) for name in Result.model_fields}, "settings": settings}


class TrialOrigin(Model):
    """The sheath's pose in a trial, found in a picture once the sheath was in; unknown values are None.

    `tip_mm` and `heading_rad` are the origin and the direction of the trial. `expected_mm` is the tip according to
    command and linear encoder; `along_mm` and `across_mm` are the deviations from it along the insertion and towards
    +y, and `disagreement_mm` is their distance. `from_others_mm` is the distance from the tip according to the encoder
    and the other trials; without an expected tip it is also the `disagreement_mm`.
    """

    trial: int
    frame: int
    tip_mm: Point | None = None
    tip_px: Point | None = None
    heading_rad: float | None = None
    linear_mm: float | None = None
    expected_mm: Point | None = None
    along_mm: float | None = None
    across_mm: float | None = None
    disagreement_mm: float | None = None
    from_others_mm: float | None = None
    accepted: bool
    reason: str | None = None

    @property
    def heading_deg(self) -> float | None:
        """The heading in degrees, for people."""
        return None if self.heading_rad is None else math.degrees(self.heading_rad)


class Sentinel(Model):
    """The comparison of the grid pictures before and after a run; unknown values are None.

    `drift` is the largest relative change of scale, which is part of the error bar of every length; `bending_mm` is the
    change of the grid's shape. `view` says in words what the scale of the plane map implies. If the sentinel is not
    accepted, the run states no lengths.
    """

    drift: float | None = None
    bending_mm: float | None = None
    scale_before: float | None = None
    scale_after: float | None = None
    view: str | None = None
    accepted: bool
    reason: str | None = None

    @property
    def drift_percent(self) -> float | None:
        """The drift in percent, for people."""
        return None if self.drift is None else 100.0 * self.drift


def make_origin_table(origins: Sequence[TrialOrigin]) -> dict[str, pd.DataFrame]:
    """Return the table of the origins of trials; no table if no sheath was searched for."""
    return {"origins": tabulate(TrialOrigin, origins)} if origins else {}


Content_co = TypeVar("Content_co", bound=Result, covariant=True)


@dataclass(frozen=True)
class AnalysisResult(Generic[Content_co]):
    """A result on disk: its folder and its content."""

    path: Path
    content: Content_co

    @property
    def document(self) -> Mapping[str, Any]:
        """The content as `result.json` holds it."""
        return self.content.model_dump(mode="json")


Quantity: TypeAlias = bool | int | float | str | None

AnyResult: TypeAlias = AnalysisResult[Result]
"""A result of any experiment."""


@dataclass(frozen=True)
class TextTable:
    """A table for a terminal: its heads, and rows with a cell for each."""

    heads: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]


Summary: TypeAlias = tuple[str | TextTable, ...]
"""A result in a few lines: sentences, and tables."""


@dataclass(frozen=True)
class Findings:
    """The output of an analysis: the result, and a call that saves further files into the result's folder."""

    content: Result
    save: Callable[[Path], None] | None = None


def write_result(path: Path, findings: Findings) -> AnyResult:
    """Write a result into its folder, `result.json` last.

    `tables.json` names each table, its file, its columns with their units, and its number of rows.

    Raises
    ------
    DiskError
        When it cannot be written; nothing is left behind.
    """
    try:
        return _write_parts(path, findings)
    finally:
        if not (path / RESULT_FILE).exists():
            shutil.rmtree(path, ignore_errors=True)


def _write_parts(path: Path, findings: Findings) -> AnyResult:
    if findings.save is not None:
        findings.save(path)
    result = AnalysisResult(path, findings.content)
    listed = {}
    for name, table in findings.content.tables.items():
        write_atomically(path / f"{name}.csv", encode_csv(table))
        columns = [{"name": column, "unit": _find_unit(column)} for column in table.columns]
        listed[name] = {"file": f"{name}.csv", "columns": columns, "rows": len(table)}
    write_atomically(path / TABLES_FILE, encode_document(listed))
    write_atomically(path / RESULT_FILE, encode_document(result.document))
    return result


def list_quantities(content: Result) -> dict[str, Quantity]:
    """Return what a result states of the whole run: its own members that are a number, a truth value or a word.

    An interval is two quantities, named as in the tables. None: not known.
    """
    others = {"kind", *Result.model_fields}
    others |= {
        name for name, field in type(content).model_fields.items() if not _is_quantity(field.annotation)
    }
    table = tabulate(type(content), [content], others)
    return dict(table.astype(object).where(table.notna(), None).iloc[0])


def list_values(content: Result) -> dict[str, Quantity]:
    """Return what a result states of the whole run, and the cells of its short tables."""
    values = list_quantities(content)
    for name, table in content.tables.items():
        if table.size <= _MOST_CELLS:
            has_names = "name" in table and table["name"].is_unique
            for number, row in enumerate(
                table.astype(object).where(table.notna(), None).to_dict("records"), 1
            ):
                row_name = row["name"] if has_names else f"{name.removesuffix('s')} {number}"
                values |= {f"{row_name}: {column}": cell for column, cell in row.items()}
    return values


def note_overrides(run: str, number: int, overrides: Sequence[str]) -> Iterator[str]:
    """Yield that a result was measured with other settings than its run, if it was."""
    if overrides:
        yield f"Result {number} of {run} has settings changed after the run: {', '.join(overrides)}."


def _is_quantity(kind: Any) -> bool:
    """Return whether a field of this type holds a number, a truth value, a word or an interval."""
    parts = get_args(kind) if get_origin(kind) in {Union, UnionType} else (kind,)
    return all(part in {bool, int, float, str, NoneType, Point} for part in parts)


def find_newest_result_folder(run: Run) -> Path | None:
    """Return the folder of the newest result; None without one. Raises `RecordError` when a file in it was changed."""
    numbers = run.result_numbers
    return run.result_dir(numbers[-1]) if numbers else None


def load_result(run: Run, model: type[Result], number: int | None = None) -> AnyResult | None:
    """Return the result of a run with that number, or the newest; None if the run has no result.

    Parameters
    ----------
    model : type
        Model of the experiment's result.

    Raises
    ------
    InputError
        When no result has that number.
    RecordError
        When the result was changed, is damaged, has a newer schema, or contains a symbolic link.
    """
    numbers = run.result_numbers
    if number is None and not numbers:
        return None
    wanted = numbers[-1] if number is None else number
    if wanted not in numbers:
        hint = f"it has {list(numbers)}; `labrig reanalyze` makes another"
        raise InputError(f"{run.path} has no result {wanted:03d}", hint)
    path = run.result_dir(wanted)
    try:
        for file in path.iterdir():
            run.own(f"analysis/{wanted:03d}/{file.name}")
        content = model.model_validate_json(read_file(path / RESULT_FILE, MAX_RESULT_BYTES))
    except (OSError, ValidationError) as error:
        raise RecordError(f"{path / RESULT_FILE} cannot be read: {describe_error(error)}", _AGAIN) from error
    return AnalysisResult(path, content)


def save_centre_lines(lines: CentreLines, folder: Path) -> None:
    """Write the needle's centre line in pictures into the folder of a result. Raises `DiskError`.

    All lines stand end to end, since a thousand small arrays would take a second to load, and in single precision,
    which is a hundred times finer than any picture: they are only drawn, never fitted.
    """
    buffer, empty = io.BytesIO(), np.empty((0, 2))
    np.savez_compressed(
        buffer,
        frames=np.array(list(lines), dtype=np.int64),
        starts=np.cumsum([0, *(len(line.mm) for line in lines.values())], dtype=np.int64),
        windows=np.array([line.window for line in lines.values()], dtype=np.int64).reshape(-1, 2),
        mm=np.concatenate([empty, *(line.mm for line in lines.values())]).astype(np.float32),
        px=np.concatenate([empty, *(line.px for line in lines.values())]).astype(np.float32),
    )
    write_atomically(folder / LINES_FILE, buffer.getvalue())


def load_centre_lines(folder: Path) -> CentreLines:
    """Read the centre lines of a result; none without the file. Raises `RecordError` when it is damaged."""
    file = folder / LINES_FILE
    if not file.exists():
        return {}
    try:
        with np.load(io.BytesIO(read_file(file, MAX_RESULT_BYTES)), allow_pickle=False) as arrays:
            ends = arrays["starts"][1:]
            mm, px = (np.split(arrays[name].astype(np.float64), ends)[:-1] for name in ("mm", "px"))
            rows = zip(arrays["frames"].tolist(), mm, px, arrays["windows"].tolist(), strict=True)
            return {frame: CentreLine(mm, px, (first, end)) for frame, mm, px, (first, end) in rows}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise RecordError(f"{file} cannot be read: {error}", _AGAIN) from error


def describe_error(error: OSError | ValidationError) -> str:
    """Return why a document of a run cannot be read: the first fault, and where."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    return f"{place}: {first['msg']}" if place else first["msg"]


# The longest first: a speed in mm/s also ends with s.
_UNITS = ("mm_s", "rad_s", "mm", "px", "rad", "deg", "s", "h", "hz", "percent")


def _find_unit(column: str) -> str | None:
    """Return the unit in the name of a column; None without one."""
    found = next((unit for unit in _UNITS if column.endswith(f"_{unit}")), None)
    return None if found is None else found.replace("_", "/")
