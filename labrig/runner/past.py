"""Reads what the record of an interrupted run holds, for the session that continues it."""

from labrig.record.events import TrialStart, TrialStop
from labrig.record.reader import Run
from labrig.runner.trials import Past
from labrig.runner.withdrawal import read_needle_path


class _SpecimenStart(TrialStart):
    """A trial that starts, with its specimen if it has one."""

    specimen: str = ""


def read_past(run: Run) -> Past:
    """Return what a record holds. Raises `RecordError` when it is damaged."""
    return Past(run.read_trials(_SpecimenStart, TrialStop), run.decisions, read_needle_path(run))
