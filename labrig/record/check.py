"""Checks a record from end to end, and says what of it is damaged or lost; changes nothing."""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from labrig.errors import Problem, RecordError
from labrig.record.can_log import read_can_log
from labrig.record.json_lines import Scan, scan_lines
from labrig.record.layout import (
    CAN_LOG,
    CAN_SUMS,
    COPY_HINT,
    EVENT_LINES,
    FRAME_LINES,
    FRAMES,
    LOCK,
    NOTES,
    RAW_PICTURES,
    SHA256SUMS,
    STATE_LINES,
    TRUTH_LINES,
    inside,
    picture_file,
)
from labrig.record.lock import LockOwner, lock_owner
from labrig.record.manifest import manifest_problems, read_manifest, recorded_sha256
from labrig.record.pictures import listed_raw_bytes, raw_pictures_bytes, recorded_picture
from labrig.record.structure import (
    clock_problems,
    frame_problems,
    reference_problems,
    trial_problems,
)

LINE_FILES = (FRAME_LINES, STATE_LINES, EVENT_LINES, TRUTH_LINES, CAN_SUMS)
_OF_LINES = (*LINE_FILES, CAN_LOG)
_ONLY_SOMETIMES = frozenset({TRUTH_LINES, CAN_SUMS})
_NO_LINES = Scan((), (), (), 0, ends_with_newline=True)
_LEFT = "labrig was stopped while it wrote this; labrig runs check --repair sets it aside"


@dataclass(frozen=True)
class Verdict:
    """What a check has found.

    Attributes
    ----------
    run : Path
        The folder of the run.
    experiment : str
        Which it is.
    exit_status : str
        As the manifest has it.
    writer : LockOwner or None
        Who is writing it now.
    damage : tuple of Problem
        What is missing or is not as it was written.
    torn : tuple of Problem
        What an interruption left half written; nothing acknowledged is in it.
    frames, states, events, trials_done : int
        How much there is that can be read.
    """

    run: Path
    experiment: str
    exit_status: str
    writer: LockOwner | None
    damage: tuple[Problem, ...]
    torn: tuple[Problem, ...]
    frames: int
    states: int
    events: int
    trials_done: int


def check_run(run: Path) -> Verdict:
    """Verify hashes, checksums and structure of a run.

    Raises
    ------
    RecordError
        When it is no run, of a newer schema, or its manifest cannot be read.
    """
    manifest = read_manifest(run)
    closed = manifest.get("exit_status") != "incomplete"
    scans, unreadable = _scans(run)
    frames, events = scans[FRAME_LINES].lines, scans[EVENT_LINES].lines
    torn, orphans = _leftovers(run, len(frames))
    torn = (*(problem for scan in scans.values() for problem in scan.torn), *torn, *_unlisted(run, frames))
    damage = [
        *links(run, run),
        *manifest_problems(manifest),
        *changed_since_start(run, manifest),
        *unreadable,
        *(problem for scan in scans.values() for problem in scan.damaged),
        *_structure(scans),
        *_notes(run),
        *picture_problems(run, (line for _, line in frames), read=True),
        *orphans,
    ]
    can_damage, can_torn = _can_log(run)
    damage += can_damage
    torn = (*torn, *can_torn)
    if closed:
        # Whoever closed the run had written its last lines: here a torn one was cut afterwards.
        damage += [replace(problem, hint=COPY_HINT) for problem in torn]
        damage += changed_since_closing(run)
        torn = ()
    return Verdict(
        run,
        str(manifest.get("experiment")),
        str(manifest.get("exit_status")),
        lock_owner(run / LOCK),
        tuple(dict.fromkeys(damage)),
        torn,
        frames=len(frames),
        states=len(scans[STATE_LINES].lines),
        events=len(events),
        trials_done=trials_done(event for _, event in events),
    )


def trials_done(events: Iterable[Mapping[str, object]]) -> int:
    """Count the trials that came to their end."""
    return sum(
        event.get("kind") == "trial_stop" and event.get("exit_status") == "success" for event in events
    )


def _scans(run: Path) -> tuple[dict[str, Scan], list[Problem]]:
    """Read every file of lines; of one that cannot be read there are no lines, and a problem."""
    scans, problems = {}, []
    for name in LINE_FILES:
        scans[name] = _NO_LINES
        try:
            path = inside(run, name)
            if path.exists() or name not in _ONLY_SOMETIMES:
                scans[name] = scan_lines(path)
        except RecordError as error:
            problems.append(Problem(name, error.message, error.hint))
    return scans, problems


def _notes(run: Path) -> Iterator[Problem]:
    """Check what people said of the run; it grows after the closing, and a torn last remark is left out by readers."""
    path = run / NOTES
    if path.is_file() and not path.is_symlink():
        yield from scan_lines(path).damaged


def _structure(scans: Mapping[str, Scan]) -> Iterator[Problem]:
    frames, events = scans[FRAME_LINES].lines, scans[EVENT_LINES].lines
    for name in (FRAME_LINES, STATE_LINES, EVENT_LINES):
        yield from clock_problems(name, scans[name].lines)
    yield from frame_problems(frames)
    yield from trial_problems(events)
    yield from reference_problems(events, frames, scans[TRUTH_LINES].lines)


