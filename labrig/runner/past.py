"""Reads what the record of an interrupted run holds, for the session that continues it."""

from labrig.record.events import TrialStart, TrialStop
from labrig.record.reader import Run
from labrig.runner.trials import BegunTrial, Past
from labrig.runner.withdrawal import read_needle_path


class _SpecimenStart(TrialStart):
    """A trial that starts, with its specimen if it has one."""

    specimen: str = ""


def read_past(run: Run) -> Past:
    """Return what a record holds. Raises `RecordError` when it is damaged."""
    trials = run.read_trials(_SpecimenStart, TrialStop)
    return Past(
        begun=tuple(
            BegunTrial(trial.start.trial, trial.start.repeats, trial.exit_status) for trial in trials
        ),
        decisions=run.decisions,
        failed={
            trial.start.trial: (trial.stop.stop or "trial_failed", trial.stop.cause)
            for trial in trials
            if trial.stop is not None and trial.exit_status == "failed"
        },
        last_specimen=next((trial.start.specimen for trial in reversed(trials) if trial.start.specimen), ""),
        needle_path=read_needle_path(run),
    )
