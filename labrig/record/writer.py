"""Writes a run while it happens, so that it can be read whatever stops it."""

import hashlib
import math
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import DiskError, InputError, OutputExistsError, RecordError
from labrig.record.durable import disk_errors, sync_directory, write_and_rename, write_atomically
from labrig.record.json_lines import checksum, encode_document
from labrig.record.layout import (
    CALIBRATION,
    CAN_LOG,
    EVENT_LINES,
    FRAME_LINES,
    FRAMES,
    MANIFEST,
    PROTOCOL,
    RIG,
    SCHEMA_VERSION,
    SHA256SUMS,
    STATE_LINES,
    TRUTH_LINES,
    checked_name,
    picture_file,
)
from labrig.record.line_file import LineFile

EXIT_STATUSES = ("success", "aborted", "failed")

# Lossless, and said in full: naming a compression level alone would change the strategy too, to one that
# takes twice as long. On noisy pictures Huffman-only coding and other filters differ from this by less than a
# tenth of the time and 5 % of the size; on clean ones run lengths are twice as fast and as small.
_PNG_SETTINGS = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)

# Kept free for the end of the run: on a disk that has filled up it still pays for the last lines, SHA256SUMS
# (83 bytes a picture) and the manifest, so that the run can say that it failed and why.
_RESERVE = ".reserve"
_RESERVE_BYTES = 2**20


