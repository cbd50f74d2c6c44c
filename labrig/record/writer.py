"""Write a run while it happens, so that it can be read whatever stops it."""

import hashlib
import math
import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from labrig.durable import (
    disk_errors,
    find_temporaries,
    free_bytes,
    open_descriptor,
    sync_directory,
    write_and_rename,
    write_atomically,
)
from labrig.errors import DiskError, InputError, LabrigError, OutputExistsError, RecordError
from labrig.input_file import read_file
from labrig.record import layout
from labrig.record.check import find_damage
from labrig.record.events import Event, count_trials_done
from labrig.record.json_lines import LineFile, encode_line, encode_manifest, read_lines
from labrig.record.lock import FileLock
from labrig.record.pictures import PictureWriter, Store
from labrig.record.rounds import Rounds

EXIT_STATUSES = ("success", "aborted", "failed")

# How many periods the disk may take for one round of fsyncs. A wait holds up the procedure, and a disk that other
# programs keep busy is usually fast again after some seconds.
_MOST_PERIODS_BEHIND = 10
_PICTURE = re.compile(r"\d{6,}\.(png|pgm|ppm)")
_RESERVE_BYTES = 2**20
"""On a full disk this still holds the last lines, SHA256SUMS (83 bytes a picture), and the manifest with the cause."""

_Created = TypeVar("_Created")


def opening_files(
    protocol_yaml: str,
    rig_yaml: str | None = None,
    calibration: Mapping[str, Path | bytes] | None = None,
    code_diff: bytes = b"",
) -> dict[str, bytes]:
    """Return what a run begins with, by its name in the run.

    Parameters
    ----------
    protocol_yaml, rig_yaml : str
        As resolved; None without a rig.
    calibration : Mapping
        File name to content, or to the file to copy.
    code_diff : bytes
        Changes of the code, as from `collect_code_diff`.

    Raises
    ------
    InputError
        When a name is invalid or a file cannot be read.
    """
    files = {layout.PROTOCOL: protocol_yaml.encode()}
    if rig_yaml is not None:
        files[layout.RIG] = rig_yaml.encode()
    if code_diff:
        files[layout.CODE_DIFF] = code_diff
    for name, source in (calibration or {}).items():
        file = f"{layout.CALIBRATION}/{layout.require_name(name, 'the calibration file name')}"
        files[file] = source if isinstance(source, bytes) else _read_source(source)
    return files


def _read_source(source: Path) -> bytes:
    try:
        return read_file(source)
    except OSError as error:
        message = f"cannot read the calibration file {source}: {error.strerror}"
        raise InputError(message, "check the rig file") from error


