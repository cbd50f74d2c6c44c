"""Read a run that is closed, interrupted or cut short; damage is refused with its place."""

import atexit
import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from datetime import datetime, timedelta
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from labrig.errors import Problem, RecordError
from labrig.protocol.yaml_tree import load_yaml_values
from labrig.record.annotations import Annotations, read_annotations, without_authors
from labrig.record.can_log import CanFrame, read_can_log
from labrig.record.chain import scan_chain
from labrig.record.check import (
    as_damage,
    find_changes_since_closing,
    find_changes_since_start,
    find_links,
    find_picture_problems,
    leave_out_named,
)
from labrig.record.decisions import READ, Decisions, PastPause, fold_decisions, list_pauses
from labrig.record.digest import hash_file
from labrig.record.events import (
    Continue,
    Event,
    FrameLine,
    Pause,
    RecordedTrial,
    TrialStart,
    TrialStop,
    TruthLine,
    join_trials,
    parse_events,
    parse_frame_lines,
    parse_truth_lines,
)
from labrig.record.json_lines import check_lines, make_readable, read_lines
from labrig.record.layout import (
    ANALYSIS,
    CALIBRATION,
    COPY_HINT,
    EVENT_LINES,
    FRAME_LINES,
    FRAMES,
    PROTOCOL,
    RIG,
    STATE_LINES,
    TRIAL_START,
    TRIAL_STOP,
    TRUTH_LINES,
    WITHDRAWS,
    inside,
    require_name,
)
from labrig.record.manifest import check_manifest, read_manifest, recorded_sha256
from labrig.record.notebook import make_html_table
from labrig.record.pictures import RecordedPicture, locate_picture
from labrig.record.provenance import leave_out_personal
from labrig.record.results import (
    latest_result,
    list_results,
    new_result_dir,
    require_unchanged_result,
)
from labrig.record.seal import find_changes_since_sealing, find_unused
from labrig.record.sealing import list_files, seal_files
from labrig.record.structure import find_clock_problems, find_frame_problems
from labrig.record.tables import add_axis_units
from labrig.record.urls import fetch_run, is_url, restore_url

_Event = TypeVar("_Event", bound=Event)
_Truth = TypeVar("_Truth", bound=TruthLine)
_Start = TypeVar("_Start", bound=TrialStart)
_Stop = TypeVar("_Stop", bound=TrialStop)

# Also a table without rows has these columns.
_COLUMNS = {
    STATE_LINES: ("t_s",),
    EVENT_LINES: ("kind", "t_s"),
    FRAME_LINES: ("frame", "file", "sha256", "t_s", "trial", "role"),
    TRUTH_LINES: ("trial",),
}
_TRIAL_COLUMNS = ("trial", "start_t_s", "stop_t_s", "exit_status", "final_frame")
# Whole numbers that may be missing; pandas would make them floats.
_WHOLE_NUMBERS = ("trial", "frame", "final_frame")
_MOVE_OUT = "move it out of the run; labrig runs check lists all such files"


def open_run(path: Path | str, *, read_pictures: bool = False) -> "Run":
    """Open a run that is closed, interrupted or cut short.

    Parameters
    ----------
    path : Path or str
        Its folder, or a URL that fsspec knows. A run behind a URL is copied into a temporary folder, which lasts until
        the process ends.
    read_pictures : bool
        Also read every picture and compare its hash, so that `damage` names those that were changed. Without it, a
        changed picture is refused when it is read.

    Returns
    -------
    Run
        `problems` lists what is missing or was changed.

    Raises
    ------
    RecordError
        When it is no run, has a newer schema, or has a damaged line; names file and line.
    """
    folder = fetch_folder(path)
    manifest = read_manifest(folder)
    for name in recorded_sha256(manifest):
        inside(folder, name)  # refuses a link
    lines = _find_line_files(folder)
    can_log = read_can_log(folder)
    torn = (*(problem for file in lines.values() for problem in check_lines(file)), *can_log.torn)
    damage = (
        *can_log.damaged,
        *check_manifest(manifest),
        *find_changes_since_start(folder, manifest),
        *find_links(folder, inside(folder, FRAMES)),
        *find_picture_problems(
            folder, read_lines(lines[FRAME_LINES]), look="once" if read_pictures else "presence"
        ),
    )
    if manifest.get("exit_status") != "incomplete":
        damage = (*damage, *as_damage(torn), *find_changes_since_closing(folder, lines_only=True))
        torn = ()
    chain = scan_chain(folder)
    seal = leave_out_named(find_changes_since_sealing(folder, manifest, chain), damage)
    return Run(folder, manifest, (*damage, *seal), (*torn, *find_unused(folder, chain)))


