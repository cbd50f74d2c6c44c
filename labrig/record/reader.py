"""Read a run that is closed, interrupted or cut short; damage is refused with its place."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from labrig.errors import Problem, RecordError
from labrig.protocol.yaml_text import load_yaml_values
from labrig.record import layout
from labrig.record.check import find_damage
from labrig.record.events import (
    READ,
    Continue,
    Decisions,
    Event,
    FrameLine,
    PastPause,
    Pause,
    RecordedTrial,
    TrialStart,
    TrialStop,
    TruthLine,
    fold_decisions,
    list_pauses,
    parse_events,
    parse_lines,
)
from labrig.record.json_lines import read_lines
from labrig.record.layout import (
    CALIBRATION,
    COPY_HINT,
    INCOMPLETE,
    inside,
    is_opening_file,
    read_checksum,
    read_manifest,
    read_sums,
    require_name,
)
from labrig.record.notes import Annotations, read_annotations
from labrig.record.pictures import RecordedPicture, locate_pictures
from labrig.record.results import list_results, open_result, read_result
from labrig.record.tables import add_axis_units, unescape_formula

_Event = TypeVar("_Event", bound=Event)
_Truth = TypeVar("_Truth", bound=TruthLine)
_Start = TypeVar("_Start", bound=TrialStart)
_Stop = TypeVar("_Stop", bound=TrialStop)

# Also a table without rows has these columns.
_COLUMNS = {
    "states": ("t_s",),
    "events": ("kind", "t_s"),
    "frames": ("frame", "file", "sha256", "t_s", "trial", "role"),
    "truth": ("trial",),
    "trials": ("trial", "start_t_s", "stop_t_s", "exit_status", "final_frame"),
}
# Whole numbers that may be missing; pandas would make them floats.
_WHOLE_NUMBERS = ("trial", "frame", "final_frame")
_ONE_ROW_A_MEASUREMENT = ("measurements.csv", "insertions.csv")
_STEPS = re.compile(r"steps-(\d+)\.csv")


def open_run(path: Path | str) -> "Run":
    """Open a run that is closed, interrupted or cut short.

    Parameters
    ----------
    path : Path or str
        Its folder.

    Returns
    -------
    Run
        `damage` lists what is missing or was changed. A changed picture is refused when it is read.

    Raises
    ------
    RecordError
        When it is no run, or its manifest is damaged.
    """
    folder = Path(path)
    manifest = read_manifest(folder)
    return Run(folder, manifest, tuple(find_damage(folder, manifest, read_pictures=False)))


class Run:
    """A run on disk, made by `open_run`. Only what has been asked for is in memory.

    Attributes
    ----------
    path : Path
        Its folder.
    manifest : dict
        The content of manifest.json.
    damage : tuple of Problem
        What is missing or was changed after it was written; a changed picture is found when it is read.
    """

    def __init__(self, path: Path, manifest: dict[str, Any], damage: tuple[Problem, ...] = ()) -> None:
        self.path = path
        self.manifest = manifest
        self.damage = damage
        self._until_s = math.inf

    def _repr_html_(self) -> str:
        """Return what the run is as a table, for a notebook; pandas escapes its text."""
        keys = ("experiment", "title", "exit_status", "reason", "started", "ended", "trials_planned")
        about = {key: self.manifest.get(key) for key in keys}
        about["damaged"] = [f"{problem.where}: {problem.message}" for problem in self.damage] or None
        return pd.Series(about, name=str(self.path), dtype=object).dropna().to_frame().to_html()

    def until(self, t_s: float) -> "Run":
        """Return this run as it was before rig time `t_s` [s]; pictures and truths stay."""
        before = Run(self.path, self.manifest, self.damage)
        before._until_s = t_s
        return before

    @property
    def sessions(self) -> tuple[Mapping[str, Any], ...]:
        """The sessions after the first: start, rig time zero `t0_s` [s], and code of each."""
        return tuple(self.manifest.get("sessions", ()))

    def find_moment(self, t_s: float) -> datetime | None:
        """Return the calendar time of a rig time [s], by its session; None if the run does not say when it began."""
        sessions = ({"t0_s": 0.0, "started": self.manifest.get("started")}, *self.sessions)
        session = max((one for one in sessions if one["t0_s"] <= t_s), key=lambda one: one["t0_s"])
        try:
            return datetime.fromisoformat(str(session["started"])) + timedelta(seconds=t_s - session["t0_s"])
        except ValueError:
            return None

    @cached_property
    def devices(self) -> Mapping[str, Any]:
        """What the devices said of themselves when the run began; empty without a rig."""
        lines = read_lines(inside(self.path, layout.DEVICE_LINES))
        return lines[0]["devices"] if lines else {}

    def lines(self, stream: str) -> list[dict[str, Any]]:
        """Return the lines of `states`, `events`, `frames` or `truth` as they were recorded.

        Raises
        ------
        RecordError
            When a line is damaged, a time is no number, or a picture is out of order; names file and line.
        """
        path = inside(self.path, f"{stream}.jsonl")
        if stream == "truth":
            return read_lines(path) if path.exists() else []
        lines: list[dict[str, Any]] = read_lines(path)
        for number, line in enumerate(lines):
            if type(line.get("t_s")) not in {float, int}:
                raise RecordError(f"{path}:{number + 1}: t_s is {line.get('t_s')!r}, no time [s]", COPY_HINT)
        return [line for line in lines if line["t_s"] < self._until_s]

    def read_events(self, *models: type[_Event]) -> tuple[_Event, ...]:
        """Return the events of the models' kinds, in the order of the record.

        Raises
        ------
        RecordError
            When a line is damaged or not what its model says; names file, line and field.
        """
        return tuple(parse_events(self.path, self.lines("events"), models))

    def read_trials(self, start: type[_Start], stop: type[_Stop]) -> tuple[RecordedTrial[_Start, _Stop], ...]:
        """Return the trials, also those that a person had left out; the last start of a repeated trial counts.

        Raises as `read_events`.
        """
        trials: dict[int, RecordedTrial[_Start, _Stop]] = {}
        for event in self.read_events(start, stop):
            if isinstance(event, start):
                left_out = self.decisions.explain_left_out(event.trial)
                trials[event.trial] = RecordedTrial(event, None, left_out)
            elif isinstance(event, stop) and event.trial in trials:
                trials[event.trial] = replace(trials[event.trial], stop=event)
        return tuple(trials.values())

    @cached_property
    def decisions(self) -> Decisions:
        """What a person skipped, repeated, marked as bad and noted during the run. Raises as `read_events`."""
        return fold_decisions(self.read_events(*READ))

    @property
    def pauses(self) -> tuple[PastPause, ...]:
        """The pauses of the run. Raises as `read_events`."""
        return list_pauses(self.read_events(Pause, Continue))

    def read_truth(self, model: type[_Truth]) -> Mapping[int, _Truth]:
        """Return what a simulated world drew, by trial; none of a real rig. Raises as `read_events`."""
        path = self.path / layout.TRUTH_LINES
        return {line.trial: line for line in parse_lines(path, self.lines("truth"), model)}

    @cached_property
    def frame_lines(self) -> tuple[FrameLine, ...]:
        """The line of each picture, by its number. Raises `RecordError` as `read_events`."""
        return tuple(picture.line for picture in self.pictures.places)

    @property
    def withdraws(self) -> str | None:
        """Name of the run whose needle this run withdrew; None if this is no withdrawal."""
        return self.manifest.get(layout.WITHDRAWS)

    @property
    def annotations(self) -> Annotations:
        """Tags, notes and verdict of the run as they are now. Raises `RecordError` when notes.json is damaged."""
        return read_annotations(self.path)

    @cached_property
    def protocol(self) -> Mapping[str, Any]:
        """The protocol as resolved for this run, a document; its experiment knows the model.

        Raises
        ------
        RecordError
            When protocol.yaml is missing or was changed.
        FileFormatError
            When it is no YAML.
        """
        return load_yaml_values(self.protocol_path)

    @property
    def protocol_path(self) -> Path:
        """The file of that protocol. Raises `RecordError` when it is missing or was changed."""
        return self._require_unchanged(layout.PROTOCOL)

    @property
    def plugin_packages(self) -> Mapping[str, str]:
        """The package and version that experiment, drives and camera of the run came from, by what each is."""
        return dict(self.manifest.get("plugins") or {})

    @property
    def rig_path(self) -> Path | None:
        """The rig file as resolved for this run; None without a rig. Raises as `protocol_path`."""
        return self._require_unchanged(layout.RIG) if layout.RIG in self.hashes else None

    @cached_property
    def rig(self) -> Mapping[str, Any]:
        """The rig file as resolved for this run, a document; empty without a rig. Raises as `protocol`."""
        return {} if self.rig_path is None else load_yaml_values(self.rig_path)

    @cached_property
    def states(self) -> pd.DataFrame:
        """The readings of the axes, one row each, with `t_s` [s] of rig time."""
        return self._read_table("states")

    @cached_property
    def events(self) -> pd.DataFrame:
        """The events, one row each, with `kind` and `t_s` [s] of rig time.

        Names of positions and speeds carry the unit of the axis: `position_mm`, `position_rad`.
        """
        return self._make_table("events", [add_axis_units(line) for line in self.lines("events")])

    @cached_property
    def truth(self) -> pd.DataFrame:
        """What a simulated world drew; empty on a real rig."""
        return self._read_table("truth")

    @cached_property
    def frame_table(self) -> pd.DataFrame:
        """The line of each picture; the row number is the number of the picture."""
        return self._read_table("frames")

    @cached_property
    def trials(self) -> pd.DataFrame:
        """One row a trial: the fields of its `trial_start` and of its `trial_stop`.

        Columns `trial`, `start_t_s`, `stop_t_s` [s], `exit_status` (`incomplete` while there is no stop),
        `final_frame` and the further fields of the two events. The last start of a repeated trial counts.
        """
        trials: dict[object, dict[str, object]] = {}
        for event in self.lines("events"):
            fields = {key: value for key, value in event.items() if key not in {"kind", "t_s", "seq"}}
            if event["kind"] == TrialStart.kind:
                trials[event["trial"]] = {"start_t_s": event["t_s"], "exit_status": INCOMPLETE, **fields}
            elif event["kind"] == TrialStop.kind and event["trial"] in trials:
                trials[event["trial"]] |= {"stop_t_s": event["t_s"], **fields}
        return self._make_table("trials", list(trials.values()))

    @cached_property
    def pictures(self) -> "Pictures":
        """The pictures in order, each an array (H, W) or (H, W, 3) of uint8, read and verified on access."""
        return Pictures(locate_pictures(self.path, self.lines("frames")))

    def read_frame(self, frame: int) -> NDArray[np.uint8]:
        """Return the picture with this number, an array (H, W) or (H, W, 3) of uint8.

        Raises
        ------
        RecordError
            When it is not in the record, is missing on disk, or was changed.
        """
        if 0 <= frame < len(self.pictures):
            return self.pictures[frame]
        held = f"{self.path / layout.FRAME_LINES} holds no frame {frame}; it holds {len(self.pictures)}"
        raise RecordError(held, "frames are numbered from 0")

    @cached_property
    def hashes(self) -> Mapping[str, str]:
        """The SHA-256 of each file that the run or a later session began with, by its name in the run."""
        return {name: sha256 for name, sha256 in read_sums(self.path).items() if is_opening_file(name)}

    @property
    def checksum(self) -> str | None:
        """The SHA-256 of SHA256SUMS, which stands for the whole record; None of a run that has not ended."""
        return read_checksum(self.path)

    @property
    def calibration_hashes(self) -> Mapping[str, str]:
        """The SHA-256 of each calibration file that the run began with, by its name."""
        place = f"{CALIBRATION}/"
        return {name.removeprefix(place): sha for name, sha in self.hashes.items() if name.startswith(place)}

    @property
    def calibration_files(self) -> tuple[str, ...]:
        """The names of the calibration files that the run began with; no other file in the folder is used."""
        return tuple(sorted(self.calibration_hashes))

    def calibration_path(self, name: str) -> Path:
        """Return the path of a calibration file of this run, also if it has none of this name.

        Raises
        ------
        RecordError
            When the run began with it and it is missing or was changed, or did not begin with it and it is there now.
        """
        relative = f"{CALIBRATION}/{require_name(name, 'the calibration file name')}"
        if name in self.calibration_files:
            return self._require_unchanged(relative)
        path = inside(self.path, relative)
        if path.is_file():
            message = f"{path} is no part of the record: the run began without it"
            raise RecordError(message, "move it out of the run")
        return path

    def own(self, relative: str) -> Path:
        """Return the path of a file or folder of this run, which need not exist.

        Raises
        ------
        RecordError
            When it, or a folder on the way to it, is a symbolic link.
        """
        return inside(self.path, relative)

    @property
    def result_numbers(self) -> tuple[int, ...]:
        """The numbers of the results in order."""
        return list_results(self.path)

    def result_dir(self, number: int) -> Path:
        """Return the folder of a result. Raises `RecordError` when a file in it was changed or added; names it."""
        return open_result(self.path, number)

    @property
    def result(self) -> Mapping[str, Any] | None:
        """The newest result, a document; None without one. Raises `RecordError` when it is damaged."""
        folder = self._newest_result_dir()
        return None if folder is None else read_result(folder)

    @property
    def measurements(self) -> pd.DataFrame:
        """The newest result's table of one row a measurement, with units in the names; empty without one.

        Raises `RecordError` when the result is damaged.
        """
        folder = self._newest_result_dir()
        named = () if folder is None else (folder / name for name in _ONE_ROW_A_MEASUREMENT)
        return next((read_result_table(path) for path in named if path.exists()), pd.DataFrame())

    @property
    def steps(self) -> pd.DataFrame:
        """The newest result's steps of steered insertions, one row each, in order of their trial.

        `depth_mm`, what was measured, estimated and believed of the tip, with units in the names; empty for other
        experiments, and without a result. Raises `RecordError` when the result is damaged.
        """
        folder = self._newest_result_dir()
        found = [] if folder is None else [(_STEPS.fullmatch(path.name), path) for path in folder.iterdir()]
        steps = sorted((int(match[1]), path) for match, path in found if match is not None)
        tables = [read_result_table(path).assign(trial=trial) for trial, path in steps]
        return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()

    def _newest_result_dir(self) -> Path | None:
        numbers = self.result_numbers
        return self.result_dir(numbers[-1]) if numbers else None

    def _read_table(self, name: str) -> pd.DataFrame:
        return self._make_table(name, self.lines(name))

    def _make_table(self, name: str, rows: Sequence[Mapping[str, object]]) -> pd.DataFrame:
        """Make a table with at least its columns; further ones follow in the order of the lines."""
        names = dict.fromkeys((*_COLUMNS[name], *(key for row in rows for key in row)))
        table = pd.DataFrame({key: [row.get(key) for row in rows] for key in names})
        whole = {key: "Int64" for key in _WHOLE_NUMBERS if key in names}
        try:
            return table.astype(whole)
        except (TypeError, ValueError) as error:
            what = f"{self.path}: {name}: {' or '.join(whole)} is no whole number: {error}"
            raise RecordError(what, COPY_HINT) from error

    def _require_unchanged(self, relative: str) -> Path:
        for problem in self.damage:
            if problem.where == relative:
                raise RecordError(f"{self.path / problem.where}: {problem.message}", problem.hint)
        return inside(self.path, relative)


class Pictures(Sequence[NDArray[np.uint8]]):
    """The pictures of a run, each read and compared with its SHA-256 on access; a slice reads none.

    `places` are their files, for processes that read them.
    """

    def __init__(self, places: tuple[RecordedPicture, ...]) -> None:
        self.places = places

    def __len__(self) -> int:
        return len(self.places)

    @overload
    def __getitem__(self, index: int) -> NDArray[np.uint8]: ...

    @overload
    def __getitem__(self, index: slice) -> "Pictures": ...

    def __getitem__(self, index: int | slice) -> "NDArray[np.uint8] | Pictures":
        if isinstance(index, slice):
            return Pictures(self.places[index])
        return self.places[index].read()


_TEXTS = {"specimen": str, "needle_id": str}
"""Columns of names, which may look like numbers."""


def read_result_table(path: Path) -> pd.DataFrame:
    """Return a table of a result, as the analysis wrote it. Raises `RecordError` when it is no table."""
    try:
        table = pd.read_csv(path, dtype=_TEXTS, keep_default_na=False, na_values=[""])
    except (OSError, ValueError) as error:
        raise RecordError(f"{path} is damaged: {error}", "make a new one with labrig reanalyze") from error
    texts = [name for name in table.columns if not pd.api.types.is_numeric_dtype(table[name])]
    return table.assign(**{
        name: table[name].map(lambda cell: unescape_formula(cell) if isinstance(cell, str) else cell)
        for name in texts
    })  # fmt: skip
