"""Write a run while it happens, so that it can be read whatever stops it."""

import hashlib
import math
import os
import shutil
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from datetime import datetime
from functools import partial
from itertools import count
from pathlib import Path
from threading import Lock
from typing import Self

import numpy as np
from numpy.typing import NDArray

from labrig.durable import (
    disk_errors,
    free_bytes,
    write_atomically,
)
from labrig.errors import DiskError, InputError, LabrigError, RecordError
from labrig.posix import sync_directory
from labrig.record.closing import write_closing_manifest
from labrig.record.events import Event
from labrig.record.layout import (
    ALWAYS_PRESENT,
    CAN_LOG,
    CAN_SUMS,
    CHAIN,
    EVENT_LINES,
    FRAME_LINES,
    LOCK,
    MANIFEST,
    RESERVE,
    SEQUENCED,
    SHA256SUMS,
    STATE_LINES,
    TRUTH_LINES,
    require_name,
    session_diff,
)
from labrig.record.line_file import LineFile
from labrig.record.lock import FileLock
from labrig.record.opening import (
    collect_opening_files,
    encode_manifest,
    make_opening_manifest,
    make_run_directory,
    write_opening_files,
)
from labrig.record.pictures import Store, open_picture_writer
from labrig.record.reopening import OpenRecord, reopen_files
from labrig.record.sealing import first_link
from labrig.record.syncing import Rounds, sync_in_order
from labrig.record.trial_count import COUNTED, count_trials_done

EXIT_STATUSES = ("success", "aborted", "failed")

# How many periods the disk may take for one round of fsyncs. A wait holds up the procedure, and a disk that other
# programs keep busy is usually fast again after some seconds.
_MOST_PERIODS_BEHIND = 10