def fetch_folder(path: Path | str) -> Path:
    """Return the folder of a run, or that of a local copy if it is behind a URL. Raises as `fetch_run`."""
    if not is_url(path):
        return Path(path)
    copy = tempfile.TemporaryDirectory(prefix="labrig-")
    atexit.register(copy.cleanup)
    return fetch_run(restore_url(path), Path(copy.name))


class Run:
    """A run on disk, made by `open_run`. Only what has been asked for is in memory.

    Attributes
    ----------
    path : Path
        Its folder.
    manifest : dict
        The content of manifest.json.
    damage : tuple of Problem
        What is missing or was changed after it was written. A changed picture is found when it is read, or on opening
        with `read_pictures`.
    problems : tuple of Problem
        The damage, and what is no damage: the torn last lines of a killed run, and results and annotations without a
        link in chain.jsonl, which are not used. Empty for a run that is as it was written.
    private : bool
        Whether personal data is left out; see `without_personal_data`.
    """

    def __init__(
        self,
        path: Path,
        manifest: dict[str, object],
        damage: tuple[Problem, ...],
        torn: tuple[Problem, ...] = (),
        *,
        until_s: float = math.inf,
    ) -> None:
        self.path = path
        self.manifest = make_readable(manifest)
        self.damage = damage
        self.problems = (*damage, *torn)
        self._torn = torn
        self._until_s = until_s
        self.private = False

    def _repr_html_(self) -> str:
        """Return what the run is as a table, for a notebook."""
        about = ("experiment", "title", "exit_status", "reason", "started", "ended")
        rows: list[tuple[str, object]] = [(key, self.manifest.get(key)) for key in about]
        rows.append(
            ("trials", f"{self.manifest.get('trials_done')} of {self.manifest.get('trials_planned')}")
        )
        rows.append(("results", ", ".join(map(str, self.result_numbers)) or "none"))
        rows += [("problem", f"{problem.where}: {problem.message}") for problem in self.problems]
        return make_html_table(f"Run {self.shown_path}", rows)

    def until(self, t_s: float) -> "Run":
        """Return this run as it was before rig time `t_s` [s]; pictures and truths stay."""
        return Run(self.path, self.manifest, self.damage, self._torn, until_s=t_s)

    def without_personal_data(self) -> "Run":
        """Return this run without host, account, command line, its own folder, and the authors of remarks."""
        private = copy(self)
        private.manifest = leave_out_personal(self.manifest)
        private.private = True
        return private

    @property
    def shown_path(self) -> str:
        """The run as commands on a page name it: its folder, or only its name if that is private."""
        return self.path.name if self.private else str(self.path)

    @property
    def sessions(self) -> tuple[Mapping[str, Any], ...]:
        """The sessions after the first: start, rig time zero `t0_s` [s], code and devices of each."""
        sessions = self.manifest.get("sessions", [])
        if not isinstance(sessions, list) or not all(isinstance(session, dict) for session in sessions):
            raise RecordError(f"{self.path}: sessions of the manifest are no list of objects", COPY_HINT)
        return tuple(sessions)

    def find_moment(self, t_s: float) -> datetime | None:
        """Return the calendar time of a rig time [s], by its session; None if the run does not say when it began."""
        sessions = [
            (0.0, self.manifest.get("started")),
            *((float(session.get("t0_s", 0)), session.get("started")) for session in self.sessions),
        ]
        t0_s, started = max(
            (session for session in sessions if session[0] <= t_s), key=lambda session: session[0]
        )
        try:
            return datetime.fromisoformat(str(started)) + timedelta(seconds=t_s - t0_s)
        except ValueError:
            return None

    def lines(self, stream: str) -> list[dict[str, Any]]:
        """Return the lines of `states`, `events`, `frames` or `truth` as they were recorded.

        Raises
        ------
        RecordError
            When a line is damaged, the clock goes backwards, or a picture is missing, listed twice or in the wrong
            place; names file and line.
        """
        name = f"{stream}.jsonl"
        path = self._lines.get(name)
        lines = [] if path is None else read_lines(path)
        numbered = tuple(enumerate(lines, start=1))
        timed = "t_s" in _COLUMNS[name]
        problems = chain(
            find_clock_problems(name, numbered) if timed else (),
            find_frame_problems(numbered) if name == FRAME_LINES else (),
        )
        if (first := next(problems, None)) is not None:
            raise RecordError(f"{self.path / first.where}: {first.message}", first.hint)
        return [line for line in lines if float(str(line["t_s"])) < self._until_s] if timed else lines

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
        trials: tuple[RecordedTrial[_Start, _Stop], ...] = join_trials(
            parse_events(self.path, self.lines("events"), (start, stop))
        )
        left_out = self.decisions.explain_left_out
        return tuple(replace(trial, left_out=left_out(trial.start.trial)) for trial in trials)

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
        return {line.trial: line for line in parse_truth_lines(self.path, self.lines("truth"), model)}

    @cached_property
    def frame_lines(self) -> tuple[FrameLine, ...]:
        """The line of each picture, by its number. Raises `RecordError` as `read_events`."""
        return tuple(parse_frame_lines(self.path, self.lines("frames")))

    @property
    def withdraws(self) -> str | None:
        """Name of the run whose needle this run withdrew; None if this is no withdrawal."""
        name = self.manifest.get(WITHDRAWS)
        return name if isinstance(name, str) else None

    @property
    def annotations(self) -> Annotations:
        """Tags, notes and verdict of the run as they are now. Raises `RecordError` when a line is damaged."""
        annotations = read_annotations(self.path)
        return without_authors(annotations) if self.private else annotations

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
        return self._require_unchanged(PROTOCOL)

    @property
    def plugin_packages(self) -> Mapping[str, str]:
        """The package and version that experiment, drives and camera of the run came from, by what each is."""
        packages = self.manifest.get("plugins")
        return (
            {str(name): str(package) for name, package in packages.items()}
            if isinstance(packages, Mapping)
            else {}
        )

    @property
    def rig_path(self) -> Path | None:
        """The rig file as resolved for this run; None without a rig. Raises as `protocol_path`."""
        return self._require_unchanged(RIG) if RIG in recorded_sha256(self.manifest) else None

    @property
    def can_frames(self) -> Iterator[CanFrame]:
        """The CAN frames sent and received, in order. Raises `RecordError` when they are damaged."""
        return read_can_log(self.path).frames()

    @cached_property
    def states(self) -> pd.DataFrame:
        """The readings of the axes, one row each, with `t_s` [s] of rig time."""
        return self._read_table(STATE_LINES)

    @cached_property
    def events(self) -> pd.DataFrame:
        """The events, one row each, with `kind` and `t_s` [s] of rig time.

        Names of positions and speeds carry the unit of the axis: `position_mm`, `position_rad`.
        """
        lines = self.lines("events")
        rows = [add_axis_units(line) for line in lines]
        return _make_table(rows, _COLUMNS[EVENT_LINES], self.path / EVENT_LINES)

    @cached_property
    def truth(self) -> pd.DataFrame:
        """What a simulated world drew; empty on a real rig."""
        return self._read_table(TRUTH_LINES)

    @cached_property
    def frame_table(self) -> pd.DataFrame:
        """The line of each picture; the row number is the number of the picture."""
        return self._read_table(FRAME_LINES)

    @cached_property
    def pictures(self) -> tuple[RecordedPicture, ...]:
        """The place of each picture, by its number."""
        places = (locate_picture(self.path, line) for line in self.lines("frames"))
        return tuple(place for place in places if place is not None)

    @cached_property
    def trials(self) -> pd.DataFrame:
        """One row a trial: the fields of its `trial_start` and of its `trial_stop`.

        Columns `trial`, `start_t_s`, `stop_t_s` [s], `exit_status` (`incomplete` while there is no stop),
        `final_frame` and the further fields of the two events. The last start of a repeated trial counts.
        """
        rows = _join_trial_rows(self.lines("events"))
        return _make_table(rows, _TRIAL_COLUMNS, self._lines[EVENT_LINES])

    @cached_property
    def frames(self) -> "Frames":
        """The pictures in order, each read on access."""
        return Frames(self.pictures)

    def frame_line(self, frame: int) -> FrameLine:
        """Return the line of the picture with this number. Raises `RecordError` when it is not in the record."""
        if not 0 <= frame < len(self.frame_lines):
            raise RecordError(
                f"{self.path / FRAME_LINES} holds no frame {frame}; it holds {len(self.frame_lines)}",
                COPY_HINT,
            )
        return self.frame_lines[frame]

    def read_frame(self, frame: int) -> NDArray[np.uint8]:
        """Return the picture with this number, an array (H, W) or (H, W, 3) of uint8.

        Raises
        ------
        RecordError
            When it is not in the record, is missing on disk, or was changed.
        """
        if not 0 <= frame < len(self.frames):
            raise RecordError(
                f"{self.path} holds no frame {frame}; it holds {len(self.frames)}",
                "it was interrupted before",
            )
        return self.frames[frame]

    @property
    def calibration_files(self) -> tuple[str, ...]:
        """The names of the calibration files that the run began with; no other file in the folder is used."""
        folder = f"{CALIBRATION}/"
        names = recorded_sha256(self.manifest)
        return tuple(sorted(name.removeprefix(folder) for name in names if name.startswith(folder)))

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
            raise RecordError(f"{path} is no part of the record: the run began without it", _MOVE_OUT)
        return path

    def own(self, relative: str) -> Path:
        """Return the path of a file or folder of this run, which need not exist.

        Raises
        ------
        RecordError
            When it, or a folder on the way to it, is a symbolic link.
        """
        return inside(self.path, relative)

    def new_result_dir(self) -> Path:
        """Make and return the next of analysis/001, 002 ... Raises `DiskError`."""
        return new_result_dir(self.path)

    @property
    def result_numbers(self) -> tuple[int, ...]:
        """The numbers of the results in order. Raises `RecordError` when the chain is damaged."""
        return list_results(self.path)

    def result_dir(self, number: int) -> Path:
        """Return the folder of a result. Raises `RecordError` when a file in it was changed or added; names it."""
        require_unchanged_result(self.path, number)
        return inside(self.path, f"{ANALYSIS}/{number:03d}")

    def seal_result(self, folder: Path, created: str) -> None:
        """Append the link over a result that is complete. Raises `DiskError`."""
        names = list_files(self.path, folder.relative_to(self.path).as_posix())
        seal_files(self.path, "result", names, created)

    def seal_page(self, path: Path, created: datetime) -> None:
        """Append the link over a page or view that was written into the run. Raises `DiskError`."""
        seal_files(self.path, "page", (path.name,), created)

    def latest_result(self) -> dict[str, object] | None:
        """Return the newest result.json; None without one. Raises `RecordError` when it is damaged."""
        return latest_result(self.path)

    @cached_property
    def _lines(self) -> dict[str, Path]:
        return _find_line_files(self.path)

    def _read_table(self, name: str) -> pd.DataFrame:
        return _make_table(self.lines(name.removesuffix(".jsonl")), _COLUMNS[name], self.path / name)

    def _require_unchanged(self, relative: str) -> Path:
        path = inside(self.path, relative)
        if hash_file(path) != recorded_sha256(self.manifest).get(relative):
            changed = "is not what the run began with: its SHA-256 does not fit the manifest"
            raise RecordError(f"{path} {changed}", COPY_HINT)
        return path


