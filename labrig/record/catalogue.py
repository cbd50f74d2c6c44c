"""Lists the runs of a folder, and finds those that fit a condition.

A list reads the manifest of each run, which is small, and its notes; it verifies nothing. Only a condition on what a
result holds reads results.
"""

import json
import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic_core import from_json

from labrig.errors import InputError, RecordError
from labrig.input_file import read_file
from labrig.record.condition import ALWAYS_KNOWN, Value, find_paths, parse_condition
from labrig.record.json_lines import plain_text, read_lines
from labrig.record.layout import ANALYSIS, EVENT_LINES, MANIFEST, NOTES, PROTOCOL, SCHEMA_VERSION, inside
from labrig.record.manifest import has_ended
from labrig.record.notes import Annotations, read_annotations
from labrig.record.results import list_results, read_result

# Hashes, lists of all pictures and old tracks differ between runs, but nobody searches for them.
_LEFT_OUT = frozenset({"schema_version", "command_line", "packages", "inputs", "created", "tracks"})
_LEFT_OUT_OF_RESULTS = frozenset({*_LEFT_OUT, "provenance", "measurements", "cells", "corners"})

Fields = dict[str, list[Value]]


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

    def document(self) -> dict[str, object]:
        """Return it as JSON."""
        return {**asdict(self), "run": str(self.run)}


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
    runs = _read_runs(runs_dir)
    if condition is None or not runs:
        return [run.summary for run in runs]
    known = {path for run in runs for path in run.fields} | ALWAYS_KNOWN
    if any(not find_paths(name, known) for name, _ in condition.names):
        for run in runs:
            run.fields |= run.result_fields
        known |= {path for run in runs for path in run.fields}
    condition.require_known(known)
    paths = {name: find_paths(name, known) for name, _ in condition.names}

    def look_up(run: _ReadRun) -> Callable[[str], list[Value]]:
        return lambda name: [value for path in paths[name] for value in run.fields.get(path, ())]

    return [run.summary for run in runs if condition.fits(look_up(run))]


def manifest_fields(manifest: Mapping[str, object]) -> Fields:
    """Return the values of a manifest by dotted path, and `duration_s`."""
    fields = _flatten(manifest, "", _LEFT_OUT)
    with suppress(ValueError):
        started, ended = (datetime.fromisoformat(str(manifest.get(key))) for key in ("started", "ended"))
        fields["duration_s"] = [(ended - started).total_seconds()]
    return fields


class _ReadRun:
    """A run as its manifest and notes tell it."""

    def __init__(self, run: Path, manifest: Mapping[str, object], *, has_notes: bool) -> None:
        self._manifest = manifest
        self._annotations = Annotations()
        if manifest and has_notes:
            with suppress(RecordError):
                self._annotations = read_annotations(run)
        self.summary = _summarise(run, manifest, self._annotations)

    @cached_property
    def fields(self) -> Fields:
        """The values of manifest, protocol and notes by dotted path."""
        shown = {
            key: getattr(self.summary, key) for key in ("protocol", "exit_status", "started", "trials_done")
        }
        notes = self._annotations
        return {
            **manifest_fields(self._manifest),
            "run": [self.summary.run.name],
            **{key: [value] for key, value in shown.items()},
            "tag": list(notes.tags),
            "verdict": [] if notes.verdict is None else [notes.verdict],
            "note": [note.text for note in notes.notes],
        }

    @property
    def result_fields(self) -> Fields:
        """The values of the newest result; a damaged one gives none."""
        run = self.summary.run
        with suppress(RecordError):
            numbers = list_results(run)
            result = read_result(run / ANALYSIS / f"{numbers[-1]:03d}") if numbers else {}
            return _flatten(result, "result", _LEFT_OUT_OF_RESULTS)
        return {}


def _read_runs(runs_dir: Path) -> list[_ReadRun]:
    try:
        with os.scandir(runs_dir) as entries:
            folders = sorted(
                entry.name
                for entry in entries
                if not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False)
            )
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot list {runs_dir}: {error.strerror}", "give a folder of runs") from error
    runs = []
    for name in folders:
        run = runs_dir / name
        with suppress(OSError):  # it has just gone, or is not ours to read
            held = os.listdir(run)  # noqa: PTH208 - names are enough, and take a tenth of the time
            if PROTOCOL in held:
                runs.append(_ReadRun(run, _read_manifest(run), has_notes=NOTES in held))
    return sorted(runs, key=lambda run: run.summary.started or "", reverse=True)


def _read_manifest(run: Path) -> Mapping[str, object]:
    """Return the manifest of a run, empty if it is damaged.

    Not by `labrig.record.manifest`: of thousands of runs, its care for numbers takes longer than all the rest.
    """
    try:
        content = read_file(run / MANIFEST)
        try:
            manifest = from_json(content)
        except (
            ValueError
        ):  # it takes no lone surrogates, which stand for the bytes of names that are not UTF-8
            manifest = json.loads(content)
    except (OSError, ValueError, RecursionError):
        return {}
    is_one = isinstance(manifest, dict) and isinstance(manifest.get("exit_status"), str)
    return manifest if is_one and manifest.get("schema_version") == SCHEMA_VERSION else {}


def _summarise(run: Path, manifest: Mapping[str, Any], annotations: Annotations) -> RunSummary:
    if not manifest:
        return RunSummary(run)
    summary = manifest.get("summary")
    done = summary.get("trials_done") if isinstance(summary, Mapping) else None
    if not has_ended(manifest):  # it has no summary yet
        done = _count_trials(run)
    planned = manifest.get("trials_planned")
    return RunSummary(
        run,
        str(manifest.get("experiment")),
        str(manifest["exit_status"]),
        str(manifest.get("started")),
        done if isinstance(done, int) else None,
        planned if isinstance(planned, int) and isinstance(done, int) else None,
        annotations.tags,
        annotations.verdict,
        len(annotations.notes),
    )


def _count_trials(run: Path) -> int | None:
    # Imported late: the models of events take longer to load than a list of runs.
    from labrig.record.decisions import count_trials_done

    try:
        return count_trials_done(read_lines(inside(run, EVENT_LINES)))
    except RecordError:
        return None


def _flatten(values: Mapping[str, object], prefix: str, left_out: frozenset[str]) -> Fields:
    """Return the scalars of nested values by dotted path, each once; the items of a list share its path."""
    found: dict[str, dict[Value, None]] = {}
    _gather(values, prefix, left_out, found)
    return {plain_text(path): list(held) for path, held in found.items()}


def _gather(value: object, path: str, left_out: frozenset[str], found: dict[str, dict[Value, None]]) -> None:
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in left_out:
                _gather(item, f"{path}.{key}" if path else key, left_out, found)
    elif isinstance(value, list):
        for item in value:
            _gather(item, path, left_out, found)
    elif isinstance(value, str):
        found.setdefault(path, {})[plain_text(value)] = None
    elif value is None or isinstance(value, int | float):
        found.setdefault(path, {})[value if value is None or math.isfinite(value) else None] = None