_OF_A_PICTURE = frozenset({"frame", "file", "sha256", "offset", "shape", "t_s"})


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
        self._least_free_bytes = int(recording.get("least_free_bytes", 0))
        self._t0_s = record.t0_s
        self._period = int(record.t0_s // self._fsync_period_s)
        self._frames = record.frames
        self._counted = list(record.counted)
        self._seq = record.seq
        self._can_length = 0
        self._can_crc32 = 0
        self._appending = Lock()
        self._rounds = Rounds(_MOST_PERIODS_BEHIND)
        self._closed = False

    @classmethod
    def create(  # noqa: PLR0917 - the parts of a run, in the order of its folder
        cls,
        runs_dir: Path,
        run_name: str,
        manifest: Mapping[str, object],
        protocol_yaml: str,
        rig_yaml: str | None,
        calibration_files: Mapping[str, Path | bytes],
        *,
        fsync_period_s: float = 1.0,
        least_free_bytes: int = 0,
        picture_store: Store = "png",
        code_diff: bytes = b"",
    ) -> Self:
        """Begin a run: make its folder and write everything that is known before anything moves.

        Parameters
        ----------
        runs_dir : Path
            Folder of runs; made if absent.
        run_name : str
            Name of the new folder in it.
        manifest : Mapping
            `experiment` and `started` (an aware datetime or ISO text) at least; `title`, `trials_planned`,
            `seed`, `operator`, `provenance` and `devices` are expected, others are kept.
        protocol_yaml, rig_yaml : str
            As resolved; None without a rig.
        calibration_files : Mapping
            File name to content, or to the file to copy.
        fsync_period_s : float
            Rig time between two fsyncs [s].
        least_free_bytes : int
            The run ends when the disk has less free space than this; checked with each fsync.
        picture_store : {"png", "raw"}
            How pictures are kept; see `labrig.record.pictures`.
        code_diff : bytes
            Changes of the running code since its commit, as from `collect_code_diff`; stored as code.diff.

        Raises
        ------
        InputError
            When a name is invalid, the manifest lacks its two keys, or a calibration file cannot be read.
        OutputExistsError
            When the folder exists; it is not touched.
        DiskError
            When it cannot be written; nothing is left behind.
        """
        texts = collect_opening_files(protocol_yaml, rig_yaml, calibration_files, code_diff)
        if not (math.isfinite(fsync_period_s) and fsync_period_s > 0):
            raise InputError(f"fsync_period_s is {fsync_period_s}; it must be finite and above 0")
        path = runs_dir / require_name(run_name, "the run name")
        sums = {name: hashlib.sha256(content).hexdigest() for name, content in texts.items()}
        recording = {
            "fsync_period_s": fsync_period_s,
            "least_free_bytes": least_free_bytes,
            "picture_store": picture_store,
        }
        link, first_link_sha256 = first_link(sums, manifest.get("started"))
        opening = make_opening_manifest(run_name, manifest, sums, recording, first_link_sha256)
        document = encode_manifest(opening)
        make_run_directory(path)
        try:
            with disk_errors(path):
                lock = FileLock(path / LOCK).acquire("labrig run")
                write_opening_files(path, texts)
                write_atomically(path / CHAIN, link)
                lines = {name: LineFile.create(path / name) for name in ALWAYS_PRESENT}
                pictures = open_picture_writer(path, picture_store, 0)
                # Written last, so that a folder with a manifest has everything else.
                write_atomically(path / MANIFEST, document)
                sync_directory(runs_dir)
        except DiskError:
            shutil.rmtree(path, ignore_errors=True)
            raise
        return cls(path, OpenRecord(opening, sums, lines, lock, pictures))

    @classmethod
    def reopen(cls, path: Path, doing: str) -> Self:
        """Continue an interrupted run: torn ends are set aside, everything else is kept.

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
        return cls(path, reopen_files(path, doing))

    def begin_session(self, started: datetime, *, code_diff: bytes = b"", **fields: object) -> float:
        """Add a session to the manifest, with its code and devices, and return its rig time zero [s].

        Parameters
        ----------
        started : datetime
            Aware.
        code_diff : bytes
            As for `create`; stored as code.002.diff, 003 ...
        **fields
            Further members of the session: `provenance` and `devices` are expected.

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
        return self._t0_s

    def _write_session_diff(self, code_diff: bytes) -> dict[str, str]:
        """Write the code.diff of a later session and return its members in the manifest."""
        if not code_diff:
            return {}
        # A number is skipped if a process was killed before its manifest named the file.
        names = (session_diff(number) for number in count(2))
        name = next(name for name in names if not os.path.lexists(self.path / name))
        with self._guard_disk(self.path):
            write_atomically(self.path / name, code_diff)
        self._sums[name] = hashlib.sha256(code_diff).hexdigest()
        return {"code_diff": name, "code_diff_sha256": self._sums[name]}

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
        clash = sorted(_OF_A_PICTURE & fields.keys())
        if clash:
            raise InputError(f"the recorder itself writes {', '.join(clash)}", "give the field another name")
        number = self._frames
        with self._guard_disk(self.path):
            place = self._pictures.write(number, image)
        try:
            self._append(FRAME_LINES, t_s, {"frame": number, **place, "t_s": self._t0_s + t_s, **fields})
        except LabrigError:
            # A picture that no line lists is damage in a closed run.
            with self._guard_disk(self.path):
                self._pictures.withdraw(number)
            raise
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
        if kind in COUNTED:
            self._counted.append({"kind": kind, **fields})
        self._sync_each_period(t_s)

    def record_event(self, event: Event, t_s: float) -> None:
        """Append an event at rig time `t_s` [s]. Raises as `event` does."""
        self.event(event.kind, t_s, **event.line_fields())

    def truth(self, **fields: object) -> None:
        """Append what a simulated world drew; the first line makes the file. Raises as `event` does."""
        self._require_open()
        self._create_file(TRUTH_LINES)
        self._write_line(TRUTH_LINES, fields)

    def can_frames(self, frames: Iterable[tuple[float, int, bytes, str]]) -> None:
        """Append CAN frames to can.log in candump's format; can.sums.jsonl gets its length and the CRC-32 of the part.

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
        ).encode()
        if not lines:
            return
        self._require_open()
        self._create_file(CAN_LOG)
        self._create_file(CAN_SUMS)
        can_log = self._lines[CAN_LOG]
        with self._guard_disk(can_log.path):
            self._can_length = can_log.append_raw(lines)
        # If this sum cannot be written, the next one covers this part too.
        self._can_crc32 = zlib.crc32(lines, self._can_crc32)
        self._write_can_sum()

    def _write_can_sum(self) -> None:
        self._write_line(CAN_SUMS, {"bytes": self._can_length, "part_crc32": f"{self._can_crc32:08x}"})
        self._can_crc32 = 0

    def _create_file(self, name: str) -> None:
        if name not in self._lines:
            with self._guard_disk(self.path / name):
                self._lines[name] = LineFile.create(self.path / name)

    def close(self, exit_status: str, reason: str, ended: datetime, **manifest_updates: object) -> None:
        """End the run: write SHA256SUMS, check and seal the record, write how it ended. A second call does nothing.

        Parameters
        ----------
        exit_status : {"success", "aborted", "failed"}
            How it ended.
        reason : str
            The cause in a sentence; empty after a success.
        ended : datetime
            Aware.
        **manifest_updates
            Further keys of the manifest.

        Raises
        ------
        BugError
            When the record is damaged; the manifest says so, and that the run failed.
        DiskError
            When it cannot be written; the run stays `incomplete`, and readable.
        """
        if exit_status not in EXIT_STATUSES:
            raise InputError(f"exit_status is {exit_status!r}; it must be one of {', '.join(EXIT_STATUSES)}")
        if self._closed:
            return
        ending = {
            "exit_status": exit_status,
            "reason": reason,
            "ended": ended,
            "trials_done": count_trials_done(self._counted),
        }
        try:
            if self._can_crc32:
                self._write_can_sum()
            self._finish({**self._manifest, **ending, **manifest_updates}, ended)
        finally:
            self._closed = True
            self._rounds.close()
            for lines in self._lines.values():
                lines.close()
            self._pictures.close()
            self._lock.release()

    def _finish(self, manifest: Mapping[str, object], ended: datetime) -> None:
        with self._guard_disk(self.path):
            self._rounds.finish()
            self._make_round()()
        self._release_reserve()
        sums = self._sums | self._pictures.sums(self._frames)
        sums |= {name: lines.sha256 for name, lines in self._lines.items()}
        text = "".join(f"{sums[name]}  {name}\n" for name in sorted(sums))
        write_atomically(self.path / SHA256SUMS, text.encode())
        write_closing_manifest(self.path, manifest, sums, ended)

    def _append(self, name: str, t_s: float, fields: Mapping[str, object]) -> None:
        """Append a line of rig time `t_s`."""
        if not math.isfinite(t_s):
            raise InputError(f"a line of {name} has the time {t_s}; rig time is a finite number of seconds")
        self._write_line(name, fields)

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

    def _write_line(self, name: str, fields: Mapping[str, object]) -> None:
        self._require_open()
        held = self._appending if name == FRAME_LINES else nullcontext()
        lines = self._lines[name]
        with self._guard_disk(lines.path), held:
            lines.append({**fields, "seq": self._seq} if name in SEQUENCED else fields)
        self._seq += name in SEQUENCED

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
