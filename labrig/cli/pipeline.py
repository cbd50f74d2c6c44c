"""The steps of a run: open rig and record, conduct the experiment, close both, analyse, write the report."""

import gc
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from labrig.cli.analyze import analyze
from labrig.cli.finished_run import FinishedRun
from labrig.cli.live import UNWATCHED, Watching, show_while_made
from labrig.cli.needle_report import add_closing_failure, report_needle
from labrig.cli.output import say
from labrig.cli.pausing import UNPAUSED, Attention, take_requests
from labrig.cli.progress import Reporter, progress
from labrig.cli.rigs import open_rig_for_person
from labrig.cli.signals import Interruption
from labrig.cli.sources import Sources
from labrig.clock import Clock
from labrig.devices.clocks import SystemClock
from labrig.devices.opening import Opening
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription
from labrig.durable import require_free_bytes
from labrig.errors import (
    AnswerIsNoError,
    BugError,
    DiskError,
    FileFormatError,
    InputError,
    InterruptedRunError,
    LabrigError,
    MachineError,
    TargetMissedError,
    TrialsFailedError,
)
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.provenance import CodeChanges, find_code_changes
from labrig.record.reader import open_run
from labrig.record.writer import Recorder
from labrig.runner.conduct import Outcome, conduct, conduct_without_rig
from labrig.runner.dry_run import plan_run
from labrig.runner.experiment import Experiment, RunPlan
from labrig.runner.plan import count_needed_bytes, require_valid_calibration
from labrig.runner.run_record import RecordOrder, open_record
from labrig.runner.session import Session
from labrig.runner.supervised_record import begin_session


@dataclass(frozen=True)
class RunOrder:
    """What to run: an experiment and its protocol, the rig if it needs one, the record, and the command line.

    `attention` says whether the person at the terminal may pause it, `watching` how it is shown while it is made.
    """

    experiment: Experiment
    protocol: ExperimentProtocol
    rig: RigDescription | None
    runs_dir: Path
    run_name: str | None
    command_line: tuple[str, ...]
    sources: Sources
    attention: Attention = UNPAUSED
    watching: Watching = UNWATCHED


def perform(order: RunOrder) -> FinishedRun:
    """Record a run, measure it and write its report; shown live, also its view.

    Raises
    ------
    FileFormatError
        When the rig cannot do what the protocol asks; nothing has moved and nothing has been written.
    OutputExistsError, DiskError, BusError, DriveError, CameraError
        When the run cannot begin.
    """
    if order.runs_dir.exists() and not order.runs_dir.is_dir():
        raise InputError(
            f"{order.runs_dir} is a file, expected the folder of the runs", "name a folder with --runs-dir"
        )
    order.experiment.require_parts()
    plan = plan_run(order.experiment, order.protocol, order.rig)
    if plan.problems:
        raise FileFormatError(plan.problems)
    require_free_bytes(order.runs_dir, count_needed_bytes(plan, order.rig))
    changes = find_code_changes()
    _announce_code_diff(changes)
    # The modules stay until the end. Without this, collections look through them all again and again, and in each
    # process that measures, too.
    gc.freeze()
    return finish(_record(order, plan, changes), order.command_line, order.watching)


def _keep_view(finished: FinishedRun) -> None:
    """Write the view of a run that was shown live; a failure, or a person who does not wait, costs the run nothing."""
    # Imported late, as the viewer's library is large.
    from labrig.cli.view_file import make_view_file

    if isinstance(finished.outcome.error, InterruptedRunError):
        say("note: view.rrd was not written; labrig view makes it")
        return
    say("writing view.rrd")
    try:
        make_view_file(open_run(finished.path))
    except LabrigError as error:
        say(f"note: view.rrd was not written: {error.message}; labrig view makes it")
    except Interruption:
        say("note: view.rrd was not written; labrig view makes it")


def _announce_code_diff(changes: CodeChanges) -> None:
    """Say which changes of labrig's own code the record will keep, and which new files it will not."""
    if changes.changed or changes.added:
        say(
            f"note: the record keeps changed code, as code.diff: {', '.join((*changes.changed, *changes.added))}"
        )
    if changes.left_out:
        say(f"note: code.diff leaves out new files that are no code: {', '.join(changes.left_out)}")


def finish(ended: FinishedRun, command_line: tuple[str, ...], watching: Watching = UNWATCHED) -> FinishedRun:
    """Measure a recorded run and write the report, if the run came to its end; shown by a viewer, also its view."""
    finished = _measure_and_report(ended, command_line)
    if watching.viewer is not None:
        _keep_view(finished)
    return finished


def _measure_and_report(ended: FinishedRun, command_line: tuple[str, ...]) -> FinishedRun:
    path, outcome = ended.path, ended.outcome
    if outcome.error is not None and not _is_measurable(outcome.error):
        return _show_failure(ended)
    ended = replace(ended, needle=None, can_resume=False)
    if ended.signal_name is not None:
        return _leave_unmeasured(ended, ended.signal_name)
    try:
        result = analyze(path, command_line)
        # Imported late: the processes that measure are forked before matplotlib is loaded, and stay small.
        from labrig.cli.reporting import write_page

        say("writing the report")
        report = write_page(open_run(path), result)
    except Interruption as interruption:
        return _leave_unmeasured(ended, str(interruption))
    except AnswerIsNoError as error:
        return replace(ended, outcome=Outcome(outcome.exit_status, error.message, error))
    return replace(ended, report=report, result=result.document)