def links(run: Path, folder: Path) -> Iterator[Problem]:
    """Yield the symbolic links below a folder of the run."""
    for parent, folders, files in os.walk(folder):
        for name in sorted((*folders, *files)):
            path = Path(parent, name)
            if path.is_symlink():
                message = "it is a symbolic link and is not followed"
                yield Problem(path.relative_to(run).as_posix(), message, "a record holds its files itself")


def changed_since_start(run: Path, manifest: dict[str, object]) -> Iterator[Problem]:
    """Compare protocol, rig, calibration and differences of the code with what the manifest says of them."""
    for name, sha256 in recorded_sha256(manifest).items():
        yield from _changed(run, name, str(sha256), "the manifest")


def _changed(run: Path, name: str, sha256: str, by: str) -> Iterator[Problem]:
    try:
        path = inside(run, name)
        if not path.is_file():
            yield Problem(name, f"it is missing, though {by} lists it", COPY_HINT)
        elif sha256_of(path) != sha256:
            yield Problem(name, f"it was changed or is damaged: its SHA-256 does not fit {by}", COPY_HINT)
    except RecordError as error:
        yield Problem(name, error.message, error.hint)


def picture_problems(run: Path, frames: Iterable[Mapping[str, object]], *, read: bool) -> Iterator[Problem]:
    """Yield the pictures that are missing, and with `read` those that are not as they were recorded.

    A picture stands in its place before its line does; another place is a fault of its line.
    """
    end = 0
    for line in frames:
        picture = recorded_picture(run, line)
        if picture is None:
            continue
        end = max(end, picture.end)
        if picture.shape is None and (read or not (run / picture.file).exists()):
            yield from _changed(run, picture.file, picture.sha256, FRAME_LINES)
        elif picture.shape is not None and read:
            try:
                picture.read()
            except RecordError as error:
                yield Problem(f"{RAW_PICTURES} (frame {line['frame']})", error.message, error.hint)
    lost = end - raw_pictures_bytes(run)
    if lost > 0:
        message = f"its last {lost} bytes are missing, though {FRAME_LINES} lists them"
        yield Problem(RAW_PICTURES, message, COPY_HINT)


def _leftovers(run: Path, frames: int) -> tuple[tuple[Problem, ...], tuple[Problem, ...]]:
    """Return what an interruption left of pictures, and pictures whose line has been lost."""
    next_picture = picture_file(frames)
    torn, lost = [], []
    for name in leftover_pictures(run, frames):
        if name == next_picture or name.endswith(".tmp"):
            torn.append(Problem(name, f"it has no line in {FRAME_LINES}", _LEFT))
        else:
            lost.append(
                Problem(name, f"its line in {FRAME_LINES} is lost", f"take {FRAME_LINES} from a copy")
            )
    return tuple(torn), tuple(lost)


def _unlisted(run: Path, frames: Iterable[tuple[int, dict[str, object]]]) -> Iterator[Problem]:
    """Yield the end of frames.raw that no line lists."""
    more = raw_pictures_bytes(run) - listed_raw_bytes(run, (line for _, line in frames))
    if more > 0:
        yield Problem(RAW_PICTURES, f"its last {more} bytes have no line in {FRAME_LINES}", _LEFT)


def leftover_pictures(run: Path, frames: int) -> list[str]:
    """Return the files of frames/ that are none of the first `frames` pictures, relative to the run."""
    folder = run / FRAMES
    if folder.is_symlink() or not folder.is_dir():
        return []
    listed = {picture_file(number) for number in range(frames)}
    return sorted({f"{FRAMES}/{path.name}" for path in folder.iterdir()} - listed)


def _can_log(run: Path) -> tuple[tuple[Problem, ...], tuple[Problem, ...]]:
    try:
        log = read_can_log(run)
        if not log.damaged:
            for _ in log.frames():
                pass
    except RecordError as error:
        return (Problem(CAN_LOG, error.message, error.hint),), ()
    return log.damaged, log.torn


def changed_since_closing(run: Path, *, lines_only: bool = False) -> Iterator[Problem]:
    """Compare the raw files of a closed run, or its files of lines, with SHA256SUMS; lines that were cut off show."""
    path = run / SHA256SUMS
    if path.is_symlink() or not path.is_file():
        yield Problem(SHA256SUMS, "it is missing, though the run was closed", COPY_HINT)
        return
    listed = set()
    for number, line in enumerate(path.read_bytes().decode(errors="replace").splitlines(), start=1):
        sha256, blanks, name = line[:64], line[64:66], line[66:]
        if blanks != "  " or not name or any(part in {"", ".", ".."} for part in name.split("/")):
            yield Problem(f"{SHA256SUMS}:{number}", "the line is no checksum and file name", COPY_HINT)
            continue
        listed.add(name)
        if name in _OF_LINES or not lines_only:
            yield from _changed(run, name, sha256, SHA256SUMS)
    for name in _OF_LINES:
        if name not in listed and (run / name).exists():
            yield Problem(name, f"it is not listed in {SHA256SUMS}", COPY_HINT)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file. Raises `RecordError` where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
