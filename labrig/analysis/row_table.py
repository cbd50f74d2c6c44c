"""The result of an experiment that measures picture by picture: a table with a row a picture.

`measure(picture, protocol)` of the experiment returns the row, `UNITS` name the units of its columns, and
`conclude(protocol, rows)`, where there is one, says what follows from all of them.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from labrig.analysis.experiment import AnalysisRequest, MeasuredExperiment
from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import Findings, Result, Summary, TextTable
from labrig.errors import MeasurementRefusedError, PictureError, RecordError
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.events import FrameLine, TrialStart, TrialStop
from labrig.record.reader import Run
from labrig.text import number
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap

Value = float | int | bool | str | None
Row = Mapping[str, Value]

OF_THE_PICTURE = ("trial", "frame", "role", "insertion_mm", "rotation_rad", "linear_mm")
_MOST_SHOWN = 40


@dataclass(frozen=True, eq=False)
class MeasuredPicture:
    """A recorded picture of a trial.

    Attributes
    ----------
    image : array (H, W) or (H, W, 3) of uint8
    trial, frame : int
        Its trial, and its number in the record.
    role : str
        What it was taken for.
    insertion_mm, rotation_rad, linear_mm : float
        Where the axes stood.
    """

    image: Picture
    trial: int
    frame: int
    role: str
    insertion_mm: float
    rotation_rad: float
    linear_mm: float
    run: Run

    @cached_property
    def plane(self) -> PlaneMap:
        """The map from pixels to mm that the run began with. Raises `InputError` without one."""
        return load_plane_map(self.run)

    def to_mm(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Return where pixels (N, 2) are in the steering plane, (N, 2) as (y, z) [mm]."""
        return self.plane.to_mm(pixels)


class RowTable(Result):
    """The rows of a run: trial, picture, where the axes stood, what was measured, and why nothing was (`reason`).

    `conclusion` is what the experiment says of all rows.
    """

    kind: Literal["rows"] = "rows"
    rows: tuple[dict[str, Value], ...]
    conclusion: dict[str, Value] = Field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns, those of the picture first."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row))

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The rows as a table."""
        return {"rows": pd.DataFrame(self.rows, dtype=object)} if self.rows else {}


def analyze_rows(
    experiment: MeasuredExperiment, run: Run, protocol: ExperimentProtocol, request: AnalysisRequest
) -> Findings:
    """Measure each picture of each trial that is to be evaluated, by the experiment's `measure`.

    Raises
    ------
    RecordError
        When lines of the run are damaged.
    PluginError
        When the experiment's own code fails.
    """
    made = {
        trial.start.trial
        for trial in run.read_trials(TrialStart, TrialStop)
        if trial.exit_status == "success" and not trial.left_out
    }
    lines = [line for line in run.frame_lines if line.trial in made and not line.drawn]
    rows = []
    for done, line in enumerate(lines, start=1):
        rows.append(_measure(experiment, run, line, protocol))
        if request.progress is not None:
            request.progress(done, len(lines))
    conclude: Callable[..., Row] = experiment.find_part("conclude") or (lambda *_: {})
    settings = getattr(protocol, "analysis", None)
    fields = request.stamp.list_members({} if settings is None else settings.model_dump())

    def make_table() -> RowTable:
        return RowTable(**fields, rows=tuple(rows), conclusion=_make_plain(conclude(protocol, rows)))

    return Findings(experiment.call(make_table, _tell_kept(run)))


def _measure(
    experiment: MeasuredExperiment, run: Run, line: FrameLine, protocol: ExperimentProtocol
) -> dict[str, Value]:
    """Return the row of a picture; what was measured is named with its unit."""
    measure, units = experiment.part("measure"), experiment.find_part("UNITS") or {}
    place = {name: getattr(line, name) for name in OF_THE_PICTURE}
    found, reason = dict[str, Value].fromkeys(units), None
    try:
        picture = MeasuredPicture(image=run.read_frame(line.frame), run=run, **place)
        found = experiment.call(lambda: _make_plain(measure(picture, protocol), place), _tell_kept(run))
    except (MeasurementRefusedError, PictureError, RecordError) as error:
        reason = error.message
    measured = {f"{name}_{units[name]}" if units.get(name) else name: value for name, value in found.items()}
    return {**place, **measured, "reason": reason}


def _tell_kept(run: Run) -> str:
    """Return the end of a hint after a fault of an author's code: nothing recorded is lost."""
    return f"; the run is recorded: when mended, labrig reanalyze {run.path}"


def _make_plain(found: Row, taken: Iterable[str] = ()) -> dict[str, Value]:
    """Return what a package's code found with Python's own numbers, None for those that are none."""
    if again := found.keys() & {*taken}:
        raise ValueError(f"{', '.join(sorted(again))} is a column of every picture: choose another name")
    plain = {name: value.item() if isinstance(value, np.generic) else value for name, value in found.items()}
    return {name: None if value != value else value for name, value in plain.items()}  # noqa: PLR0124 - NaN


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return the rows as a table; a result of another kind has none."""
    rows: Sequence[Mapping[str, Any]] = document.get("rows", ())
    hidden = {"role", "insertion_mm", "rotation_rad", "linear_mm"}
    heads = tuple(name for name in (dict.fromkeys(key for row in rows for key in row)) if name not in hidden)
    shown = [tuple(_tell(row.get(name)) for name in heads) for row in rows[:_MOST_SHOWN]]
    more = [f"and {len(rows) - _MOST_SHOWN} more rows"] if len(rows) > _MOST_SHOWN else []
    table = (TextTable(heads, tuple(shown)),) if rows else ()
    return (*table, *more)


def _tell(value: Any) -> Any:
    return number(value) if isinstance(value, float) else "-" if value is None else value
