"""Write a run while it happens, so that it can be read whatever stops it."""

import hashlib
import math
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from labrig.durable import (
    disk_errors,
    free_bytes,
    open_descriptor,
    sync_directory,
    write_and_rename,
    write_atomically,
)
from labrig.errors import DiskError, InputError, LabrigError, OutputExistsError, RecordError
from labrig.input_file import read_file
from labrig.record.decisions import count_trials_done
from labrig.record.events import Event
from labrig.record.json_lines import LineFile, encode_line
from labrig.record.layout import (
    ALWAYS_PRESENT,
    CALIBRATION,
    CAN_LOG,
    CODE_DIFF,
    DEVICE_LINES,
    EVENT_LINES,
    FRAME_LINES,
    FRAMES,
    LOCK,
    MANIFEST,
    PROTOCOL,
    RESERVE,
    RIG,
    SCHEMA_VERSION,
    SEQUENCED,
    SHA256SUMS,
    STATE_LINES,
    TRUTH_LINES,
    require_name,
    session_diff,
)
from labrig.record.lock import FileLock
from labrig.record.manifest import INCOMPLETE, encode_manifest, encode_sums
from labrig.record.pictures import PictureWriter, Store
from labrig.record.syncing import Rounds, sync_in_order

EXIT_STATUSES = ("success", "aborted", "failed")

# How many periods the disk may take for one round of fsyncs. A wait holds up the procedure, and a disk that other
# programs keep busy is usually fast again after some seconds.
_MOST_PERIODS_BEHIND = 10
_RESERVE_BYTES = 2**20
_OF_A_PICTURE = frozenset({"frame", "file", "sha256", "t_s"})
# Only the recorder knows these.
_OWN_KEYS = ("schema_version", "run", "exit_status", "reason", "ended", "recording", "summary")

_Created = TypeVar("_Created")


@dataclass(frozen=True)
class OpenRecord:
    """A run on disk, locked and open for appending.

    It holds `frames` pictures and `events` already, and `sums`, the SHA-256 of what is final; rig time goes on from
    `t0_s` [s], and the order of its lines from `seq`.
    """

    manifest: Mapping[str, object]
    sums: dict[str, str]
    lines: dict[str, LineFile]
    lock: FileLock
    pictures: PictureWriter
    t0_s: float = 0.0
    frames: int = 0
    events: tuple[Mapping[str, object], ...] = ()
    seq: int = 0


@dataclass(frozen=True)
class RunFiles:
    """What a run begins with: protocol and rig as resolved (None without a rig), calibration, changes of the code.

    `calibration` is file name to content, or to the file to copy; `code_diff` is as from `collect_code_diff`.
    """

    protocol_yaml: str
    rig_yaml: str | None = None
    calibration: Mapping[str, Path | bytes] = field(default_factory=dict)
    code_diff: bytes = b""

    def read(self) -> dict[str, bytes]:
        """Return the content of each file by its name in the run. Raises `InputError`."""
        files = {PROTOCOL: self.protocol_yaml.encode()}
        files |= {} if self.rig_yaml is None else {RIG: self.rig_yaml.encode()}
        files |= {CODE_DIFF: self.code_diff} if self.code_diff else {}
        for name, source in self.calibration.items():
            file = f"{CALIBRATION}/{require_name(name, 'the calibration file name')}"
            files[file] = source if isinstance(source, bytes) else _read_source(source)
        return files