def _show_failure(ended: FinishedRun) -> FinishedRun:
    """Write the page of a run that failed, which says why; not after a fault of the disk, or a bug.

    Nothing that goes wrong with the page hides why the run failed.
    """
    error = ended.outcome.error
    if ended.outcome.exit_status != "failed" or isinstance(error, DiskError | BugError):
        return ended
    from labrig.cli.reporting import write_page

    try:
        return replace(ended, report=write_page(open_run(ended.path), None))
    except (LabrigError, Interruption) as failure:
        say(f"note: the page was not written: {failure}")
        return ended


def _is_measurable(error: LabrigError) -> bool:
    """Return whether a run with this error can be measured: needles were inserted and withdrawn."""
    return isinstance(error, TrialsFailedError)


def _leave_unmeasured(ended: FinishedRun, signal_name: str) -> FinishedRun:
    """Return a run that came to its end and was interrupted before it was measured."""
    message = f"interrupted by {signal_name} when the run had ended; it is recorded, and was not measured"
    return replace(ended, outcome=Outcome("success", message, InterruptedRunError(message)))


def _record(order: RunOrder, plan: RunPlan, changes: CodeChanges) -> FinishedRun:
    """Open the record and, if the protocol needs one, the rig; conduct the experiment, and close both."""
    experiment, protocol = order.experiment, order.protocol
    if order.rig is not None:

        def begin(rig: Rig, reporter: Reporter) -> Session:
            require_valid_calibration(plan, rig)
            open_record = partial(_open_record, order, plan, changes, rig.clock, rig.describe())
            return begin_session(rig, open_record, reporter)

        job = RigJob(
            experiment, protocol, order.rig, plan.work, order.command_line, order.attention, order.watching
        )
        return record_on_rig(job, begin, partial(conduct, experiment, protocol))
    clock = SystemClock()
    recorder = _open_record(order, plan, changes, clock, {})
    return FinishedRun(recorder.path, conduct_without_rig(experiment, recorder, clock))


@dataclass(frozen=True)
class RigJob:
    """What is recorded on a rig: an experiment and its protocol, the rig, the end of its progress, and the command.

    `attention` and `watching` are those of `RunOrder`.
    """

    experiment: Experiment
    protocol: ExperimentProtocol
    rig: RigDescription
    work: float
    command_line: tuple[str, ...]
    attention: Attention = UNPAUSED
    watching: Watching = UNWATCHED


def record_on_rig(
    job: RigJob, begin: Callable[[Rig, Reporter], Session], conduct_on: Callable[[Session], Outcome]
) -> FinishedRun:
    """Open a rig without power, begin a record, conduct a run on it, and close the rig; signals stop the axes first.

    Parameters
    ----------
    job : RigJob
        What is recorded.
    begin : callable
        Opens the record.
    conduct_on : callable
        Makes the run, which may be paused meanwhile.
    """
    with show_while_made(job.watching) as watch:
        return _record_watched(job, begin, conduct_on, watch)


def _record_watched(
    job: RigJob,
    begin: Callable[[Rig, Reporter], Session],
    conduct_on: Callable[[Session], Outcome],
    watch: Callable[[Path], None],
) -> FinishedRun:
    protocol = job.protocol
    doing = " ".join(("labrig", *job.command_line[1:]))
    opening = Opening(max_current_ma=protocol.current_limits_ma, power=False)
    ended: FinishedRun | None = None
    try:
        with (
            open_rig_for_person(
                job.rig, doing, seed=protocol.seed, opening=opening, attention=job.attention
            ) as (rig, interrupted),
            progress(protocol.experiment, job.work) as reporter,
        ):
            session = begin(rig, reporter)
            path = session.recorder.path
            watch(path)
            with take_requests(interrupted, path) as requests:
                session.dialogue.requests = requests
                outcome = conduct_on(session)
            is_over = isinstance(outcome.error, BugError | TargetMissedError)
            can_resume = session.dialogue.planned > 0 and not is_over
            ended = FinishedRun(path, outcome, report_needle(rig, path), can_resume=can_resume)
    except MachineError as failure:
        if ended is None:
            raise
        return replace(ended, outcome=add_closing_failure(ended.outcome, failure))
    return replace(ended, signal_name=interrupted.insist())


def _open_record(
    order: RunOrder, plan: RunPlan, changes: CodeChanges, clock: Clock, devices: Mapping[str, object]
) -> Recorder:
    opened = RecordOrder(
        order.experiment,
        order.protocol,
        order.rig,
        order.runs_dir,
        order.run_name,
        order.command_line,
        order.sources.document(),
        plan.trials,
    )
    return open_record(opened, changes, clock, devices)
