"""Lists the runs of a folder, and finds those that fit a condition.

A list reads the beginning of each manifest, which holds what is shown, and the notes; it verifies nothing. A
condition reads whole manifests, and results only where it names what no manifest holds.
"""

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from pydantic_core import from_json

from labrig.durable import open_descriptor
from labrig.errors import InputError, RecordError
from labrig.input_file import MAX_DOCUMENT_BYTES
from labrig.record.condition import BLOCK_NAME, Condition, find_values, parse_condition
from labrig.record.json_lines import flatten, read_lines
from labrig.record.layout import ANALYSIS, EVENT_LINES, MANIFEST, NOTES, PROTOCOL, SCHEMA_VERSION, inside
from labrig.record.notes import Annotations, read_annotations
from labrig.record.results import list_results, read_result

_SHOWN_BYTES = 2048
# Hashes, lists of all pictures and old tracks differ between runs, but nobody searches for them.
_NOT_SEARCHED = frozenset(
    [
        "schema_version",
        "command_line",
        "packages",
        "inputs",
        "created",
        "tracks",
        "measurements",
        "cells",
        "corners",
    ]
)
_ALWAYS_KNOWN = frozenset({"tag", "verdict", "note", BLOCK_NAME})
"""Fields that may be searched for even if no run has them."""


@dataclass(frozen=True)
class RunSummary:
    """A run in a list; what cannot be read of a damaged run is None.

    Attributes
    ----------
    run : Path
        Its folder.
    protocol : str
        Which experiment: `steerability`, `camera-calibration`, `import` ...
    exit_status : str
        `success`, `aborted`, `failed`, `incomplete`; or `damaged` if the manifest cannot be read.
    started : str
        When, ISO 8601 in UTC.
    trials_done, trials_planned : int
        Trials that ended in success and are evaluated, not those made again or marked as bad; and those that the
        protocol asks for. If the first is unknown, so is the second.
    tags : tuple of str
        Its tags.
    verdict : str
        The operator's: good, doubtful or bad; None if there is none.
    notes : int
        How many notes it has.
    sources : mapping
        What it was made from: the files `protocol` and `rig`, `settings` of `--set`, `seed` of `--seed`.
    """

    run: Path
    protocol: str | None = None
    exit_status: str = "damaged"
    started: str | None = None
    trials_done: int | None = None
    trials_planned: int | None = None
    tags: tuple[str, ...] = ()
    verdict: str | None = None
    notes: int = 0
    sources: Mapping[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, object]:
        """Return it as JSON."""
        return {**vars(self), "run": str(self.run)}


def list_runs(runs_dir: Path, where: str | None = None) -> list[RunSummary]:
    """List the runs of a folder, newest first, damaged runs last; other folders, exports and links are left out.

    Parameters
    ----------
    runs_dir : Path
        Folder of runs. A folder that does not exist yet holds none.
    where : str or None
        A condition that they fit, as `labrig.record.condition` describes it; None: every run.

    Raises
    ------
    InputError
        When the folder cannot be read; when the condition cannot be read, or names a field that no run has.
    """
    condition = None if where is None else parse_condition(where)
    folders = _list_folders(runs_dir)
    if condition is None:
        listed = [_summarise(run, _read_manifest(run, _SHOWN_BYTES)) for run in folders]
    else:
        listed = _find_runs(folders, condition)
    return sorted(listed, key=lambda summary: (summary.started or "", summary.run.name), reverse=True)


def manifest_fields(manifest: Mapping[str, object], notes: Annotations) -> dict[str, list[Any]]:
    """Return the values of a manifest by dotted path, `duration_s`, and those of the notes."""
    about: dict[str, object] = {"tag": notes.tags, "note": [note.text for note in notes.notes]}
    if notes.verdict is not None:
        about["verdict"] = notes.verdict
    with suppress(ValueError):
        started, ended = (datetime.fromisoformat(str(manifest.get(key))) for key in ("started", "ended"))
        about["duration_s"] = (ended - started).total_seconds()
    return _group_by_path({**manifest, **about})


