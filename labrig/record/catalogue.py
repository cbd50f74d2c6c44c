"""Lists the runs of a folder; `labrig.record.search` finds those that fit a condition."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.errors import InputError, RecordError
from labrig.record.annotations import read_annotations
from labrig.record.chain import scan_chain
from labrig.record.json_lines import read_lines
from labrig.record.layout import ANALYSIS, CHAIN, EVENT_LINES, MANIFEST, NOTES, PROTOCOL, inside
from labrig.record.manifest import is_newer, read_document
from labrig.record.results import require_unchanged_newest
from labrig.record.run_index import NO_FILE, RunIndex, ShareDone, Value, ask_index, signature_of
from labrig.record.seal import Seal, find_changes_since_sealing
from labrig.record.trial_count import count_trials_done

# What a summary is read from. The manifest comes first: a folder without a manifest is no run.
_SUMMARY_FILES = (MANIFEST, NOTES, EVENT_LINES, CHAIN)


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
        `success`, `aborted`, `failed`, `incomplete`; `newer` if a newer labrig wrote the run; or `damaged` if the
        manifest, the events, the notes or the newest result cannot be read or were changed since they were sealed.
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


def list_runs(
    runs_dir: Path, *, reverse: bool = False, progress: ShareDone | None = None
) -> list[RunSummary]:
    """List the runs of a folder, newest first, damaged runs last; other folders, exports and links are left out.

    Parameters
    ----------
    runs_dir : Path
        Folder of runs. A folder that does not exist yet holds none.
    reverse : bool
        Turn the order round.
    progress : callable or None
        Told the share that is done, while runs are read that the index does not have.

    Raises
    ------
    InputError
        When it is a file, or cannot be read.
    """
    signatures = sign_runs(runs_dir)
    if not signatures:
        return []
    summaries = ask_index(runs_dir, lambda index: read_summaries(index, runs_dir, signatures, progress))
    listed = list(summaries.values())
    return listed[::-1] if reverse else listed


def sign_runs(runs_dir: Path) -> dict[str, str]:
    """Return the signature of the files that each run's summary is read from, by the name of the run's folder."""
    root = os.fspath(runs_dir)
    signatures = {}
    for name in _folders(runs_dir):
        folder = f"{root}/{name}"
        signature = _sign_run(folder)
        if not signature.startswith(NO_FILE) and not _is_export(folder, signature):
            signatures[name] = signature
    return signatures


def _is_export(folder: str, signature: str) -> bool:
    """Return whether a folder with a manifest holds tables of a run, and nothing that a run begins with."""
    has_events = signature.split(" ")[_SUMMARY_FILES.index(EVENT_LINES)] != NO_FILE
    return not has_events and not os.path.lexists(f"{folder}/{PROTOCOL}")


def _sign_run(run: str) -> str:
    try:
        results = sorted(os.listdir(f"{run}/{ANALYSIS}"))  # noqa: PTH208 - of thousands of runs
    except OSError:
        return signature_of(run, _SUMMARY_FILES)
    return signature_of(run, [*_SUMMARY_FILES, *[f"{ANALYSIS}/{number}/result.json" for number in results]])


def read_summaries(
    index: RunIndex, runs_dir: Path, signatures: Mapping[str, str], progress: ShareDone | None
) -> dict[str, RunSummary]:
    """Return the summaries of the runs that `sign_runs` found, newest first, by the name of the run's folder."""
    rows: Mapping[str, Mapping[str, Any]] = index.summaries(
        signatures, lambda name: _summary_row(runs_dir / name), progress
    )
    newest_first = sorted(rows.items(), key=lambda item: item[1]["started"] or "", reverse=True)
    return {
        name: RunSummary(runs_dir / name, **{**row, "tags": tuple(row["tags"])}) for name, row in newest_first
    }


def _folders(runs_dir: Path) -> list[str]:
    try:
        with os.scandir(runs_dir) as entries:
            return sorted(
                entry.name
                for entry in entries
                if not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False)
            )
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot list {runs_dir}: {error.strerror}", "give a folder of runs") from error


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
            # What its other members mean may have changed.
            return {**row, "protocol": _text(document.get("experiment")), "exit_status": "newer"}
        return row | _intact_row(run, document)
    except RecordError:
        return row


def _intact_row(run: Path, manifest: dict[str, object]) -> dict[str, object]:
    chain = scan_chain(run)
    for problem in find_changes_since_sealing(run, manifest, chain):
        raise RecordError(f"{run / problem.where}: {problem.message}", problem.hint)
    seal = Seal(run, chain.links)
    require_unchanged_newest(run, seal)
    exit_status = str(manifest.get("exit_status"))
    done = _whole(manifest.get("trials_done"))
    if exit_status == "incomplete":  # its manifest was not brought up to date
        done = count_trials_done(read_lines(inside(run, EVENT_LINES)))
    annotations = read_annotations(run, seal)
    return {
        "protocol": _text(manifest.get("experiment")),
        "exit_status": exit_status,
        "started": _text(manifest.get("started")),
        "trials_done": done,
        "trials_planned": None if done is None else _whole(manifest.get("trials_planned")),
        "tags": list(annotations.tags),
        "verdict": annotations.verdict,
        "notes": len(annotations.notes),
    }


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) else None
