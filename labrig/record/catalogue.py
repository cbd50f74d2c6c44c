"""Lists the runs of a folder, and finds those that fit a condition."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.errors import InputError, RecordError
from labrig.record.annotations import read_annotations
from labrig.record.condition import (
    Condition,
    Fields,
    Value,
    parse_condition,
    paths_for,
    require_field,
    values_by_name,
)
from labrig.record.field_index import remembered_fields
from labrig.record.fields import ANNOTATION_FIELDS, annotation_fields, file_fields, manifest_fields
from labrig.record.json_lines import read_lines
from labrig.record.layout import ANALYSIS, EVENT_LINES, MANIFEST, NOTES, PROTOCOL, inside
from labrig.record.manifest import is_newer, read_document, read_manifest
from labrig.record.run_index import NO_FILE, remembered, signature_of

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


# What a list shows, under the names of its JSON: these can be asked of damaged runs too.
_OF_SUMMARIES: Mapping[str, Callable[[RunSummary], Value]] = {
    "run": lambda summary: summary.run.name,
    "protocol": lambda summary: summary.protocol,
    "exit_status": lambda summary: summary.exit_status,
    "started": lambda summary: summary.started,
    "trials_done": lambda summary: summary.trials_done,
}


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
    return _listed(runs_dir, _signatures(runs_dir))


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
    signatures = _signatures(runs_dir)
    summaries = _listed(runs_dir, signatures)
    fields, known = _fields_of(runs_dir, summaries, signatures, names)
    if summaries and condition is not None:
        condition.require_known(known)
    if summaries and sort is not None:
        require_field(sort, known, "--sort")
    found = [
        FoundRun(summary, values)
        for summary, values in zip(summaries, fields, strict=True)
        if condition is None or condition.holds(values)
    ]
    return _in_order(found, sort, reverse)


def _signatures(runs_dir: Path) -> dict[str, str]:
    """Return the runs of a folder, each with the signature of what its summary is read from."""
    root = os.fspath(runs_dir)
    signatures = {name: signature_of(f"{root}/{name}", _SUMMARY_FILES) for name in _folders(runs_dir)}
    return {name: signature for name, signature in signatures.items() if not signature.startswith(NO_FILE)}


def _listed(runs_dir: Path, signatures: Mapping[str, str]) -> list[RunSummary]:
    rows = remembered(runs_dir, "summary", signatures, lambda name: _summary_row(runs_dir / name))
    summaries = [_summary(runs_dir / name, row) for name, row in rows.items()]
    return sorted(summaries, key=lambda summary: summary.started or "", reverse=True)


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


def _folders(runs_dir: Path) -> list[str]:
    try:
        with os.scandir(runs_dir) as entries:
            return sorted(entry.name for entry in entries if entry.is_dir(follow_symlinks=False))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot list {runs_dir}: {error.strerror}", "give a folder of runs") from error


def _fields_of(
    runs_dir: Path, summaries: Sequence[RunSummary], signatures: Mapping[str, str], names: Sequence[str]
) -> tuple[list[dict[str, tuple[Value, ...]]], frozenset[str]]:
    """Return the values of each run under each name, and the paths of all fields that there are."""
    if not names or not summaries:
        return [{} for _ in summaries], frozenset()
    root = os.fspath(runs_dir)
    fields, known = remembered_fields(
        runs_dir,
        {name: f"{one} {_field_signature(f'{root}/{name}')}" for name, one in signatures.items()},
        lambda name: _all_fields(runs_dir / name),
        lambda paths: paths_for(names, paths),
    )
    own = [(name, value) for name, value in _OF_SUMMARIES.items() if name in paths_for(names, _OF_SUMMARIES)]
    folders = [summary.run.name for summary in summaries]
    whole = {
        folder: {**{name: [value(summary)] for name, value in own}, **fields[folder]}
        for folder, summary in zip(folders, summaries, strict=True)
    }
    found = values_by_name(names, whole)
    return [found[folder] for folder in folders], known | _OF_SUMMARIES.keys() | ANNOTATION_FIELDS


def _field_signature(run: str) -> str:
    """Return the signature of what fields are read from, beyond what summaries are."""
    try:
        numbers = sorted(os.listdir(f"{run}/{ANALYSIS}"))  # noqa: PTH208 - thousands of them
    except OSError:
        numbers = []
    return signature_of(run, (PROTOCOL, *(f"{ANALYSIS}/{number}/result.json" for number in numbers)))


def _all_fields(run: Path) -> Fields:
    try:
        document = read_document(run)
        if is_newer(document):
            return {}
        said = annotation_fields(read_annotations(run))
        return {**manifest_fields(document), **file_fields(run), **said}
    except RecordError:
        return {}


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
