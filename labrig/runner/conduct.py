"""Runs a procedure to an end that the record can state, with the axes stopped whatever happens."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Self

from labrig.clock import Clock
from labrig.devices.axis_positions import AxisPositions
from labrig.devices.state_line import write_state_line
from labrig.errors import (
    BugError,
    ConditionMetError,
    DiskError,
    InterruptedRunError,
    LabrigError,
    MachineError,
    SafetyStopError,
    TargetMissedError,
    fault_of,
)
from labrig.protocol.sections import ExperimentProtocol, JudgedProtocol
from labrig.record.events import INTERRUPTED, RunResume, RunStart, RunStop, TrialStop
from labrig.record.sink import RecordSink
from labrig.runner.experiment import Experiment
from labrig.runner.session import Session
from labrig.runner.trials import Past
from labrig.runner.withdrawal import recover, take_needle_out


@dataclass(frozen=True)
class Outcome:
    """How a procedure ended: the exit status of the record, the reason, and the error, if any."""

    exit_status: str
    reason: str
    error: LabrigError | None

    def add(self, failure: MachineError, when: str) -> Self:
        """Return the outcome with what failed after the end; an earlier fault of the machine keeps its place."""
        first, error = self.error, failure
        if failure.message in self.reason:
            return replace(self, error=first or failure)
        added = f"; when {when}: {failure.message}"
        if isinstance(first, MachineError):
            error = first.reword(first.message + added)
        return replace(self, reason=(self.reason + added).removeprefix("; "), error=error)

    def fail(self, error: LabrigError) -> Self:
        """Return the outcome of a run whose record cannot be written; an earlier error keeps its place."""
        return replace(
            self, exit_status="failed", reason=self.reason or error.message, error=self.error or error
        )


def conduct(
    experiment: Experiment, protocol: ExperimentProtocol, session: Session, past: Past | None = None
) -> Outcome:
    """Switch power on, run the procedure of an experiment; stop the axes and close the record however it ends.

    Of an interrupted run (`past`), whose record the session's recorder has reopened, the interrupted trial is marked,
    and the needle taken out; nothing is homed or referenced before. An error that is not one of labrig's is a bug: the
    axes stop, the record is closed as failed, and it is raised.
    """
    dialogue = session.dialogue
    dialogue.conditions = protocol.conditions if isinstance(protocol, JudgedProtocol) else ()
    if past is None:
        beginning = RunStart(experiment=experiment.name)
        return _conduct(session, beginning, lambda: experiment.run(protocol, session))
    dialogue.recall(past)

    def go_on() -> None:
        for trial in past.begun:
            if trial.stop is None:
                session.record(TrialStop(trial=trial.start.trial, exit_status=INTERRUPTED))
        take_needle_out(session, past.needle_path)
        experiment.run(protocol, session)

    return _conduct(session, RunResume(experiment=experiment.name), go_on)


def conduct_withdrawal(
    session: Session, run_name: str, path: Sequence[AxisPositions], standing: AxisPositions
) -> Outcome:
    """Withdraw the needle that a run has left in tissue, by `recover`, and end as `conduct` does."""
    return _conduct(
        session, RunStart(experiment="withdrawal"), lambda: recover(session, run_name, path, standing)
    )


def _conduct(session: Session, beginning: RunStart, procedure: Callable[[], object]) -> Outcome:
    outcome = Outcome("failed", "labrig itself failed; the traceback says where", None)
    try:
        outcome = _run_procedure(session, beginning, procedure)
    finally:
        outcome = _stop_and_close(session, outcome)
    return outcome


def _stop_and_close(session: Session, outcome: Outcome) -> Outcome:
    """Stop the axes, then close the record; a failure of either becomes part of the outcome."""
    standing: Mapping[str, object] = {}
    try:
        standing = write_state_line(session.description, session.rig.end())
    except MachineError as error:
        outcome = replace(outcome.add(error, "stopping"), exit_status="failed")
    after = session.rig.snapshot()
    frames = session.rig.take_can_frames()
    clock, recorder, ended_s = session.rig.clock, session.recorder, session.rig.clock.now_s()

    def close() -> Outcome:
        ended = outcome
        try:
            recorder.can_frames(frames)
        except DiskError as error:
            ended = outcome.fail(error)
        return _close(recorder, clock, ended_s, ended, standing, devices_after=after)

    return session.rig.do_aside(close)


def _close(
    recorder: RecordSink, clock: Clock, t_s: float, outcome: Outcome, standing: Any = None, **updates: object
) -> Outcome:
    try:
        stop = RunStop(
            exit_status=outcome.exit_status,
            reason=outcome.reason,
            error="" if outcome.error is None else type(outcome.error).__name__,
            fault=fault_of(outcome.error),
        )
        recorder.record_event(stop, t_s)
        if standing:
            with suppress(DiskError):  # a full disk has room for how the run ended
                recorder.state(t_s, **standing)
        recorder.close(outcome.exit_status, outcome.reason, clock.utc(), **updates)
    except BugError as error:
        return Outcome("failed", error.message, error)
    except DiskError as error:
        return outcome.fail(error)
    return outcome


def conduct_without_rig(experiment: Experiment, recorder: RecordSink, clock: Clock) -> Outcome:
    """Record a run that moves nothing: it begins and ends at rig time 0, and `analysis` does all of its work."""
    try:
        recorder.record_event(RunStart(experiment=experiment.name), 0.0)
    except DiskError as error:
        return _close(recorder, clock, 0.0, Outcome("failed", error.message, error))
    return _close(recorder, clock, 0.0, Outcome("success", "", None))


def _run_procedure(session: Session, beginning: RunStart, procedure: Callable[[], object]) -> Outcome:
    try:
        session.record(beginning)
        session.rig.enable()
        procedure()
        failure = session.dialogue.find_failure()
        if failure is not None:
            return Outcome("failed", failure.reason, failure)
    except (InterruptedRunError, SafetyStopError, ConditionMetError) as error:
        return Outcome("aborted", error.message, error)
    except TargetMissedError as error:
        return Outcome("failed", error.reason, error)
    except LabrigError as error:
        return Outcome("failed", error.message, error)
    return Outcome("success", "", None)