class Recorder:
    """The record of a running experiment; made by `Recorder.create`, ended by `close`.

    What can be lost. A line is in the kernel before its call returns, and a picture is complete under its name before
    its line is written: killing the process loses nothing that was acknowledged. A thread of its own fsyncs pictures,
    then lines, whenever the rig time of a call passes a multiple of `fsync_period_s`, and on closing. So a power cut
    loses at most the lines and pictures of the last two periods, and may tear the last line. If the disk takes longer
    than a period, it loses that much more; after `_MOST_PERIODS_BEHIND` the call waits.

    Attributes
    ----------
    path : Path
        The folder of the run.
    run_name : str
        Its name.
    """

    def __init__(self, path: Path, record: OpenRecord) -> None:
        self.path = path
        self.run_name = path.name
        self._manifest = record.manifest
        self._sums = record.sums
        self._lines = record.lines
        self._lock = record.lock
        self._pictures = record.pictures
        recording = record.manifest["recording"]
        assert isinstance(recording, Mapping)
        self._fsync_period_s = float(recording["fsync_period_s"])
        self._least_free_bytes = int(recording["least_free_bytes"])
        self._t0_s = record.t0_s
        self._period = int(record.t0_s // self._fsync_period_s)
        self._frames = record.frames
        self._events = list(record.events)
        self._seq = record.seq
        self._appending = Lock()
        self._rounds = Rounds(_MOST_PERIODS_BEHIND)
        self._closed = False

    @classmethod
    def create(
        cls,
        runs_dir: Path,
        run_name: str,
        manifest: Mapping[str, object],
        files: RunFiles,
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
            `experiment` and `started` (an aware datetime or ISO text) at least; `title`, `trials_planned`, `seed`,
            `operator`, `protocol` and `provenance` are expected, others are kept. `devices` goes into devices.jsonl.
        files : RunFiles
            What the run begins with.
        fsync_period_s : float
            Rig time between two fsyncs [s].
        least_free_bytes : int
            The run ends when the disk has less free space than this; checked with each fsync.
        picture_store : {"png", "pgm"}
            How pictures are kept; see `labrig.record.pictures`.

        Raises
        ------
        InputError
            When a name is invalid, the manifest lacks its two keys, or a calibration file cannot be read.
        OutputExistsError
            When the folder exists; it is not touched.
        DiskError
            When it cannot be written; nothing is left behind.
        """
        contents = files.read()
        if not (math.isfinite(fsync_period_s) and fsync_period_s > 0):
            raise InputError(f"fsync_period_s is {fsync_period_s}; it must be finite and above 0")
        if missing := [key for key in ("experiment", "started") if not manifest.get(key)]:
            raise InputError(f"the manifest of {run_name} lacks {' and '.join(missing)}")
        path = runs_dir / require_name(run_name, "the run name")
        sums = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
        recording = {
            "fsync_period_s": fsync_period_s,
            "least_free_bytes": least_free_bytes,
            "picture_store": picture_store,
        }
        opening = _make_opening_manifest(run_name, manifest, recording)
        document, devices = encode_manifest(opening), encode_line(_at_begin(manifest.get("devices")))
        _make_run_directory(path)
        try:
            with disk_errors(path):
                lock = FileLock(path / LOCK).acquire("labrig run")
                _write_opening_files(path, contents)
                write_atomically(path / SHA256SUMS, encode_sums(sums))
                lines = {name: LineFile.create(path / name) for name in (*ALWAYS_PRESENT, DEVICE_LINES)}
                lines[DEVICE_LINES].append(devices)
                # Written last, so that a folder with a manifest has everything else.
                write_atomically(path / MANIFEST, document)
                sync_directory(runs_dir)
        except DiskError:
            shutil.rmtree(path, ignore_errors=True)
            raise
        return cls(path, OpenRecord(opening, sums, lines, lock, PictureWriter(path, picture_store)))

    def begin_session(
        self, started: datetime, *, code_diff: bytes = b"", devices: object = None, **fields: object
    ) -> float:
        """Add a session to a reopened run, with its code and devices, and return its rig time zero [s].

        Parameters
        ----------
        started : datetime
            Aware.
        code_diff : bytes
            As in `RunFiles`; stored as code.002.diff, 003 ...
        devices : object
            What the devices say of themselves.
        **fields
            Further members of the session in the manifest: `provenance` is expected.

        Raises
        ------
        DiskError
            When it cannot be written; the run stays `incomplete`, and readable.
        """
        sessions = self._manifest.get("sessions", ())
        assert isinstance(sessions, list | tuple)
        session = {"started": started, "t0_s": self._t0_s, **fields, **self._write_session_diff(code_diff)}
        self._manifest = {**self._manifest, "sessions": [*sessions, session]}
        with self._guard_disk(self.path):
            write_atomically(self.path / MANIFEST, encode_manifest(self._manifest))
        self._write_line(DEVICE_LINES, _at_begin(devices, self._t0_s))
        return self._t0_s

    def _write_session_diff(self, code_diff: bytes) -> dict[str, str]:
        """Write the code.diff of a later session and return its member in the manifest."""
        if not code_diff:
            return {}
        # A number is skipped if a process was killed before its manifest named the file.
        names = (session_diff(number) for number in count(2))
        name = next(name for name in names if not os.path.lexists(self.path / name))
        with self._guard_disk(self.path):
            write_atomically(self.path / name, code_diff)
        self._sums[name] = hashlib.sha256(code_diff).hexdigest()
        return {"code_diff": name}

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
        if clash := sorted(_OF_A_PICTURE & fields.keys()):
            raise InputError(f"the recorder itself writes {', '.join(clash)}", "give the field another name")
        number = self._frames
        with self._guard_disk(self.path):
            place = self._pictures.write(number, image)
        file = str(place["file"])
        try:
            self._append(FRAME_LINES, t_s, {"frame": number, **place, "t_s": self._t0_s + t_s, **fields})
        except LabrigError:
            # A picture that no line lists is no part of the record.
            with self._guard_disk(self.path):
                (self.path / file).unlink()
            raise
        self._sums[file] = str(place["sha256"])
        self._frames += 1
        self._sync_each_period(t_s)
        return number

    def state(self, t_s: float, **fields: object) -> None:
        """Append a reading of the axes at rig time `t_s` [s]. Raises as `event` does."""
        self._append(STATE_LINES, t_s, {"t_s": self._t0_s + t_s, **fields})
        self._sync_each_period(t_s)

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Append an event at rig time `t_s` [s]; `trial_start` and `trial_stop` delimit the trials.

        Raises
        ------
        DiskError
            When it cannot be written; the record stays whole.
        """
        self._append(EVENT_LINES, t_s, {"kind": kind, "t_s": self._t0_s + t_s, **fields})
        self._events.append({"kind": kind, **fields})
        self._sync_each_period(t_s)

    def record_event(self, event: Event, t_s: float) -> None:
        """Append an event at rig time `t_s` [s]. Raises as `event` does."""
        self.event(event.kind, t_s, **event.line_fields())

    def truth(self, **fields: object) -> None:
        """Append what a simulated world drew; the first line makes the file. Raises as `event` does."""
        self._write_line(TRUTH_LINES, fields)

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
            self._write(CAN_LOG, lines.encode())

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
        ending = {"exit_status": exit_status, "reason": reason, "ended": ended}
        try:
            if after is not None:
                self._write_line(DEVICE_LINES, {"when": "end", "devices": after})
            self._finish({**self._manifest, **ending, **manifest_updates, "summary": self._summarise()})
        finally:
            self._closed = True
            self._rounds.close()
            for lines in self._lines.values():
                lines.close()
            self._lock.release()

    def _summarise(self) -> dict[str, object]:
        """Return what a list of runs shows beside how the run ended."""
        return {"trials_done": count_trials_done(self._events), "pictures": self._frames}

    def _finish(self, manifest: Mapping[str, object]) -> None:
        with self._guard_disk(self.path):
            self._rounds.finish()
            self._make_round()()
        self._release_reserve()
        document = encode_manifest(manifest)
        sums = self._sums | {name: lines.sha256 for name, lines in self._lines.items()}
        sums[MANIFEST] = hashlib.sha256(document).hexdigest()
        write_atomically(self.path / SHA256SUMS, encode_sums(sums))
        write_atomically(self.path / MANIFEST, document)

    def _append(self, name: str, t_s: float, fields: Mapping[str, object]) -> None:
        """Append a line of rig time `t_s`."""
        if not math.isfinite(t_s):
            raise InputError(f"a line of {name} has the time {t_s}; rig time is a finite number of seconds")
        self._write_line(name, fields)

    def _write_line(self, name: str, fields: Mapping[str, object]) -> None:
        self._write(name, encode_line({**fields, "seq": self._seq} if name in SEQUENCED else fields))
        self._seq += name in SEQUENCED

    def _write(self, name: str, lines: bytes) -> None:
        """Append lines to a file, which the first of them makes."""
        if self._closed:
            self._require_open()
        held = self._appending if name == FRAME_LINES else nullcontext()
        file = self._lines.get(name)
        path = self.path / name if file is None else file.path
        with self._guard_disk(path), held:
            if file is None:
                file = self._lines[name] = LineFile.create(path)
            file.append(lines)

    def _sync_each_period(self, t_s: float) -> None:
        """Start an fsync when rig time `t_s` begins a new period."""
        period = int((self._t0_s + t_s) // self._fsync_period_s)
        if period > self._period:
            self._period = period
            with self._guard_disk(self.path):
                self._require_free_space()
                self._rounds.begin(self._make_round())

    def _require_free_space(self) -> None:
        """Stop the run before the disk is so full that other programs on this computer cannot write either."""
        free, least = free_bytes(self.path), self._least_free_bytes
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

    def _make_round(self) -> Callable[[], None]:
        """Return the call that forces everything written so far to disk; files begun later wait for the next round."""
        others = tuple(lines for name, lines in self._lines.items() if name != FRAME_LINES)
        return partial(sync_in_order, self._pictures, self._lines[FRAME_LINES], others, self._appending)

    def _release_reserve(self) -> None:
        # If even this fails, the fault of the disk is being raised already.
        with suppress(OSError):
            (self.path / RESERVE).unlink()


def require_free_name(runs_dir: Path, run_name: str) -> None:
    """Refuse the name of a run that exists already, before any work. Raises `OutputExistsError`, `InputError`."""
    path = runs_dir / require_name(run_name, "the run name")
    if path.exists():
        raise _make_name_error(path)


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


def make_reserve(path: Path) -> None:
    """Reserve disk space for the end of the run.

    When the disk is full, it still holds the last lines, SHA256SUMS (83 bytes a picture) and the manifest, so that the
    record states that the run failed and why.
    """
    with open_descriptor(path / RESERVE, os.O_WRONLY | os.O_CREAT) as descriptor:
        os.posix_fallocate(descriptor, 0, _RESERVE_BYTES)


def _make_opening_manifest(
    run_name: str, given: Mapping[str, object], recording: Mapping[str, object]
) -> dict[str, object]:
    """Return the manifest that a run begins with, in the order of the file."""
    defaults = {
        "schema_version": SCHEMA_VERSION,
        "run": run_name,
        "experiment": None,
        "title": "",
        "exit_status": INCOMPLETE,
        "reason": None,
        "started": None,
        "ended": None,
        "trials_planned": None,
        "summary": None,
        "seed": None,
        "operator": None,
        "recording": recording,
        "rig": _name_rig(given.get("devices")),
    }
    chosen = {key: value for key, value in given.items() if key != "devices"}
    return defaults | chosen | {key: defaults[key] for key in _OWN_KEYS}


def _name_rig(devices: object) -> dict[str, object] | None:
    """Return name and kind of the rig, of all that the devices say; None without a rig."""
    known = devices if isinstance(devices, Mapping) and devices else None
    return None if known is None else {"name": known.get("rig"), "kind": known.get("kind")}


def _at_begin(devices: object, t_s: float = 0.0) -> dict[str, object]:
    """Return the line of devices.jsonl of a session that begins at rig time `t_s` [s]."""
    return {"when": "begin", "t_s": t_s, "devices": devices or {}}


def _read_source(source: Path) -> bytes:
    try:
        return read_file(source)
    except OSError as error:
        raise InputError(
            f"cannot read the calibration file {source}: {error.strerror}", "check the rig file"
        ) from error


def _make_run_directory(path: Path) -> None:
    """Make the folder of a run; an existing one is refused and left alone."""
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            path.mkdir()
        except FileExistsError as error:
            raise _make_name_error(path) from error


def _make_name_error(path: Path) -> OutputExistsError:
    return OutputExistsError(f"{path} exists already", "give the run another name")


def _write_opening_files(path: Path, contents: Mapping[str, bytes]) -> None:
    """Write what is known before anything moves, except the manifest."""
    (path / FRAMES).mkdir()
    (path / CALIBRATION).mkdir()
    for name, content in contents.items():
        write_and_rename(path / name, content)
    sync_directory(path / CALIBRATION)
    make_reserve(path)
