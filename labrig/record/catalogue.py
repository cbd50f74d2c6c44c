"""Lists the runs of a folder, and finds those that fit a condition."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from labrig.errors import InputError, RecordError
from labrig.record.annotations import read_annotations
from labrig.record.condition import parse_condition, require_field
from labrig.record.fields import ANNOTATION_FIELDS, annotation_fields, file_fields, manifest_fields
from labrig.record.json_lines import read_lines
from labrig.record.layout import ANALYSIS, EVENT_LINES, MANIFEST, NOTES, PROTOCOL, inside
from labrig.record.manifest import is_newer, read_document, read_manifest
from labrig.record.run_index import NO_FILE, Fields, RunIndex, Value, ask_index, signature_of

# What a summary is read from. The manifest stands first: a folder without one is no run.
_SUMMARY_FILES = (MANIFEST, NOTES, EVENT_LINES)


@dataclass(frozen=True)
class RunSummary:
    """One run in a list; what a damaged run does not tell is None.

    Attributes
    ----------
    run : Path
        Its folder.
    protocol : str
        Which experiment: `steerability`, `camera-calibration`, `import` ...
    exit_status : str
        `success`, `aborted`, `failed`, `incomplete`; `newer`, where a newer labrig wrote the run; or `damaged`,
        where the manifest, the events or the notes cannot be read.
    started : str
        When, ISO 8601 in UTC.
    trials_done, trials_planned : int
        Trials that came to their end, and those that the protocol asks for; where the first is unknown, so is the
        second.
    tags : tuple of str
        What people have tagged it with.
    verdict : str
        The operator's: good, doubtful, bad; None while there is none.
    notes : int
        How many notes there are.
    """

    run: Path
    protocol: str | None
    exit_status: str
    started: str | None
    trials_done: int | None
    trials_planned: int | None
    tags: tuple[str, ...] = ()
    verdict: str | None = None
    notes: int = 0


# What a list shows, under the names of its JSON: these, and `run`, can be asked of damaged runs too.
_OF_SUMMARIES = ("protocol", "exit_status", "started", "trials_done")


@dataclass(frozen=True)
class FoundRun:
    """A run that fits, with the values of the fields that it was searched and sorted by."""

    summary: RunSummary
    fields: Mapping[str, tuple[Value, ...]]


def list_runs(runs_dir: Path) -> list[RunSummary]:
    """List the runs of a folder, newest first; damaged ones at the end, other folders and links not at all.

    Parameters
    ----------
    runs_dir : Path
        Folder of runs. One that does not exist yet has none.

    Raises
    ------
    InputError
        When it is a file, or cannot be read.
    """
    return [found.summary for found in find_runs(runs_dir)]


def find_runs(
    runs_dir: Path, where: str | None = None, sort: str | None = None, *, reverse: bool = False
) -> list[FoundRun]:
    """Find the runs of a folder that fit a condition.

    Parameters
    ----------
    where : str or None
        The condition, as `labrig.record.condition` describes it; None: every run.
    sort : str or None
        The field to sort by, smallest first, runs without it last; None: newest first.
    reverse : bool
        Turn that order round; runs without the field stay last.

    Raises
    ------
    InputError
        When the condition cannot be read, or names a field that no run has.
    """
    condition = None if where is None else parse_condition(where)
    names = [] if condition is None else [name for name, _ in condition.names]
    names = list(dict.fromkeys([*names, *([] if sort is None else [sort])]))
    root = os.fspath(runs_dir)
    signatures = {name: signature_of(f"{root}/{name}", _SUMMARY_FILES) for name in _folders(runs_dir)}
    signatures = {name: one for name, one in signatures.items() if not one.startswith(NO_FILE)}
    if not signatures:
        return []
    summary_row = cache(lambda name: _summary_row(runs_dir / name))
    fields = cache(lambda name: _fields(runs_dir / name, summary_row(name)))

    def ask(index: RunIndex) -> list[FoundRun]:
        rows = index.summaries(signatures, summary_row)
        values: Mapping[str, Mapping[str, tuple[Value, ...]]] = {name: {} for name in rows}
        if names:
            whole = {name: f"{one} {_field_signature(f'{root}/{name}')}" for name, one in signatures.items()}
            index.refresh_leaves(whole, fields)
            known = index.known_paths().keys() | ANNOTATION_FIELDS
            if condition is not None:
                condition.require_known(known)
            if sort is not None:
                require_field(sort, known, "--sort")
            values = index.find(names, condition)
        return [
            FoundRun(_summary(runs_dir / name, row), values[name])
            for name, row in rows.items()
            if name in values
        ]

    newest_first = sorted(ask_index(runs_dir, ask), key=lambda run: run.summary.started or "", reverse=True)
    return _in_order(newest_first, sort, reverse)


def _summary(run: Path, row: Mapping[str, Any]) -> RunSummary:
    return RunSummary(run, **{**row, "tags": tuple(row["tags"])})


def _in_order(found: list[FoundRun], sort: str | None, reverse: bool) -> list[FoundRun]:
    if sort is None:
        return found[::-1] if reverse else found
    having = [run for run in found if any(value is not None for value in run.fields[sort])]
    lacking = [run for run in found if all(value is None for value in run.fields[sort])]
    return sorted(having, key=lambda run: _sort_key(run.fields[sort]), reverse=reverse) + lacking


def _sort_key(values: Sequence[Value]) -> tuple[int, float, str]:
    """Order numbers before text; of several values the first counts."""
    value = next(each for each in values if each is not None)
    return (1, 0.0, value) if isinstance(value, str) else (0, float(value), "")


def _folders(runs_dir: Path) -> list[str]:
    try:
        with os.scandir(runs_dir) as entries:
            return sorted(entry.name for entry in entries if entry.is_dir(follow_symlinks=False))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot list {runs_dir}: {error.strerror}", "give a folder of runs") from error


def _field_signature(run: str) -> str:
    """Return the signature of what fields are read from, beyond what summaries are."""
    try:
        numbers = sorted(os.listdir(f"{run}/{ANALYSIS}"))  # noqa: PTH208 - thousands of them
    except OSError:
        numbers = []
    return signature_of(run, (PROTOCOL, *(f"{ANALYSIS}/{number}/result.json" for number in numbers)))


def _fields(run: Path, summary: Mapping[str, Any]) -> Fields:
    """Return all that may be asked of a run; of a damaged one, or of one of a newer labrig, what a list shows of it."""
    shown = {"run": [run.name], **{name: [summary[name]] for name in _OF_SUMMARIES}}
    try:
        document = read_document(run)
        if is_newer(document):
            return shown
        said = annotation_fields(read_annotations(run))
        return {**shown, **manifest_fields(document), **file_fields(run), **said}
    except RecordError:
        return shown


def _summary_row(run: Path) -> dict[str, Any]:
    row: dict[str, Any] = {
        "protocol": None,
        "exit_status": "damaged",
        "started": None,
        "trials_done": None,
        "trials_planned": None,
        "tags": [],
    }
    try:
        document = read_document(run)
        if is_newer(document):
            # Its other members may mean something else by now.
            return {**row, "protocol": _text(document.get("experiment")), "exit_status": "newer"}
        return row | _intact_row(run, read_manifest(run))
    except RecordError:
        return row


def _intact_row(run: Path, manifest: dict[str, object]) -> dict[str, object]:
    exit_status = str(manifest.get("exit_status"))
    done = _trials_done(run) if exit_status == "incomplete" else _whole(manifest.get("trials_done"))
    said = read_annotations(run)
    return {
        "protocol": _text(manifest.get("experiment")),
        "exit_status": exit_status,
        "started": _text(manifest.get("started")),
        "trials_done": done,
        "trials_planned": None if done is None else _whole(manifest.get("trials_planned")),
        "tags": list(said.tags),
        "verdict": said.verdict,
        "notes": len(said.notes),
    }


def _trials_done(run: Path) -> int:
    """Count the trials of a run whose manifest was not brought up to date."""
    events = read_lines(inside(run, EVENT_LINES))
    return sum(
        event.get("kind") == "trial_stop" and event.get("exit_status") == "success" for event in events
    )


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) else None
