"""The insertions of a run that remain, by what has been made and what a person has decided."""

from collections.abc import Sequence
from dataclasses import dataclass

from labrig.record.decisions import Decisions


@dataclass(frozen=True)
class PlannedInsertion:
    """An insertion that is to be made.

    Attributes
    ----------
    trial : int
        Its number, unique in a run.
    repetition : int
        Which of the repetitions that the protocol asks for, from 0.
    repeats : int or None
        The trial whose place it takes: one that was interrupted, or that a person has made again.
    """

    trial: int
    repetition: int
    repeats: int | None = None


@dataclass(frozen=True)
class BegunInsertion:
    """An insertion that has started: which it was, and whether it was interrupted."""

    planned: PlannedInsertion
    interrupted: bool = False


def find_next_trial(
    repetitions: int, begun: Sequence[BegunInsertion], decisions: Decisions
) -> PlannedInsertion | None:
    """Return the next insertion; None if all have been made. One that is made again is so first.

    Parameters
    ----------
    repetitions : int
        The insertions that the protocol asks for, numbered from 0.
    begun : sequence of BegunInsertion
        The insertions so far, in order.
    decisions : Decisions
        What a person has skipped, and had made again.
    """
    skipped = {skip.trial for skip in decisions.skipped}
    settled = {trial.planned.repeats for trial in begun} | {skip.repeats for skip in decisions.skipped}
    used = {trial.planned.trial for trial in begun} | skipped
    for trial in begun:
        number = trial.planned.trial
        if (trial.interrupted or number in decisions.repeated) and number not in settled:
            return PlannedInsertion(max(used | {repetitions - 1}) + 1, trial.planned.repetition, number)
    return next((PlannedInsertion(trial, trial) for trial in range(repetitions) if trial not in used), None)