class Frames(Sequence[NDArray[np.uint8]]):
    """The pictures of a run, each read and checked against its SHA-256 on access; a slice reads none."""

    def __init__(self, pictures: tuple[RecordedPicture, ...]) -> None:
        self._pictures = pictures

    def __len__(self) -> int:
        return len(self._pictures)

    @overload
    def __getitem__(self, index: int) -> NDArray[np.uint8]: ...

    @overload
    def __getitem__(self, index: slice) -> "Frames": ...

    def __getitem__(self, index: int | slice) -> "NDArray[np.uint8] | Frames":
        if isinstance(index, slice):
            return Frames(self._pictures[index])
        return self._pictures[index].read()


def _find_line_files(run: Path) -> dict[str, Path]:
    """Return the line files of a run by name; only a simulated run has truth."""
    files = {name: inside(run, name) for name in _COLUMNS}
    return {name: path for name, path in files.items() if name != TRUTH_LINES or path.exists()}


def _make_table(rows: Sequence[Mapping[str, object]], columns: tuple[str, ...], path: Path) -> pd.DataFrame:
    """Make a table with at least these columns; further ones follow in the order of the lines."""
    names = dict.fromkeys((*columns, *(name for row in rows for name in row)))
    table = pd.DataFrame({name: [row.get(name) for row in rows] for name in names})
    whole = {name: "Int64" for name in _WHOLE_NUMBERS if name in names}
    try:
        return table.astype(whole)
    except (TypeError, ValueError) as error:
        raise RecordError(f"{path}: {' or '.join(whole)} is no whole number: {error}", COPY_HINT) from error


def _join_trial_rows(events: Iterable[dict[str, object]]) -> list[dict[str, object]]:
    trials: dict[object, dict[str, object]] = {}
    for event in events:
        fields = {key: value for key, value in event.items() if key not in {"kind", "t_s", "seq"}}
        trial = event.get("trial")
        if event.get("kind") == TRIAL_START:
            trials[trial] = {"start_t_s": event.get("t_s"), "exit_status": "incomplete", **fields}
        elif event.get("kind") == TRIAL_STOP and trial in trials:
            trials[trial] |= {"stop_t_s": event.get("t_s"), **fields}
    return list(trials.values())
