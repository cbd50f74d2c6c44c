"""Lists the runs of a folder, and finds those that fit a condition."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.errors import InputError, RecordError
from labrig.record.annotations import read_annotations
from labrig.record.condition import Condition, Fields, Value, parse_condition, require_field, values_of
from labrig.record.fields import ANNOTATION_FIELDS, annotation_fields, file_fields, manifest_fields
from labrig.record.json_lines import read_lines
from labrig.record.layout import ANALYSIS, EVENT_LINES, MANIFEST, NOTES, PROTOCOL, inside
from labrig.record.manifest import is_newer, read_document, read_manifest
from labrig.record.run_index import remembered, signature_of

# What a summary is read from, and what the fields of a run are.
_SUMMARY_FILES = (MANIFEST, NOTES, EVENT_LINES)
_FIELD_FILES = (MANIFEST, NOTES, EVENT_LINES, PROTOCOL)


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
    root = os.fspath(runs_dir)
    signatures = {name: signature_of(f"{root}/{name}", _SUMMARY_FILES) for name in _run_names(runs_dir)}
    rows = remembered(runs_dir, "summary", signatures, lambda name: _summary_row(runs_dir / name))
    summaries = [_summary(runs_dir / name, row) for name, row in rows.items()]
    return sorted(summaries, key=lambda summary: summary.started or "", reverse=True)


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
    names = _names_asked_for(condition, sort)
    summaries = list_runs(runs_dir)
    fields = _fields_of(runs_dir, summaries) if names else [{} for _ in summaries]
    known = {path for each in fields for path in each} | ANNOTATION_FIELDS
    if summaries and condition is not None:
        condition.require_known(known)
    if summaries and sort is not None:
        require_field(sort, known, "--sort")
    found = [
        FoundRun(summary, {name: values_of(name, each) for name in names})
        for summary, each in zip(summaries, fields, strict=True)
        if condition is None or condition.holds(each)
    ]
    return _in_order(found, sort, reverse)


def _summary(run: Path, row: Mapping[str, Any]) -> RunSummary:
    return RunSummary(
        run,
        row["protocol"],
        row["exit_status"],
        row["started"],
        row["trials_done"],
        row["trials_planned"],
        tuple(row["tags"]),
        row.get("verdict"),
        row.get("notes", 0),
    )


def _names_asked_for(condition: Condition | None, sort: str | None) -> tuple[str, ...]:
    names = [] if condition is None else [name for name, _ in condition.names]
    return tuple(dict.fromkeys([*names, *([] if sort is None else [sort])]))


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


def _run_names(runs_dir: Path) -> list[str]:
    try:
        with os.scandir(runs_dir) as entries:
            folders = [entry.name for entry in entries if entry.is_dir(follow_symlinks=False)]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot list {runs_dir}: {error.strerror}", "give a folder of runs") from error
    root = os.fspath(runs_dir)
    return sorted(name for name in folders if os.path.isfile(f"{root}/{name}/{MANIFEST}"))  # noqa: PTH113 - thousands of them


def _fields_of(runs_dir: Path, summaries: Sequence[RunSummary]) -> list[Fields]:
    signatures = {
        summary.run.name: signature_of(os.fspath(summary.run), (*_FIELD_FILES, *_result_files(summary.run)))
        for summary in summaries
    }
    rows = remembered(runs_dir, "fields", signatures, lambda name: _fields_row(runs_dir / name))
    return [{**_summary_fields(summary), **rows[summary.run.name]["fields"]} for summary in summaries]


def _result_files(run: Path) -> list[str]:
    try:
        return [f"{ANALYSIS}/{name}/result.json" for name in sorted(os.listdir(run / ANALYSIS))]  # noqa: PTH208 - likewise
    except OSError:
        return []


def _fields_row(run: Path) -> dict[str, object]:
    try:
        document = read_document(run)
        if is_newer(document):
            return {"fields": {}}
        said = annotation_fields(read_annotations(run))
        return {"fields": {**manifest_fields(document), **file_fields(run), **said}}
    except RecordError:
        return {"fields": {}}


def _summary_fields(summary: RunSummary) -> dict[str, list[Value]]:
    """Return what a list shows, under the names of its JSON; these go for damaged runs too."""
    own: dict[str, Value] = {
        "run": summary.run.name,
        "protocol": summary.protocol,
        "exit_status": summary.exit_status,
        "started": summary.started,
        "trials_done": summary.trials_done,
    }
    return {name: [value] for name, value in own.items() if value is not None}


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
