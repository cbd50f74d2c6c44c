"""What to do about runs that were never closed."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from labrig.errors import InputError, RecordError
from labrig.record.catalogue import RunSummary
from labrig.record.layout import run_lock
from labrig.record.lock import read_lock_owner
from labrig.record.manifest import find_rig_option, is_simulated, read_manifest

MOST = 3
"""How many of them are explained; the others are only listed as `incomplete`."""

_WITHDRAWAL = "withdrawal"


def list_next_steps(listed: Sequence[RunSummary]) -> Iterator[str]:
    """Yield for each run that was never closed who writes it, or the command that continues or closes it."""
    open_runs = [run for run in listed if run.exit_status == "incomplete"]
    yield from (_find_next_step(run) for run in open_runs[:MOST])
    if len(open_runs) > MOST:
        yield f"... and {len(open_runs) - MOST} more are incomplete: labrig runs --where exit_status=incomplete"


def _find_next_step(summary: RunSummary) -> str:
    owner = read_lock_owner(run_lock(summary.run))
    if owner is not None:
        return f"{summary.run.name} is going on: {owner}"
    place = shlex.quote(str(summary.run))
    if can_resume(summary.protocol):
        return f"{summary.run.name} was interrupted; continue it: labrig resume {place}"
    close = f"labrig runs check {place} --repair"
    manifest = _read_manifest(summary.run)
    if not _may_leave_a_needle(summary.protocol) or is_simulated(manifest):
        return f"{summary.run.name} was interrupted; close it: {close}"
    withdraw = f"labrig devices withdraw {find_rig_option(manifest)} --run {place}"
    return (
        f"{summary.run.name} was interrupted; take out a needle that is still in tissue: {withdraw}\n"
        f"  then close it: {close}"
    )


def _read_manifest(run: Path) -> Mapping[str, object]:
    """Return the manifest of a run; an empty one if it cannot be read."""
    try:
        return read_manifest(run)
    except RecordError:
        return {}


def can_resume(experiment: str | None) -> bool:
    """Return whether an interrupted run of an experiment can be continued; the experiment must be installed."""
    found = _find_installed(experiment)
    return found is not None and found.declaration.resume is not None


def _may_leave_a_needle(experiment: str | None) -> bool:
    """Return whether a needle may be in tissue; it may if the experiment is not installed."""
    found = _find_installed(experiment)
    return experiment == _WITHDRAWAL or found is None or found.declaration.puts_needle_in_tissue


def _find_installed(experiment: str | None) -> Any:
    from labrig.experiments.declared import find_declared

    try:
        return None if experiment is None else find_declared(experiment)
    except InputError:
        return None