class Recorder:
    """The record of a running experiment; made by `Recorder.create`, ended by `close`.

    What can be lost. A line is in the kernel before its call returns, and a picture stands complete under its
    name before its line is written: killing the process loses nothing that was acknowledged. Each picture is
    fsynced before it gets its name; the lines, and the names of pictures, are fsynced when the rig time of a
    call passes a multiple of `fsync_period_s`, and on closing. So a power cut loses at most the lines and
    pictures of the last period, and may tear the last line.

    Attributes
    ----------
    path : Path
        The folder of the run.
    run_name : str
        Its name.
    """

    def __init__(
        self, path: Path, manifest: Mapping[str, object], sums: dict[str, str], fsync_period_s: float
    ) -> None:
        self.path = path
        self.run_name = path.name
        self._manifest = manifest
        self._sums = sums
        self._fsync_period_s = fsync_period_s
        self._period = 0
        self._frames = 0
        self._durable_frames = 0
        self._trials_done = 0
        self._closed = False
        self._lines = {name: LineFile.create(path / name) for name in (FRAME_LINES, STATE_LINES, EVENT_LINES)}

    @classmethod
    def create(  # noqa: PLR0917 - the parts of a run, in the order in which they stand in its folder
        cls,
        runs_dir: Path,
        run_name: str,
        manifest: Mapping[str, object],
        protocol_yaml: str,
        rig_yaml: str | None,
        calibration_files: Mapping[str, Path | bytes],
        *,
        fsync_period_s: float = 1.0,
    ) -> Self:
        """Begin a run: make its folder and write all that is known before anything moves.

        Parameters
        ----------
        runs_dir : Path
            Folder of runs; made when absent.
        run_name : str
            Name of the new folder in it.
        manifest : Mapping
            `experiment` and `started` (an aware datetime or ISO text) at least; `title`, `trials_planned`,
            `seed`, `operator`, `provenance` and `devices` are expected, others are kept.
        protocol_yaml, rig_yaml : str
            As resolved. No rig: None.
        calibration_files : Mapping
            File name to content, or to the file to copy.
        fsync_period_s : float
            Rig time between two fsyncs [s].

        Raises
        ------
        InputError
            When a name cannot be used, the manifest lacks its two keys, or a calibration file cannot be read.
        OutputExistsError
            When the folder exists; it is left alone.
        DiskError
            When it cannot be written; nothing is left behind.
        """
        texts = _texts(protocol_yaml, rig_yaml, calibration_files)
        if not (math.isfinite(fsync_period_s) and fsync_period_s > 0):
            raise InputError(f"fsync_period_s is {fsync_period_s}; it must be finite and above 0")
        path = runs_dir / checked_name(run_name, "the run name")
        sums = {name: hashlib.sha256(content).hexdigest() for name, content in texts.items()}
        opening = _opening_manifest(run_name, manifest, sums, fsync_period_s)
        document = _manifest_document(opening)
        _make_run_directory(path)
        try:
            with disk_errors(path):
                _write_beginning(path, texts)
                recorder = cls(path, opening, sums, fsync_period_s)
                # Last of all, so that a folder with a manifest has everything else.
                write_atomically(path / MANIFEST, document)
                sync_directory(runs_dir)
        except DiskError:
            shutil.rmtree(path, ignore_errors=True)
            raise
        return recorder

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:
        """Record a picture and return its number.

        Parameters
        ----------
        image : array (H, W) or (H, W, 3) of uint8
            Grey or BGR.
        t_s : float
            Rig time of the exposure [s].
        **fields
            What else its line in frames.jsonl says.

        Raises
        ------
        InputError
            When the array is no such picture.
        DiskError
            When it cannot be written; the record stays whole.
        """
        self._require_open()
        content = _png(image)
        number = self._frames
        file = picture_file(number)
        sha256 = hashlib.sha256(content).hexdigest()
        line = _without_clash({"frame": number, "file": file, "sha256": sha256, "t_s": t_s}, fields)
        with self._written(self.path / file):
            write_and_rename(self.path / file, content)
        self._append(FRAME_LINES, t_s, line)
        self._sums[file] = sha256
        self._frames += 1
        return number

    def state(self, t_s: float, **fields: object) -> None:
        """Append what the axes read at rig time `t_s` [s].

        Raises
        ------
        DiskError
            When it cannot be written; the record stays whole.
        """
        self._append(STATE_LINES, t_s, {"t_s": t_s, **fields})

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Append what happened at rig time `t_s` [s]; `trial_start` and `trial_stop` make the trials.

        Raises
        ------
        DiskError
            When it cannot be written; the record stays whole.
        """
        self._append(EVENT_LINES, t_s, {"kind": kind, "t_s": t_s, **fields})
        if kind == "trial_stop" and fields.get("exit_status") == "success":
            self._trials_done += 1

    def truth(self, **fields: object) -> None:
        """Append what a simulated world drew; the file is made with its first line.

        Raises
        ------
        DiskError
            When it cannot be written; the record stays whole.
        """
        self._require_open()
        if TRUTH_LINES not in self._lines:
            with self._written(self.path / TRUTH_LINES):
                self._lines[TRUTH_LINES] = LineFile.create(self.path / TRUTH_LINES)
        self._write_line(TRUTH_LINES, fields)

    def can_frames(self, frames: Iterable[tuple[float, int, bytes, str]]) -> None:
        """Append CAN frames to can.log, which is made with the first, in the form of candump.

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
            f"({t_s:.6f}) can {i:03X}#{data.hex().upper()} {way}\n" for t_s, i, data, way in frames
        )
        if not lines:
            return
        self._require_open()
        with self._written(self.path / CAN_LOG):
            if CAN_LOG not in self._lines:
                self._lines[CAN_LOG] = LineFile.create(self.path / CAN_LOG)
            self._lines[CAN_LOG].append_raw(lines.encode())

    def close(self, exit_status: str, reason: str, ended: datetime, **manifest_updates: object) -> None:
        """End the run: SHA256SUMS, then the manifest with how it ended. Closing again does nothing.

        Parameters
        ----------
        exit_status : {"success", "aborted", "failed"}
            How it ended.
        reason : str
            Why, in a sentence; empty for a success.
        ended : datetime
            Aware.
        **manifest_updates
            Further keys of the manifest.

        Raises
        ------
        DiskError
            When it cannot be written; the run stays `incomplete`, and readable.
        """
        if exit_status not in EXIT_STATUSES:
            raise InputError(f"exit_status is {exit_status!r}; it must be one of {', '.join(EXIT_STATUSES)}")
        if self._closed:
            return
        self._closed = True
        ending = {
            "exit_status": exit_status,
            "reason": reason,
            "ended": ended,
            "trials_done": self._trials_done,
        }
        try:
            self._finish({**self._manifest, **ending, **manifest_updates})
        finally:
            for lines in self._lines.values():
                lines.close()

    def _finish(self, manifest: Mapping[str, object]) -> None:
        with self._written(self.path):
            self._sync()
        self._release_reserve()
        sums = self._sums | {name: lines.sha256 for name, lines in self._lines.items()}
        text = "".join(f"{sums[name]}  {name}\n" for name in sorted(sums))
        write_atomically(self.path / SHA256SUMS, text.encode())
        write_atomically(self.path / MANIFEST, _manifest_document(manifest))

    def _append(self, name: str, t_s: float, fields: Mapping[str, object]) -> None:
        """Append a line that happened at `t_s`, and fsync when that begins a new period."""
        if not math.isfinite(t_s):
            raise InputError(f"a line of {name} has the time {t_s}; rig time is a finite number of seconds")
        self._write_line(name, fields)
        period = int(t_s // self._fsync_period_s)
        if period > self._period:
            self._period = period
            with self._written(self.path):
                self._sync()

    def _require_open(self) -> None:
        if self._closed:
            raise RecordError(f"{self.path} is closed; nothing can be added to it")

    def _write_line(self, name: str, fields: Mapping[str, object]) -> None:
        self._require_open()
        with self._written(self.path / name):
            self._lines[name].append(fields)

    @contextmanager
    def _written(self, path: Path) -> Iterator[None]:
        """Turn a fault of the disk into a `DiskError`, and free the reserve for the last lines of the run."""
        try:
            with disk_errors(path):
                yield
        except DiskError:
            self._release_reserve()
            raise

    def _sync(self) -> None:
        # Pictures first: a durable line then speaks of a durable picture.
        if self._durable_frames < self._frames:
            sync_directory(self.path / FRAMES)
            self._durable_frames = self._frames
        for lines in self._lines.values():
            lines.sync()

    def _release_reserve(self) -> None:
        # Where even this fails, the fault of the disk is already on its way up.
        with suppress(OSError):
            (self.path / _RESERVE).unlink()


def _without_clash(own: Mapping[str, object], fields: Mapping[str, object]) -> dict[str, object]:
    clash = sorted(own.keys() & fields.keys())
    if clash:
        raise InputError(f"the recorder itself writes {', '.join(clash)}", "give the field another name")
    return {**own, **fields}


def _texts(
    protocol_yaml: str, rig_yaml: str | None, calibration_files: Mapping[str, Path | bytes]
) -> dict[str, bytes]:
    """Return the files that stand from the beginning: name relative to the run, content."""
    rig = {} if rig_yaml is None else {RIG: rig_yaml.encode()}
    calibration = {
        f"{CALIBRATION}/{checked_name(name, 'the calibration file name')}": _content(source)
        for name, source in calibration_files.items()
    }
    return {PROTOCOL: protocol_yaml.encode(), **rig, **calibration}


def _content(source: Path | bytes) -> bytes:
    if isinstance(source, bytes):
        return source
    try:
        return source.read_bytes()
    except OSError as error:
        raise InputError(
            f"cannot read the calibration file {source}: {error.strerror}", "check the rig file"
        ) from error


def _opening_manifest(
    run_name: str, given: Mapping[str, object], sums: Mapping[str, str], fsync_period_s: float
) -> dict[str, object]:
    missing = [key for key in ("experiment", "started") if not given.get(key)]
    if missing:
        raise InputError(f"the manifest of {run_name} lacks {' and '.join(missing)}")
    calibration = {
        name.removeprefix(f"{CALIBRATION}/"): sums[name]
        for name in sums
        if name.startswith(f"{CALIBRATION}/")
    }
    hashes = {"protocol_sha256": sums[PROTOCOL], "rig_sha256": sums.get(RIG), "calibration": calibration}
    # The order is the order in the file.
    defaults = {
        "schema_version": SCHEMA_VERSION,
        "run": run_name,
        "experiment": None,
        "title": "",
        "exit_status": "incomplete",
        "reason": None,
        "started": None,
        "ended": None,
        "trials_planned": None,
        "trials_done": 0,
        "seed": None,
        "operator": None,
        "hashes": hashes,
        "recording": {"fsync_period_s": fsync_period_s},
        "provenance": {},
        "devices": {},
    }
    return defaults | dict(given) | {key: defaults[key] for key in _OWN_KEYS}


# What only the recorder can know.
_OWN_KEYS = ("schema_version", "run", "exit_status", "reason", "ended", "trials_done", "hashes", "recording")


def _make_run_directory(path: Path) -> None:
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            path.mkdir()
        except FileExistsError as error:
            raise OutputExistsError(f"{path} exists already", "give the run another name") from error


def _write_beginning(path: Path, texts: Mapping[str, bytes]) -> None:
    (path / FRAMES).mkdir()
    (path / CALIBRATION).mkdir()
    for name, content in texts.items():
        write_and_rename(path / name, content)
    sync_directory(path / CALIBRATION)
    descriptor = os.open(path / _RESERVE, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        os.posix_fallocate(descriptor, 0, _RESERVE_BYTES)
    finally:
        os.close(descriptor)


def _manifest_document(manifest: Mapping[str, object]) -> bytes:
    return encode_document({**manifest, "crc32": checksum(manifest)})


def _png(image: NDArray[np.uint8]) -> bytes:
    grey_or_bgr = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if image.dtype != np.uint8 or not grey_or_bgr or image.size == 0:
        raise InputError(
            f"a picture is a uint8 array (H, W) or (H, W, 3); got {image.dtype} {image.shape}",
            "set the camera to 8-bit grey or BGR",
        )
    _, content = cv2.imencode(".png", np.ascontiguousarray(image), _PNG_SETTINGS)
    return content.tobytes()
