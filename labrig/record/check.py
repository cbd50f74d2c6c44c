"""Check a record from end to end and list what is damaged or lost; nothing is changed."""

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from labrig.errors import Problem, RecordError
from labrig.input_file import MAX_LOG_BYTES, read_file
from labrig.record.can_log import read_can_log
from labrig.record.chain import Link, is_inner_name
from labrig.record.digest import hash_file
from labrig.record.intact import is_intact, remember_intact
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
    is_picture_file,
    picture_file,
)
from labrig.record.lock import LockOwner, read_lock_owner
from labrig.record.manifest import check_manifest, read_manifest, recorded_sha256
from labrig.record.pictures import (
    RecordedPicture,
    locate_picture,
    measure_listed_pictures,
    measure_raw_pictures,
)
from labrig.record.seal import check_seal
from labrig.record.structure import (
    find_clock_problems,
    find_frame_problems,
    find_reference_problems,
    find_trial_problems,
)
from labrig.record.trial_count import count_trials_done

Look = Literal["presence", "once", "always"]

LINE_FILES = (FRAME_LINES, STATE_LINES, EVENT_LINES, TRUTH_LINES, CAN_SUMS)
_HASHED_LINE_FILES = (*LINE_FILES, CAN_LOG)
_ONLY_SOMETIMES = frozenset({TRUTH_LINES, CAN_SUMS})
_NO_LINES = Scan((), (), (), 0, ends_with_newline=True)
_LEFT_BEHIND = "labrig was stopped while it wrote this; labrig runs check --repair sets it aside"


