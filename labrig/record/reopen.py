"""Continue an interrupted run: what an interruption left half written is dropped, everything else is kept."""

import math
import re
from collections.abc import Iterable, Mapping
from datetime import datetime
from pathlib import Path

from labrig.durable import disk_errors, find_temporaries, write_atomically
from labrig.errors import LabrigError, RecordError
from labrig.record.check import find_damage
from labrig.record.json_lines import LineFile, read_lines
from labrig.record.layout import (
    ALWAYS_PRESENT,
    CALIBRATION,
    CAN_LOG,
    DEVICE_LINES,
    EVENT_LINES,
    FRAME_LINES,
    FRAMES,
    LOCK,
    MANIFEST,
    SHA256SUMS,
    STATE_LINES,
    TRUTH_LINES,
    inside,
)
from labrig.record.lock import FileLock
from labrig.record.manifest import (
    INCOMPLETE,
    encode_manifest,
    encode_sums,
    has_ended,
    is_opening_file,
    read_manifest,
    read_sums,
)
from labrig.record.pictures import PictureWriter
from labrig.record.writer import OpenRecord, Recorder, make_reserve

_PICTURE = re.compile(r"\d{6,}\.(png|pgm|ppm)")


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
    read_manifest(path)
    lock = FileLock(inside(path, LOCK)).acquire(doing)
    try:
        return Recorder(path, _reopen(path, lock))
    except LabrigError:
        lock.release()
        raise


def close_interrupted_run(path: Path, doing: str, ended: datetime) -> None:
    """Close a run that was interrupted after its last trial, as a success. Raises as `reopen_run`."""
    recorder = reopen_run(path, doing)
    recorder.event("run_stop", 0.0, exit_status="success", reason="")
    recorder.close("success", "", ended)


def _reopen(path: Path, lock: FileLock) -> OpenRecord:
    manifest = read_manifest(path)
    require_undamaged(path, manifest)
    if manifest["exit_status"] == "success":
        raise RecordError(f"{path} has come to its end; nothing can be added to it")
    frames = read_lines(path / FRAME_LINES)
    events = read_lines(path / EVENT_LINES)
    states = read_lines(path / STATE_LINES)
    truth = read_lines(path / TRUTH_LINES) if (path / TRUTH_LINES).exists() else []
    recording = manifest["recording"]
    assert isinstance(recording, Mapping)
    opening = {name: sha256 for name, sha256 in read_sums(path)[0].items() if is_opening_file(name)}
    with disk_errors(path):
        _drop_leftovers(path, {str(line["file"]) for line in frames})
        reopened = _reopen_manifest(manifest)
        write_atomically(path / MANIFEST, encode_manifest(reopened))
        write_atomically(path / SHA256SUMS, encode_sums(opening))
        sometimes = [name for name in (TRUTH_LINES, CAN_LOG) if (path / name).exists()]
        names = (*ALWAYS_PRESENT, DEVICE_LINES, *sometimes)
        lines = {name: LineFile.reopen(path / name) for name in names}
        make_reserve(path)
    sums = opening | {str(line["file"]): str(line["sha256"]) for line in frames}
    return OpenRecord(
        reopened,
        sums,
        lines,
        lock,
        PictureWriter(path, "pgm" if recording["picture_store"] == "pgm" else "png"),
        t0_s=_next_whole_second((*events, *frames, *states)),
        frames=len(frames),
        events=tuple(events),
        seq=1 + max((int(str(line["seq"])) for line in (*events, *frames, *states, *truth)), default=-1),
    )


def require_undamaged(path: Path, manifest: dict[str, object]) -> None:
    """Refuse a run of which anything is missing or was changed. Raises `RecordError`."""
    damage = list(find_damage(path, manifest, read_pictures=True))
    if damage:
        first, more = damage[0], len(damage) - 1
        others = f", and {more} more" if more else ""
        raise RecordError(
            f"{path} is damaged: {first.where}: {first.message}{others}",
            "labrig runs check lists all; nothing was changed",
        )


def _drop_leftovers(path: Path, listed: set[str]) -> None:
    """Remove temporary files, and a picture whose line was not written: nothing of it was acknowledged."""
    for folder in (path, path / CALIBRATION, path / FRAMES):
        for left in find_temporaries(folder):
            left.unlink()
    for picture in sorted((path / FRAMES).iterdir()):
        if _PICTURE.fullmatch(picture.name) and f"{FRAMES}/{picture.name}" not in listed:
            picture.unlink()


def _reopen_manifest(manifest: Mapping[str, object]) -> dict[str, object]:
    """Return the manifest of a run that goes on; it keeps earlier endings."""
    content = {**manifest, "exit_status": INCOMPLETE, "reason": None, "ended": None, "summary": None}
    if has_ended(manifest):
        earlier = manifest.get("earlier_endings")
        ending = {key: manifest.get(key) for key in ("exit_status", "reason", "ended")}
        content["earlier_endings"] = [*(earlier if isinstance(earlier, list) else ()), ending]
    return content


def _next_whole_second(lines: Iterable[Mapping[str, object]]) -> float:
    times = [t_s for line in lines if isinstance(t_s := line["t_s"], int | float)]
    return float(math.floor(max(times, default=-1.0)) + 1)