def _group_by_path(document: Mapping[str, object]) -> dict[str, list[Any]]:
    fields: dict[str, list[Any]] = {}
    for path, value in flatten(document, skip=_NOT_SEARCHED):
        fields.setdefault(path, []).append(value)
    return fields


def _find_runs(folders: list[Path], condition: Condition) -> list[RunSummary]:
    """Return the runs that fit. Raises `InputError` for a field that none has, also not in its newest result."""
    found = []
    known: dict[str, list[Any]] = {name: [None] for name in _ALWAYS_KNOWN}
    # One in memory at a time: thousands would take most of the time.
    for run in folders:
        manifest = _read_manifest(run, MAX_DOCUMENT_BYTES)
        summary = _summarise(run, manifest)
        fields = manifest_fields(manifest, _read_notes(run)) if manifest else {}
        shown = ("protocol", "exit_status", "trials_done")
        fields |= {"run": [run.name], **{name: [getattr(summary, name)] for name in shown}}
        if not all(find_values(fields, comparison.name) for comparison in condition.comparisons):
            fields |= _read_result_fields(run)
        known |= fields
        if condition.fits(fields):
            found.append(summary)
    for comparison in condition.comparisons:
        if folders and not find_values(known, comparison.name):
            raise comparison.refuse(known)
    return found


def _read_result_fields(run: Path) -> dict[str, list[Any]]:
    """Return the values of the newest result; a damaged one gives none."""
    with suppress(RecordError):
        numbers = list_results(run)
        result = read_result(run / ANALYSIS / f"{numbers[-1]:03d}") if numbers else {}
        searched = {key: value for key, value in result.items() if key != "provenance"}
        return _group_by_path({"result": searched})
    return {}


def _list_folders(runs_dir: Path) -> list[Path]:
    try:
        with os.scandir(runs_dir) as entries:
            return [
                runs_dir / entry.name
                for entry in entries
                if not entry.name.startswith(".")
                and entry.is_dir(follow_symlinks=False)
                and os.path.exists(f"{entry.path}/{PROTOCOL}")  # noqa: PTH110 - takes half the time
            ]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot list {runs_dir}: {error.strerror}", "give a folder of runs") from error


def _read_manifest(run: Path, most_bytes: int) -> dict[str, Any]:
    """Return what the first bytes of a manifest hold; nothing of a damaged one."""
    try:
        with open_descriptor(run / MANIFEST, os.O_RDONLY | os.O_NONBLOCK) as descriptor:
            content = os.read(descriptor, most_bytes)
        manifest = from_json(content, allow_inf_nan=False, allow_partial=len(content) == _SHOWN_BYTES)
    except (OSError, ValueError):
        return {}
    is_one = isinstance(manifest, dict) and isinstance(manifest.get("exit_status"), str)
    return manifest if is_one and manifest.get("schema_version") == SCHEMA_VERSION else {}


def _summarise(run: Path, manifest: Mapping[str, Any]) -> RunSummary:
    if not manifest:
        return RunSummary(run)
    summary = manifest.get("summary") or {}
    done = summary.get("trials_done") if manifest["exit_status"] != "incomplete" else _count_trials(run)
    planned = manifest.get("trials_planned")
    notes = _read_notes(run)
    return RunSummary(
        run,
        str(manifest.get("experiment")),
        manifest["exit_status"],
        str(manifest.get("started")),
        done,
        planned if isinstance(done, int) else None,
        notes.tags,
        notes.verdict,
        len(notes.notes),
        manifest.get("sources") or {},
    )


def _read_notes(run: Path) -> Annotations:
    """Return the notes of a run; none if there are none, or they are damaged."""
    with suppress(RecordError):
        if os.path.exists(f"{run}/{NOTES}"):  # noqa: PTH110
            return read_annotations(run)
    return Annotations()


def _count_trials(run: Path) -> int | None:
    # Imported late: the models of events take longer to load than a list of runs.
    from labrig.record.events import count_trials_done

    try:
        return count_trials_done(run, read_lines(inside(run, EVENT_LINES)))
    except RecordError:
        return None
