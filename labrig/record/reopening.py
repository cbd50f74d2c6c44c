"""Reopen an interrupted run: check it, set torn ends aside, and open its files for appending."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from labrig.durable import disk_errors, write_atomically
from labrig.errors import LabrigError, RecordError
from labrig.input_file import MAX_LOG_BYTES, read_file
from labrig.record.chain import Link
from labrig.record.check import RunCheck, check_run
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
from labrig.record.sealing import finish_closing, seal_again
from labrig.record.torn_ends import set_aside
from labrig.record.trial_count import COUNTED


@dataclass(frozen=True)
class OpenRecord:
    """A run on disk, locked and open for appending.

    It holds `frames` pictures already, and `counted`, the events from which its trials are counted; rig time goes on
    from `t0_s` [s], and the order of its lines from `seq`.
    """

    manifest: Mapping[str, object]
    sums: dict[str, str]
    lines: dict[str, LineFile]
    lock: FileLock
    pictures: PictureWriter
    t0_s: float = 0.0
    frames: int = 0
    counted: tuple[Mapping[str, object], ...] = ()
    seq: int = 0


def reopen_files(path: Path, doing: str) -> OpenRecord:
    """Open a run for appending; see `Recorder.reopen`."""
    read_manifest(path)
    lock = FileLock(inside(path, LOCK)).acquire(doing)
    try:
        _require_resumable(check_run(path))
        finish_closing(path)
        aside = set_aside(path)
        closed = read_manifest(path)
        with disk_errors(path):
            link = seal_again(path, _copy_closing(path, closed))
            manifest = _reopen_manifest(closed, aside, link)
            write_atomically(path / MANIFEST, encode_manifest(manifest))
            (path / SHA256SUMS).unlink(missing_ok=True)
            lines = _reopen_lines(path)
            frames = read_lines(path / FRAME_LINES)
            events = read_lines(path / EVENT_LINES)
            pictures = open_picture_writer(path, _read_store(manifest), len(frames))
            (path / RESERVE).unlink(missing_ok=True)
            make_reserve(path)
    except LabrigError:
        lock.release()
        raise
    states = read_lines(path / STATE_LINES)
    t0_s = _next_whole_second((*events, *frames, *states))
    truth = read_lines(path / TRUTH_LINES) if TRUTH_LINES in lines else []
    seq = 1 + max((int(str(line["seq"])) for line in (*events, *frames, *states, *truth)), default=-1)
    sums = _collect_sums(frames, manifest)
    counted = tuple(event for event in events if str(event.get("kind")) in COUNTED)
    return OpenRecord(manifest, sums, lines, lock, pictures, t0_s, len(frames), counted, seq)


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


def _reopen_manifest(manifest: Mapping[str, object], aside: tuple[str, ...], link: Link) -> dict[str, object]:
    """Return the manifest of a run that goes on; it keeps earlier endings and lists what was set aside."""
    content = {key: value for key, value in manifest.items() if key != "crc32"}
    if link.number == 1 and isinstance(hashes := manifest.get("hashes"), Mapping):
        content["hashes"] = {**hashes, "first_link_sha256": link.sha256}
    if manifest["exit_status"] != "incomplete":
        ending = {key: manifest.get(key) for key in ("exit_status", "reason", "ended")}
        content["earlier_endings"] = [*_read_list(content, "earlier_endings"), ending]
    if aside:
        content["set_aside"] = [*_read_list(content, "set_aside"), *aside]
    return {**content, "exit_status": "incomplete", "reason": None, "ended": None}


def _read_list(manifest: Mapping[str, object], key: str) -> list[object]:
    value = manifest.get(key)
    return value if isinstance(value, list) else []


def _copy_closing(path: Path, manifest: Mapping[str, object]) -> Iterator[str]:
    """Copy the sums and the manifest of an earlier closing, and yield their names: they cover only what it closed."""
    if not (path / SHA256SUMS).exists():
        return
    number = 1
    while (path / f"{SHA256SUMS}.{number:03d}").exists():
        number += 1
    copies = {SHA256SUMS: f"{SHA256SUMS}.{number:03d}"}
    if manifest["exit_status"] != "incomplete":
        copies[MANIFEST] = f"manifest.{number:03d}.json"
    for name, copy in copies.items():
        write_atomically(path / copy, read_file(path / name, MAX_LOG_BYTES))
        yield copy


def _reopen_lines(path: Path) -> dict[str, LineFile]:
    sometimes = [name for name in (TRUTH_LINES, CAN_LOG, CAN_SUMS) if (path / name).exists()]
    return {name: LineFile.reopen(path / name) for name in (*ALWAYS_PRESENT, *sometimes)}


def _collect_sums(frames: Iterable[Mapping[str, object]], manifest: dict[str, object]) -> dict[str, str]:
    """Return the SHA-256 of every file that is final already, by its name relative to the run."""
    pictures = {str(line["file"]): str(line["sha256"]) for line in frames if line["file"] != RAW_PICTURES}
    return {name: str(sha256) for name, sha256 in recorded_sha256(manifest).items()} | pictures


def _next_whole_second(lines: Iterable[Mapping[str, object]]) -> float:
    times = [t_s for line in lines if isinstance(t_s := line["t_s"], int | float)]
    return float(math.floor(max(times, default=-1.0)) + 1)