@dataclass(frozen=True)
class RunCheck:
    """The findings of a check.

    Attributes
    ----------
    run : Path
        The folder of the run.
    experiment : str
        The name of its experiment.
    exit_status : str
        As the manifest states it.
    writer : LockOwner or None
        The process that is writing it now.
    damage : tuple of Problem
        Everything that is missing or was changed.
    torn : tuple of Problem
        What an interruption left half written; nothing acknowledged is in it.
    frames, states, events, trials_done : int
        How many of each can be read; of the trials, as `count_trials_done` counts them.
    notices : tuple of Problem
        Files that are no part of the record, and results and annotations without a link; none of them is used.
    seal : str
        `sealed`, `open`, `unsealed` or `unsealed (made before)`, as `SealCheck` has them; `broken` where there is
        damage.
    links : tuple of Link
        The chain.
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
    notices: tuple[Problem, ...] = ()
    seal: str = "open"
    links: tuple[Link, ...] = ()

    @property
    def root(self) -> Link | None:
        """The newest link that closes the run."""
        return next((link for link in reversed(self.links) if link.kind == "close"), None)


def check_run(run: Path) -> RunCheck:
    """Verify hashes, checksums and structure of a run.

    Raises
    ------
    RecordError
        When the folder is no run, its schema is newer, or its manifest cannot be read.
    """
    manifest = read_manifest(run)
    found = _check_files(run, manifest)
    seal = check_seal(run, manifest, _list_summed(run))
    damage = (*found.damage, *leave_out_named(seal.damage, found.damage))
    state = "broken" if damage and seal.links else seal.state
    return replace(found, damage=damage, notices=seal.notices, seal=state, links=seal.links)


def check_closing(run: Path, manifest: dict[str, object]) -> tuple[Problem, ...]:
    """Return what `check_run` would call damaged of a run whose last file, this manifest, is about to be written."""
    try:
        return _check_files(run, manifest).damage
    except RecordError as error:
        return (Problem(run.name, error.message, error.hint),)


def _check_files(run: Path, manifest: dict[str, object]) -> RunCheck:
    scans, unreadable = _scan_files(run)
    frames, events = scans[FRAME_LINES].lines, scans[EVENT_LINES].lines
    leftovers, orphans = _find_leftovers(run, len(frames))
    can_damage, can_torn = _check_can_log(run)
    picture_damage = tuple(find_picture_problems(run, (line for _, line in frames), look="always"))
    torn = [
        *(problem for scan in scans.values() for problem in scan.torn),
        *leftovers,
        *_find_unlisted_end(run, frames),
        *can_torn,
    ]
    damage = [
        *find_links(run, run),
        *check_manifest(manifest),
        *find_changes_since_start(run, manifest),
        *unreadable,
        *(problem for scan in scans.values() for problem in scan.damaged),
        *_check_structure(scans),
        *_check_notes(run),
        *picture_damage,
        *orphans,
        *can_damage,
    ]
    if manifest.get("exit_status") != "incomplete":
        hashed = _list_intact_pictures(run, frames, picture_damage)
        damage += [*as_damage(torn), *find_changes_since_closing(run, hashed=hashed)]
        torn = []
    return RunCheck(
        run,
        str(manifest.get("experiment")),
        str(manifest.get("exit_status")),
        read_lock_owner(run / LOCK),
        tuple(dict.fromkeys(damage)),
        tuple(torn),
        frames=len(frames),
        states=len(scans[STATE_LINES].lines),
        events=len(events),
        trials_done=count_trials_done(event for _, event in events),
    )


def as_damage(torn: Iterable[Problem]) -> Iterator[Problem]:
    """Return the torn ends of a closed run as damage: its last lines were whole, so they were cut afterwards."""
    return (replace(problem, hint=COPY_HINT) for problem in torn)


def _scan_files(run: Path) -> tuple[dict[str, Scan], list[Problem]]:
    """Read every file of lines; a file that cannot be read gives no lines and a problem."""
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


def _check_notes(run: Path) -> Iterator[Problem]:
    """Check the annotations. They grow after the run is closed, and readers skip a torn last remark."""
    path = run / NOTES
    if path.is_file() and not path.is_symlink():
        yield from scan_lines(path).damaged


def _check_structure(scans: Mapping[str, Scan]) -> Iterator[Problem]:
    frames, events = scans[FRAME_LINES].lines, scans[EVENT_LINES].lines
    for name in (FRAME_LINES, STATE_LINES, EVENT_LINES):
        yield from find_clock_problems(name, scans[name].lines)
    yield from find_frame_problems(frames)
    yield from find_trial_problems(events)
    yield from find_reference_problems(events, frames, scans[TRUTH_LINES].lines)


def find_links(run: Path, folder: Path) -> Iterator[Problem]:
    """Yield the symbolic links below a folder of the run."""
    for parent, folders, files in os.walk(folder):
        for name in sorted((*folders, *files)):
            path = Path(parent, name)
            if path.is_symlink():
                message = "it is a symbolic link and is not followed"
                yield Problem(path.relative_to(run).as_posix(), message, "a record holds its files itself")


def find_changes_since_start(run: Path, manifest: dict[str, object]) -> Iterator[Problem]:
    """Compare protocol, rig, calibration and code differences with their hashes in the manifest."""
    for name, sha256 in recorded_sha256(manifest).items():
        yield from _check_hash(run, name, str(sha256), "the manifest")


def _check_hash(run: Path, name: str, sha256: str, by: str) -> Iterator[Problem]:
    try:
        path = inside(run, name)
        if not path.is_file():
            yield Problem(name, f"it is missing, though {by} lists it", COPY_HINT)
        elif hash_file(path) != sha256:
            yield Problem(name, f"it was changed or is damaged: its SHA-256 does not fit {by}", COPY_HINT)
    except RecordError as error:
        yield Problem(name, error.message, error.hint)


def find_picture_problems(
    run: Path, frames: Iterable[Mapping[str, object]], *, look: Look
) -> Iterator[Problem]:
    """Yield the pictures that are missing, and those that were changed.

    A picture is in place before its line is written; a wrong place is a fault of the line.

    Parameters
    ----------
    look : {"presence", "once", "always"}
        Whether pictures are read: not at all, if this process has not found them intact already, or all of them.
    """
    end = 0
    for line in frames:
        picture = locate_picture(run, line)
        if picture is None:
            continue
        end = max(end, picture.end)
        identity = None if look == "always" else picture.identify()
        is_there = identity is not None or picture.shape is not None
        if is_intact(identity) or (look == "presence" and is_there):
            continue
        problems = tuple(_check_picture(picture, line["frame"]))
        yield from problems
        if not problems and look == "once":
            remember_intact(identity)
    lost = end - measure_raw_pictures(run)
    if lost > 0:
        message = f"its last {lost} bytes are missing, though {FRAME_LINES} lists them"
        yield Problem(RAW_PICTURES, message, COPY_HINT)


def _check_picture(picture: RecordedPicture, frame: object) -> Iterator[Problem]:
    if picture.shape is None:
        yield from _check_hash(picture.run, picture.file, picture.sha256, FRAME_LINES)
        return
    try:
        picture.check()
    except RecordError as error:
        yield Problem(f"{RAW_PICTURES} (frame {frame})", error.message, error.hint)


def _list_intact_pictures(
    run: Path, frames: Iterable[tuple[int, Mapping[str, object]]], damage: Iterable[Problem]
) -> Mapping[str, str]:
    """Return the SHA-256 of each picture file that has just been read and has it."""
    damaged = {problem.where for problem in damage}
    pictures = (locate_picture(run, line) for _, line in frames)
    files = (picture for picture in pictures if picture is not None and picture.shape is None)
    return {picture.file: picture.sha256 for picture in files if picture.file not in damaged}


def _find_leftovers(run: Path, frames: int) -> tuple[tuple[Problem, ...], tuple[Problem, ...]]:
    """Return the pictures that an interruption left half recorded, and those whose line is lost or that are foreign."""
    next_picture = picture_file(frames)
    torn, lost = [], []
    for name in list_leftover_pictures(run, frames):
        if name == next_picture or name.endswith(".tmp"):
            torn.append(Problem(name, f"it has no line in {FRAME_LINES}", _LEFT_BEHIND))
        elif not is_picture_file(name):
            message = "nothing lists it: it is no picture of labrig's and is not used"
            lost.append(Problem(name, message, "move it out of the run"))
        else:
            lost.append(
                Problem(name, f"its line in {FRAME_LINES} is lost", f"take {FRAME_LINES} from a copy")
            )
    return tuple(torn), tuple(lost)


def _find_unlisted_end(run: Path, frames: Iterable[tuple[int, dict[str, object]]]) -> Iterator[Problem]:
    """Yield the end of frames.raw that no line lists."""
    more = measure_raw_pictures(run) - measure_listed_pictures(run, (line for _, line in frames))
    if more > 0:
        yield Problem(RAW_PICTURES, f"its last {more} bytes have no line in {FRAME_LINES}", _LEFT_BEHIND)


def list_leftover_pictures(run: Path, frames: int) -> list[str]:
    """Return the files in frames/ beyond the first `frames` pictures, relative to the run."""
    folder = run / FRAMES
    if folder.is_symlink() or not folder.is_dir():
        return []
    listed = {picture_file(number) for number in range(frames)}
    return sorted({f"{FRAMES}/{path.name}" for path in folder.iterdir()} - listed)


def _check_can_log(run: Path) -> tuple[tuple[Problem, ...], tuple[Problem, ...]]:
    try:
        log = read_can_log(run)
        if not log.damaged:
            log.require_frames()
    except RecordError as error:
        return (Problem(CAN_LOG, error.message, error.hint),), ()
    return log.damaged, log.torn


def find_changes_since_closing(
    run: Path, *, lines_only: bool = False, hashed: Mapping[str, str] = MappingProxyType({})
) -> Iterator[Problem]:
    """Compare the raw files of a closed run, or only its files of lines, with SHA256SUMS; this finds cut lines.

    `hashed` has the SHA-256 of files that need not be read again.
    """
    path = run / SHA256SUMS
    if path.is_symlink() or not path.is_file():
        yield Problem(SHA256SUMS, "it is missing, though the run was closed", COPY_HINT)
        return
    listed = set()
    for number, line in enumerate(_split_sums(path), start=1):
        sha256, name = line[:64], line[66:]
        if not _is_sum(line):
            yield Problem(f"{SHA256SUMS}:{number}", "the line is no checksum and file name", COPY_HINT)
            continue
        listed.add(name)
        if (name in _HASHED_LINE_FILES or not lines_only) and hashed.get(name) != sha256:
            yield from _check_hash(run, name, sha256, SHA256SUMS)
    for name in _HASHED_LINE_FILES:
        if name not in listed and (run / name).exists():
            yield Problem(name, f"it is not listed in {SHA256SUMS}", COPY_HINT)


def leave_out_named(problems: Iterable[Problem], damage: Iterable[Problem]) -> list[Problem]:
    """Return the problems of files that the damage does not name yet."""
    named = {problem.where.partition(":")[0] for problem in damage}
    return [problem for problem in problems if problem.where not in named]


def _list_summed(run: Path) -> frozenset[str]:
    """Return the files that SHA256SUMS lists; none without it."""
    path = run / SHA256SUMS
    if path.is_symlink() or not path.is_file():
        return frozenset()
    return frozenset(line[66:] for line in _split_sums(path) if _is_sum(line))


def _is_sum(line: str) -> bool:
    return line[64:66] == "  " and is_inner_name(line[66:])


def _split_sums(path: Path) -> list[str]:
    try:
        return read_file(path, MAX_LOG_BYTES).decode(errors="replace").splitlines()
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