class Recorder:
    """The record of a running experiment, locked and open for appending; made by `create`, ended by `close`.

    What can be lost. A line is in the kernel before its call returns, and a picture is complete under its name before
    its line is written: killing the process loses nothing that was acknowledged. A thread of its own fsyncs pictures,
    then lines, whenever the rig time of a call passes a multiple of `fsync_period_s`, and on closing. So a power cut
    loses at most the lines and pictures of the last two periods, and may tear the last line. If the disk takes longer
    than a period, it loses that much more; after `_MOST_PERIODS_BEHIND` the call waits.

    It goes on from the lines that stand in the folder: rig time from the next whole second, pictures and lines from the
    next number.

    Attributes
    ----------
    path : Path
        The folder of the run.
    run_name : str
        Its name.
    """

    def __init__(self, path: Path, lock: FileLock, manifest: Mapping[str, Any]) -> None:
        self.path = path
        self.run_name = path.name
        self._lock = lock
        self._manifest = dict(manifest)
        self._recording = self._manifest["recording"]
        self._pictures = PictureWriter(path, self._recording["picture_store"])
        _make_reserve(path)
        optional = [name for name in (layout.TRUTH_LINES, layout.CAN_LOG) if (path / name).exists()]
        names = (*layout.ALWAYS_PRESENT, layout.DEVICE_LINES, *optional)
        self._lines = {name: LineFile(path / name) for name in names}
        frames = read_lines(path / layout.FRAME_LINES)
        sequenced = [name for name in names if name in layout.SEQUENCED]
        lines: list[dict[str, Any]] = [line for name in sequenced for line in read_lines(path / name)]
        self._sums = layout.read_sums(path) | {str(line["file"]): str(line["sha256"]) for line in frames}
        self._frames = len(frames)
        self._seq = 1 + max((line["seq"] for line in lines), default=-1)
        self._t0_s = 1.0 + math.floor(max((line.get("t_s", -1.0) for line in lines), default=-1.0))
        self._period = int(self._t0_s // self._recording["fsync_period_s"])
        self._appending = Lock()
        self._rounds = Rounds(_MOST_PERIODS_BEHIND)
        self._closed = False

    @classmethod
    def create(
        cls,
        runs_dir: Path,
        run_name: str,
        manifest: Mapping[str, Any],
        files: Mapping[str, bytes],
        *,
        fsync_period_s: float = 1.0,
        least_free_bytes: int = 0,
        picture_store: Store = "png",
    ) -> Self:
        """Begin a run: make its folder and write everything that is known before anything moves.

        Parameters
        ----------
        runs_dir : Path
            Folder of runs; made if absent.
        run_name : str
            Name of the new folder in it.
        manifest : Mapping
            `experiment` and `started` (ISO 8601) at least; `title`, `trials_planned`, `seed`, `operator`, `protocol`
            and `provenance` are expected, others are kept. `devices` goes into devices.jsonl.
        files : Mapping
            What the run begins with, as from `opening_files`.
        fsync_period_s : float
            Rig time between two fsyncs [s].
        least_free_bytes : int
            The run ends when the disk has less free space than this; checked with each fsync.
        picture_store : {"png", "pgm"}
            How pictures are kept; see `labrig.record.pictures`.

        Raises
        ------
        InputError
            When the name is invalid, or the manifest holds what JSON cannot hold.
        OutputExistsError
            When the folder exists; it is not touched.
        DiskError
            When it cannot be written; nothing is left behind.
        """
        recording = {
            "fsync_period_s": fsync_period_s,
            "least_free_bytes": least_free_bytes,
            "picture_store": picture_store,
        }
        opening = _make_opening_manifest(run_name, manifest, recording)
        document = encode_manifest(opening)
        path = runs_dir / layout.require_name(run_name, "the run name")
        _make_run_directory(path)
        try:
            with disk_errors(path):
                lock = FileLock(path / layout.LOCK).acquire("labrig run")
                for folder in (layout.FRAMES, layout.CALIBRATION):
                    (path / folder).mkdir()
                for name, content in files.items():
                    write_and_rename(path / name, content)
                sync_directory(path / layout.CALIBRATION)
                sums = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
                write_atomically(path / layout.SHA256SUMS, layout.encode_sums(sums))
                recorder = cls(path, lock, opening)
                recorder._begin_devices(manifest.get("devices"))
                # Written last, so that a folder with a manifest has everything else.
                write_atomically(path / layout.MANIFEST, document)
                sync_directory(runs_dir)
        except LabrigError:
            shutil.rmtree(path, ignore_errors=True)
            raise
        return recorder

    def begin_session(
        self, started: datetime, *, code_diff: bytes = b"", devices: object = None, **fields: object
    ) -> float:
        """Add a session to a reopened run, with its code and devices, and return its rig time zero [s].

        Parameters
        ----------
        started : datetime
            Aware.
        code_diff : bytes
            As in `opening_files`; stored as code.002.diff, 003 ...
        devices : object
            What the devices say of themselves.
        **fields
            Further members of the session in the manifest: `provenance` is expected.

        Raises
        ------
        DiskError
            When it cannot be written; the run stays `incomplete`, and readable.
        """
        sessions = self._manifest.get("sessions", [])
        session = {"started": _format_utc(started), "t0_s": self._t0_s, **fields}
        with self._guard_disk(self.path):
            if code_diff:
                name = session["code_diff"] = f"code.{len(sessions) + 2:03d}.diff"
                write_atomically(self.path / name, code_diff)
                self._sums[name] = hashlib.sha256(code_diff).hexdigest()
            self._manifest["sessions"] = [*sessions, session]
            write_atomically(self.path / layout.MANIFEST, encode_manifest(self._manifest))
        self._begin_devices(devices)
        return self._t0_s

    def _begin_devices(self, devices: object) -> None:
        self._write_line(layout.DEVICE_LINES, {"when": "begin", "t_s": self._t0_s, "devices": devices or {}})

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:
        """Record a picture and return its number.

        Parameters
        ----------
        image : array (H, W) or (H, W, 3) of uint8
            Grey or BGR.
        t_s : float
            Rig time of the exposure [s].
        **fields
            Further members of its line in frames.jsonl.

        Raises
        ------
        InputError
            When the array has another shape or type.
        DiskError
            When it cannot be written; the record stays whole.
        """
        self._require_open()
        number = self._frames
        with self._guard_disk(self.path):
            file, sha256 = self._pictures.write(number, image)
        self._append(layout.FRAME_LINES, t_s, {"frame": number, "file": file, "sha256": sha256}, fields)
        self._sums[file] = sha256
        self._frames += 1
        return number

    def state(self, t_s: float, **fields: object) -> None:
        """Append a reading of the axes at rig time `t_s` [s]. Raises as `event` does."""
        self._append(layout.STATE_LINES, t_s, {}, fields)

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Append an event at rig time `t_s` [s]; `trial_start` and `trial_stop` delimit the trials.

        Raises
        ------
        DiskError
            When it cannot be written; the record stays whole.
        """
        self._append(layout.EVENT_LINES, t_s, {"kind": kind}, fields)

    def record_event(self, event: Event, t_s: float) -> None:
        """Append an event at rig time `t_s` [s]. Raises as `event` does."""
        self.event(event.kind, t_s, **event.line_fields())

    def truth(self, **fields: object) -> None:
        """Append what a simulated world drew; the first line makes the file. Raises as `event` does."""
        self._write_line(layout.TRUTH_LINES, fields)

    def can_frames(self, frames: Iterable[tuple[float, int, bytes, str]]) -> None:
        """Append CAN frames to can.log in candump's format; the first makes the file.

        Parameters
        ----------
        frames : iterable of tuple
            Rig time [s], COB-ID, data, and T or R for sent or received.

        Raises
        ------
        DiskError
            When it cannot be written; the record stays whole.
        """
        lines = "".join(
            f"({self._t0_s + t_s:.6f}) can {i:03X}#{data.hex().upper()} {way}\n"
            for t_s, i, data, way in frames
        )
        if lines:
            self._write(layout.CAN_LOG, lines.encode())

    def close(self, exit_status: str, reason: str, ended: datetime, **manifest_updates: object) -> None:
        """End the run: write SHA256SUMS of everything, then the manifest that says how it ended.

        A second call does nothing.

        Parameters
        ----------
        exit_status : {"success", "aborted", "failed"}
            How it ended.
        reason : str
            The cause in a sentence; empty after a success.
        ended : datetime
            Aware.
        **manifest_updates
            Further keys of the manifest; `devices_after` goes into devices.jsonl.

        Raises
        ------
        DiskError
            When it cannot be written; the run stays `incomplete`, and readable.
        """
        if exit_status not in EXIT_STATUSES:
            raise InputError(f"exit_status is {exit_status!r}; it must be one of {', '.join(EXIT_STATUSES)}")
        if self._closed:
            return
        after = manifest_updates.pop("devices_after", None)
        ending = {"exit_status": exit_status, "reason": reason, "ended": _format_utc(ended)}
        try:
            if after is not None:
                self._write_line(layout.DEVICE_LINES, {"when": "end", "devices": after})
            self._finish(self._manifest | ending | manifest_updates)
        finally:
            self._closed = True
            self._rounds.close()
            for lines in self._lines.values():
                lines.close()
            self._lock.release()

    def _finish(self, manifest: dict[str, Any]) -> None:
        with self._guard_disk(self.path):
            self._rounds.finish()
            self._sync()
        self._release_reserve()
        done = count_trials_done(self.path, read_lines(self.path / layout.EVENT_LINES))
        document = encode_manifest(manifest | {"summary": {"trials_done": done, "pictures": self._frames}})
        sums = self._sums | {name: lines.sha256 for name, lines in self._lines.items()}
        sums[layout.MANIFEST] = hashlib.sha256(document).hexdigest()
        write_atomically(self.path / layout.SHA256SUMS, layout.encode_sums(sums))
        write_atomically(self.path / layout.MANIFEST, document)

    def _append(
        self, name: str, t_s: float, first: Mapping[str, object], fields: Mapping[str, object]
    ) -> None:
        """Append a line of rig time `t_s`, and start an fsync when that begins a new period."""
        if not math.isfinite(t_s):
            raise InputError(f"a line of {name} has the time {t_s}; rig time is a finite number of seconds")
        self._write_line(name, {**first, "t_s": self._t0_s + t_s, **fields})
        period = int((self._t0_s + t_s) // self._recording["fsync_period_s"])
        if period > self._period:
            self._period = period
            with self._guard_disk(self.path):
                self._require_free_space()
                self._rounds.begin(self._sync)

    def _write_line(self, name: str, fields: Mapping[str, object]) -> None:
        self._write(name, encode_line({**fields, "seq": self._seq} if name in layout.SEQUENCED else fields))
        self._seq += name in layout.SEQUENCED

    def _write(self, name: str, lines: bytes) -> None:
        """Append lines to a file, which the first of them makes."""
        self._require_open()
        held = self._appending if name == layout.FRAME_LINES else nullcontext()
        with self._guard_disk(self.path / name), held:
            if name not in self._lines:
                self._lines[name] = LineFile(self.path / name)
            self._lines[name].append(lines)

    def _require_free_space(self) -> None:
        """Stop the run before the disk is so full that other programs on this computer cannot write either."""
        free, least = free_bytes(self.path), self._recording["least_free_bytes"]
        if free < least:
            raise DiskError(
                f"the disk of {self.path} has {free / 1e6:.1f} MB free; a run ends below {least / 1e6:.1f} MB",
                "make room on that disk, or keep the runs on another one",
            )

    def _require_open(self) -> None:
        if self._closed:
            raise RecordError(f"{self.path} is closed; nothing can be added to it")

    @contextmanager
    def _guard_disk(self, path: Path) -> Iterator[None]:
        """Turn a fault of the disk into a `DiskError` and free the reserve for the last lines of the run."""
        try:
            with disk_errors(path):
                yield
        except DiskError:
            self._release_reserve()
            raise

    def _sync(self) -> None:
        """Force everything written so far to disk, no line of a picture before the picture.

        Pictures are forced first, while more are taken. Then no picture's line is appended while the last pictures and
        those lines follow; all other lines go on.
        """
        frames = self._lines[layout.FRAME_LINES]
        others = [lines for lines in list(self._lines.values()) if lines is not frames]
        self._pictures.sync()
        with self._appending:
            self._pictures.sync()
            frames.sync()
        for lines in others:
            lines.sync()

    def _release_reserve(self) -> None:
        # If even this fails, the fault of the disk is being raised already.
        with suppress(OSError):
            (self.path / layout.RESERVE).unlink()


def reopen_run(path: Path, doing: str) -> Recorder:
    """Open the record of an interrupted run for appending.

    Rig time goes on from the next whole second after the last one recorded.

    Parameters
    ----------
    path : Path
        Folder of a run that has not ended in success.
    doing : str
        The command that asks, as others read it in the lock.

    Raises
    ------
    RecordError
        When it is no run, has succeeded, or is damaged; nothing is changed.
    LockedError
        When another process writes it.
    DiskError
        When it cannot be written.
    """
    layout.read_manifest(path)
    lock = FileLock(layout.inside(path, layout.LOCK)).acquire(doing)
    try:
        return _reopen(path, lock)
    except LabrigError:
        lock.release()
        raise


def close_interrupted_run(path: Path, doing: str, ended: datetime, exit_status: str, reason: str) -> None:
    """Close a run that was interrupted after its last trial. Raises as `reopen_run`."""
    recorder = reopen_run(path, doing)
    recorder.event("run_stop", 0.0, exit_status=exit_status, reason=reason)
    recorder.close(exit_status, reason, ended)


def _reopen(path: Path, lock: FileLock) -> Recorder:
    manifest = layout.read_manifest(path)
    for problem in find_damage(path, manifest, read_pictures=True):
        message = f"{path} is damaged: {problem.where}: {problem.message}"
        raise RecordError(message, "labrig runs check lists all; nothing was changed")
    if manifest["exit_status"] == "success":
        raise RecordError(f"{path} has come to its end; nothing can be added to it")
    reopened = manifest | {"exit_status": layout.INCOMPLETE, "reason": None, "ended": None, "summary": None}
    opening = {name: sha for name, sha in layout.read_sums(path).items() if layout.is_opening_file(name)}
    with disk_errors(path):
        _drop_leftovers(path)
        write_atomically(path / layout.MANIFEST, encode_manifest(reopened))
        write_atomically(path / layout.SHA256SUMS, layout.encode_sums(opening))
        return Recorder(path, lock, reopened)


def _drop_leftovers(path: Path) -> None:
    """Remove temporary files, and pictures whose lines were not written: nothing of them was acknowledged."""
    for folder in (path, path / layout.CALIBRATION, path / layout.FRAMES):
        for left in find_temporaries(folder):
            left.unlink()
    listed = {line["file"] for line in read_lines(path / layout.FRAME_LINES)}
    for picture in sorted((path / layout.FRAMES).iterdir()):
        if _PICTURE.fullmatch(picture.name) and f"{layout.FRAMES}/{picture.name}" not in listed:
            picture.unlink()


def require_free_name(runs_dir: Path, run_name: str) -> None:
    """Refuse the name of a run that exists already, before any work. Raises `OutputExistsError`, `InputError`."""
    path = runs_dir / layout.require_name(run_name, "the run name")
    if path.exists():
        raise OutputExistsError(f"{path} exists already", "give the run another name")


def create_under_free_name(started: datetime, what: str, create: Callable[[str], _Created]) -> _Created:
    """Create a run under the first name that is free: TIME-WHAT, TIME-WHAT-2 ...

    A name belongs to whoever makes its folder, so runs that start in the same second get different names.

    Parameters
    ----------
    create : callable
        Creates a run of a name. Its `OutputExistsError` has the next name tried; other errors are raised.
    """
    name = f"{started:%Y%m%d-%H%M%S}-{what}"
    for number in count(1):
        with suppress(OutputExistsError):
            return create(name if number == 1 else f"{name}-{number}")
    raise AssertionError("count() has no end")


def _make_reserve(path: Path) -> None:
    with open_descriptor(path / layout.RESERVE, os.O_WRONLY | os.O_CREAT) as descriptor:
        os.posix_fallocate(descriptor, 0, _RESERVE_BYTES)


def _make_opening_manifest(
    run_name: str, given: Mapping[str, Any], recording: Mapping[str, object]
) -> dict[str, Any]:
    """Return the manifest that a run begins with. What a list of runs shows stands first, and has no long texts."""
    devices = given.get("devices") or {}
    opening = {
        "schema_version": layout.SCHEMA_VERSION,
        "run": run_name,
        "experiment": given["experiment"],
        "exit_status": layout.INCOMPLETE,
        **dict.fromkeys(
            ("started", "ended", "trials_planned", "summary", "seed", "operator", "title", "reason")
        ),
        "recording": recording,
        "rig": {"name": devices.get("rig"), "kind": devices.get("kind")} if devices else None,
    }
    return opening | {key: value for key, value in given.items() if key != "devices"}


def _format_utc(moment: datetime) -> str:
    return moment.astimezone(UTC).isoformat(timespec="seconds")


def _make_run_directory(path: Path) -> None:
    """Make the folder of a run; an existing one is refused and left alone."""
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            path.mkdir()
        except FileExistsError as error:
            raise OutputExistsError(f"{path} exists already", "give the run another name") from error
