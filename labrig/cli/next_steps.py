"""What to do about runs that were never closed."""

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

from labrig.errors import LabrigError
from labrig.record.catalogue import RunSummary
from labrig.record.json_lines import read_lines
from labrig.record.layout import EVENT_LINES, find_rig_option, is_simulated, read_manifest, run_lock
from labrig.record.lock import read_lock_owner

MOST = 3
"""How many of them are explained; the others are only listed as `incomplete`."""


def list_next_steps(listed: Sequence[RunSummary]) -> Iterator[str]:
    """Yield for each run that was never closed, and that nobody has judged, who writes it or what to do about it."""
    open_runs = [run for run in listed if run.exit_status == "incomplete" and run.verdict is None]
    yield from (_find_next_step(run) for run in open_runs[:MOST])
    if len(open_runs) > MOST:
        yield f"... and {len(open_runs) - MOST} more are incomplete: labrig runs --where exit_status=incomplete"


def _find_next_step(summary: RunSummary) -> str:
    owner = read_lock_owner(run_lock(summary.run))
    if owner is not None:
        return f"{summary.run.name} is going on: {owner}"
    place = shlex.quote(str(summary.run))
    steps = []
    if withdraw := _find_withdrawal(summary.run):
        steps.append(f"take out a needle that is still in tissue: {withdraw}")
    if summary.trials_planned:
        steps.append(f"continue it: labrig resume {place}")
    if not steps:
        steps.append(
            f"what it holds can be used; judged, it is named no more: labrig runs annotate {place} --verdict bad"
        )
    return f"{summary.run.name} was interrupted; " + "\n  then ".join(steps)


def _find_withdrawal(run: Path) -> str:
    """Return the command that withdraws the needle of an interrupted run; empty if its needle is out."""
    try:
        manifest, events = read_manifest(run), read_lines(run / EVENT_LINES)
    except LabrigError:
        return ""
    trials = [line.get("kind") for line in events if line.get("kind") in {"trial_start", "trial_stop"}]
    if is_simulated(manifest) or manifest.get("rig") is None or trials[-1:] != ["trial_start"]:
        return ""
    return f"labrig devices withdraw {find_rig_option(manifest)} --run {shlex.quote(str(run))}"
