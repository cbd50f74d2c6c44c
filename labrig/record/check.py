"""Verify a record: what is missing or was changed since it was written; nothing is changed."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from labrig.errors import Problem, RecordError
from labrig.record.decisions import count_trials_done
from labrig.record.json_lines import read_lines
from labrig.record.layout import (
    ALWAYS_PRESENT,
    ANALYSIS,
    CAN_LOG,
    CONTROL,
    COPY_HINT,
    DEVICE_LINES,
    EVENT_LINES,
    FRAME_LINES,
    FRAMES,
    LOCK,
    NOTES,
    REPORT,
    SHA256SUMS,
    STATE_LINES,
    TRUTH_LINES,
    VIEW,
    inside,
)
from labrig.record.lock import LockOwner, read_lock_owner
from labrig.record.manifest import check_file, has_ended, is_opening_file, read_manifest, read_sums
from labrig.record.pictures import locate_picture
from labrig.record.results import find_result_problems, list_results

LINE_FILES = (*ALWAYS_PRESENT, DEVICE_LINES, TRUTH_LINES)
_REWRITTEN = frozenset({NOTES, REPORT, VIEW, SHA256SUMS, LOCK, CONTROL})
"""What is rewritten later, or stands there only while a run is made: no checksum covers it."""


@dataclass(frozen=True)
class RunCheck:
    """The findings of a check.

    Attributes
    ----------
    run : Path
        The folder of the run.
    experiment, exit_status : str
        As the manifest states them.
    writer : LockOwner or None
        The process that is writing it now.
    damage : tuple of Problem
        What is missing or was changed.
    notices : tuple of Problem
        Files that are no part of the record, and results that were never finished; neither is used.
    frames, states, events, trials_done : int
        How many of each can be read; of the trials, as `count_trials_done` counts them.
    """

    run: Path
    experiment: str
    exit_status: str
    writer: LockOwner | None
    damage: tuple[Problem, ...]
    notices: tuple[Problem, ...]
    frames: int
    states: int
    events: int
    trials_done: int


def check_run(run: Path) -> RunCheck:
    """Read every file of a run and compare it with its SHA-256.

    Raises
    ------
    RecordError
        When the folder is no run, or its manifest cannot be read.
    """
    manifest = read_manifest(run)
    damage = [*find_damage(run, manifest, read_pictures=True)]
    lines: dict[str, list[dict[str, object]]] = {}
    for name in ALWAYS_PRESENT:
        try:
            lines[name] = read_lines(run / name)
        except RecordError as error:
            lines[name] = []
            if not any(problem.where == name for problem in damage):
                damage.append(Problem(name, error.message, error.hint))
    for number in list_results(run):
        damage += find_result_problems(run, number)
    return RunCheck(
        run,
        str(manifest.get("experiment")),
        str(manifest["exit_status"]),
        read_lock_owner(run / LOCK),
        tuple(damage),
        tuple(_find_strangers(run, manifest, lines[FRAME_LINES])),
        frames=len(lines[FRAME_LINES]),
        states=len(lines[STATE_LINES]),
        events=len(lines[EVENT_LINES]),
        trials_done=count_trials_done(lines[EVENT_LINES]),
    )


def find_damage(run: Path, manifest: Mapping[str, object], *, read_pictures: bool) -> Iterator[Problem]:
    """Yield the recorded files that are missing or do not have their SHA-256.

    Of a run that has not ended, only what it began with has one, and each picture in its line.

    Parameters
    ----------
    read_pictures : bool
        Read each picture too; otherwise only their presence is looked at, and each is verified when it is read.
    """
    ended = has_ended(manifest)
    try:
        sums, wrong = read_sums(run)
    except RecordError as error:
        yield Problem(SHA256SUMS, error.message, error.hint)
        sums, wrong = {}, ()
    for number in wrong:
        yield Problem(f"{SHA256SUMS}:{number}", "the line is no checksum and file name", COPY_HINT)
    expected = {name: sha for name, sha in sums.items() if ended or is_opening_file(name)}
    if not ended:
        expected |= dict.fromkeys(ALWAYS_PRESENT, "") | _list_pictures(run)
    for name, sha256 in expected.items():
        looked_at = read_pictures or not name.startswith(f"{FRAMES}/")
        yield from check_file(run, name, sha256 if looked_at else "", SHA256SUMS if ended else "the record")
    if ended and sums:
        recorded = (*(name for name in (*LINE_FILES, CAN_LOG) if (run / name).exists()), *_list_pictures(run))
        for name in recorded:
            if name not in sums:
                yield Problem(SHA256SUMS, f"it does not list {name}", COPY_HINT)


def _list_pictures(run: Path) -> dict[str, str]:
    """Return the SHA-256 of each picture that a line lists."""
    try:
        lines = read_lines(inside(run, FRAME_LINES))
    except RecordError:
        return {}
    pictures = (locate_picture(run, line) for line in lines)
    return {picture.file: picture.sha256 for picture in pictures if picture is not None}


def _find_strangers(
    run: Path, manifest: Mapping[str, object], frames: Iterable[Mapping[str, object]]
) -> Iterator[Problem]:
    """Yield what stands in the folder of a run and is no part of it."""
    try:
        known = set(read_sums(run)[0])
    except RecordError:
        known = set()
    if not has_ended(manifest):
        known |= {*LINE_FILES, CAN_LOG, "manifest.json", *(str(line.get("file")) for line in frames)}
    for path in sorted(run.rglob("*")):
        name = path.relative_to(run).as_posix()
        is_hidden = any(part.startswith(".") for part in name.split("/"))
        if (
            path.is_dir()
            or is_hidden
            or name in known
            or name in _REWRITTEN
            or name.startswith(f"{ANALYSIS}/")
        ):
            continue
        yield Problem(name, "it is no part of the record and is not used", "move it out of the run")
    for folder in sorted((run / ANALYSIS).glob("*")) if (run / ANALYSIS).is_dir() else ():
        if not (folder / SHA256SUMS).is_file():
            message = "it is no finished result and is not used"
            yield Problem(f"{ANALYSIS}/{folder.name}", message, "labrig reanalyze makes another")
