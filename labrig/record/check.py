"""Verify a record: what is missing or was changed since it was written; nothing is changed."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from labrig.errors import Problem, RecordError
from labrig.record import layout
from labrig.record.events import count_trials_done
from labrig.record.json_lines import read_lines
from labrig.record.layout import (
    ALWAYS_PRESENT,
    ANALYSIS,
    SHA256SUMS,
    find_added,
    find_changed,
    has_ended,
    inside,
    is_opening_file,
    read_manifest,
    read_sums,
)
from labrig.record.lock import LockOwner, read_lock_owner
from labrig.record.pictures import locate_pictures
from labrig.record.results import find_result_problems, list_results

_RECORDED = (*ALWAYS_PRESENT, layout.DEVICE_LINES, layout.TRUTH_LINES, layout.CAN_LOG)


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
    holds : Mapping
        How many `frames`, `states` and `events` can be read, and `trials_done`, as `count_trials_done` counts them.
    """

    run: Path
    experiment: str
    exit_status: str
    writer: LockOwner | None
    damage: tuple[Problem, ...]
    notices: tuple[Problem, ...]
    holds: Mapping[str, int]


def check_run(run: Path) -> RunCheck:
    """Read every file of a run and compare it with its SHA-256.

    Raises
    ------
    RecordError
        When the folder is no run, or its manifest cannot be read.
    """
    manifest = read_manifest(run)
    damage = [*find_damage(run, manifest, read_pictures=True)]
    lines: dict[str, list[dict[str, object]]] = {name: [] for name in ALWAYS_PRESENT}
    done = 0
    for name in ALWAYS_PRESENT:
        try:
            lines[name] = read_lines(run / name)
            done = count_trials_done(run, lines[layout.EVENT_LINES])
        except RecordError as error:
            if not any(problem.where == name for problem in damage):
                damage.append(Problem(name, error.message, error.hint))
    for number in list_results(run):
        damage += find_result_problems(run, number)
    return RunCheck(
        run,
        str(manifest.get("experiment")),
        str(manifest["exit_status"]),
        read_lock_owner(run / layout.LOCK),
        tuple(damage),
        tuple(_find_strangers(run, manifest)),
        {**{name.removesuffix(".jsonl"): len(lines[name]) for name in ALWAYS_PRESENT}, "trials_done": done},
    )


def find_damage(run: Path, manifest: Mapping[str, object], *, read_pictures: bool) -> Iterator[Problem]:
    """Yield the recorded files that are missing or do not have their SHA-256.

    Of a run that has not ended, only what it began with has one, and each picture in its line.

    Parameters
    ----------
    read_pictures : bool
        Read each picture too; otherwise only their presence is looked at, and each is verified when it is read.
    """
    try:
        sums = read_sums(run)
    except RecordError as error:
        yield Problem(SHA256SUMS, error.message, error.hint)
        return
    if has_ended(manifest):
        expected, by = sums, SHA256SUMS
        there = [name for name in _RECORDED if (run / name).exists()]
        for name in {*there, *_list_pictures(run)} - sums.keys():
            yield Problem(SHA256SUMS, f"it does not list {name}", layout.COPY_HINT)
    else:
        expected, by = _list_recorded(run, sums), "the record"
    unread = {} if read_pictures else {name: "" for name in expected if name.startswith(f"{layout.FRAMES}/")}
    yield from find_changed(run, {**expected, **unread}, by)


def _list_recorded(run: Path, sums: Mapping[str, str]) -> dict[str, str]:
    """Return the SHA-256 of each file of a run that has not ended; empty of those that still grow."""
    opening = {name: sha for name, sha in sums.items() if is_opening_file(name)}
    return opening | dict.fromkeys(ALWAYS_PRESENT, "") | _list_pictures(run)


def _list_pictures(run: Path) -> dict[str, str]:
    """Return the SHA-256 of each picture that a line lists."""
    with suppress(RecordError):
        pictures = locate_pictures(run, read_lines(inside(run, layout.FRAME_LINES)))
        return {picture.line.file: picture.line.sha256 for picture in pictures}
    return {}


def _find_strangers(run: Path, manifest: Mapping[str, object]) -> Iterator[Problem]:
    """Yield what stands in the folder of a run and is no part of it."""
    known = {layout.NOTES, layout.REPORT, layout.VIEW}  # what is written again later: no checksum covers it
    with suppress(RecordError):
        sums = read_sums(run)
        known |= (
            set(sums) if has_ended(manifest) else {*_list_recorded(run, sums), *_RECORDED, layout.MANIFEST}
        )
    for problem in find_added(run, known):
        if not problem.where.startswith(f"{ANALYSIS}/"):
            yield problem
    for folder in sorted((run / ANALYSIS).glob("*")):
        if not (folder / SHA256SUMS).is_file():
            message = "it is no finished result and is not used"
            yield Problem(f"{ANALYSIS}/{folder.name}", message, "labrig reanalyze makes another")
