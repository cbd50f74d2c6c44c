"""Resumes an interrupted run of insertions: those made are kept, the interrupted one is made again in a fresh block."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from labrig.devices.axis_positions import AxisPositions
from labrig.errors import InputError
from labrig.experiments.insertion.ending import Ending
from labrig.experiments.insertion.events import InsertionStart, InsertionStop
from labrig.experiments.insertion.procedure import MadeTrial, make_insertions
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.schedule import BegunInsertion, PlannedInsertion, find_next_trial
from labrig.record.decisions import Decisions
from labrig.record.events import INTERRUPTED, RecordedTrial
from labrig.record.reader import Run
from labrig.runner.experiment import Remainder
from labrig.runner.session import Session
from labrig.runner.withdrawal import read_needle_path, take_needle_out

_Recorded = RecordedTrial[InsertionStart, InsertionStop]


@dataclass(frozen=True)
class _Past:
    """The part of a run that is already recorded: its insertions, and the path of a needle that may be in tissue."""

    recorded: tuple[_Recorded, ...]
    made: tuple[MadeTrial, ...]
    needle_path: tuple[AxisPositions, ...]


def resume(protocol: InsertionProtocol, run: Run) -> Remainder:
    """Return the rest of an interrupted run.

    Raises
    ------
    InputError
        When every insertion has been made.
    RecordError
        When the record is damaged.
    """
    recorded = run.read_trials(InsertionStart, InsertionStop)
    past = _Past(recorded, _list_made(recorded), read_needle_path(run))
    left = _count_remaining(protocol, past.made, run.decisions)
    if not left:
        raise InputError(
            f"every insertion of {run.path} has been made",
            "labrig reanalyze measures them; or start a new run",
        )
    kept = sum(
        not trial.begun.interrupted and trial.begun.planned.trial not in run.decisions.repeated
        for trial in past.made
    )
    return Remainder(kept, left, partial(_continue_run, protocol, past))


def _count_remaining(protocol: InsertionProtocol, made: Sequence[MadeTrial], decisions: Decisions) -> int:
    begun, left = [trial.begun for trial in made], 0
    while planned := find_next_trial(protocol.repetitions, begun, decisions):
        begun.append(BegunInsertion(planned))
        left += 1
    return left


def _list_made(recorded: Sequence[_Recorded]) -> tuple[MadeTrial, ...]:
    """Return the recorded insertions with their endings; an interrupted one has none."""
    repetitions: dict[int, int] = {}
    made = []
    for trial in recorded:
        start, stop = trial.start, trial.stop
        repetition = start.trial if start.repeats is None else repetitions[start.repeats]
        repetitions[start.trial] = repetition
        ending = None
        if stop is not None and stop.exit_status != INTERRUPTED:
            ending = Ending(stop.outcome, str(stop.stop), stop.cause)
        planned = PlannedInsertion(start.trial, repetition, start.repeats)
        made.append(MadeTrial(BegunInsertion(planned, interrupted=ending is None), ending))
    return tuple(made)


def _continue_run(protocol: InsertionProtocol, past: _Past, session: Session) -> None:
    """Mark interrupted insertions, make sure that the needle is out, and make the remaining insertions."""
    for trial in past.recorded:
        if trial.stop is None:
            session.record(_mark_interrupted(trial.start.trial, past.needle_path))
    take_needle_out(session, past.needle_path)
    make_insertions(protocol, session, past.made)


def _mark_interrupted(trial: int, path: Sequence[AxisPositions]) -> InsertionStop:
    return InsertionStop(
        trial=trial,
        exit_status=INTERRUPTED,
        outcome=INTERRUPTED,
        stop=INTERRUPTED,
        cause="the run was interrupted",
        final_frame=None,
        depth_mm=max((positions.insertion_mm for positions in path), default=0.0),
        replans=0,
    )
