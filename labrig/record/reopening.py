"""Makes a run that was interrupted ready to be gone on with: checked, torn ends set aside, files open at their end."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from labrig.errors import LabrigError, RecordError
from labrig.record.check import RunCheck, check_run, trials_done
from labrig.record.durable import disk_errors, write_atomically
from labrig.record.json_lines import read_lines
from labrig.record.layout import (
    ALWAYS_PRESENT,
    CAN_LOG,
    CAN_SUMS,
    EVENT_LINES,
    FRAME_LINES,
    LOCK,
    MANIFEST,
    RAW_PICTURES,
    RESERVE,
    SHA256SUMS,
    STATE_LINES,
    TRUTH_LINES,
    inside,
)
from labrig.record.line_file import LineFile
from labrig.record.lock import FileLock
from labrig.record.manifest import read_manifest, recorded_sha256
from labrig.record.opening import encode_manifest, make_reserve
from labrig.record.pictures import PictureWriter, Store, open_picture_writer
from labrig.record.torn_ends import set_aside


@dataclass(frozen=True)
class Before:
    """What a run that is continued holds already: the rig time to go on from, pictures, finished trials."""

    t_s: float = 0.0
    frames: int = 0
    trials_done: int = 0


@dataclass(frozen=True)
class Standing:
    """A run on disk, locked and open for more."""

    manifest: Mapping[str, object]
    sums: dict[str, str]
    lines: dict[str, LineFile]
    lock: FileLock
    pictures: PictureWriter
    before: Before


def reopen_files(path: Path, doing: str) -> Standing:
    """Open a run for more; see `Recorder.reopen`."""
    read_manifest(path)
    lock = FileLock(inside(path, LOCK)).acquire(doing)
    try:
        _require_resumable(check_run(path))
        aside = set_aside(path)
        manifest = _reopen_manifest(read_manifest(path), aside)
        with disk_errors(path):
            write_atomically(path / MANIFEST, encode_manifest(manifest))
            _retire_sums(path)
            lines = _reopen_lines(path)
            before = _read_progress(path)
            pictures = open_picture_writer(path, _read_store(manifest), before.frames)
            (path / RESERVE).unlink(missing_ok=True)
            make_reserve(path)
    except LabrigError:
        lock.release()
        raise
    return Standing(manifest, _collect_sums(path, manifest), lines, lock, pictures, before)


def _read_store(manifest: Mapping[str, object]) -> Store:
    recording = manifest.get("recording")
    return "raw" if isinstance(recording, Mapping) and recording.get("picture_store") == "raw" else "png"


def _require_resumable(verdict: RunCheck) -> None:
    if verdict.damage:
        first, more = verdict.damage[0], len(verdict.damage) - 1
        others = f", and {more} more" if more else ""
        raise RecordError(
            f"{verdict.run} is damaged: {first.where}: {first.message}{others}",
            "labrig runs check lists all; nothing was changed",
        )
    if verdict.exit_status == "success":
        raise RecordError(f"{verdict.run} has come to its end; nothing can be added to it")


def _reopen_manifest(manifest: Mapping[str, object], aside: tuple[str, ...]) -> dict[str, object]:
    """Return the manifest of a run that goes on, which remembers how it was closed before and what was set aside."""
    content = {key: value for key, value in manifest.items() if key != "crc32"}
    if manifest["exit_status"] != "incomplete":
        ending = {key: manifest.get(key) for key in ("exit_status", "reason", "ended")}
        content["earlier_endings"] = [*_read_list(content, "earlier_endings"), ending]
    if aside:
        content["set_aside"] = [*_read_list(content, "set_aside"), *aside]
    return {**content, "exit_status": "incomplete", "reason": None, "ended": None}


def _read_list(manifest: Mapping[str, object], key: str) -> list[object]:
    value = manifest.get(key)
    return value if isinstance(value, list) else []


def _retire_sums(path: Path) -> None:
    """Keep the sums of an earlier closing under another name: they cover the beginning of each file."""
    if (path / SHA256SUMS).exists():
        number = 1
        while (path / f"{SHA256SUMS}.{number:03d}").exists():
            number += 1
        (path / SHA256SUMS).rename(path / f"{SHA256SUMS}.{number:03d}")


def _reopen_lines(path: Path) -> dict[str, LineFile]:
    sometimes = [name for name in (TRUTH_LINES, CAN_LOG, CAN_SUMS) if (path / name).exists()]
    return {name: LineFile.reopen(path / name) for name in (*ALWAYS_PRESENT, *sometimes)}


def _collect_sums(path: Path, manifest: dict[str, object]) -> dict[str, str]:
    """Return the SHA-256 of every file that stands and will not change, by its name relative to the run."""
    lines = [line for line in read_lines(path / FRAME_LINES) if line["file"] != RAW_PICTURES]
    pictures = {str(line["file"]): str(line["sha256"]) for line in lines}
    return {name: str(sha256) for name, sha256 in recorded_sha256(manifest).items()} | pictures


def _read_progress(path: Path) -> Before:
    events, frames = read_lines(path / EVENT_LINES), read_lines(path / FRAME_LINES)
    times = [line["t_s"] for line in (*events, *frames, *read_lines(path / STATE_LINES))]
    last_s = max((t_s for t_s in times if isinstance(t_s, int | float)), default=-1.0)
    return Before(float(math.floor(last_s) + 1), len(frames), trials_done(events))
