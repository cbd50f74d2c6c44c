"""A whole run: open rig and record, conduct the experiment, close both, measure, write the page.

`labrig.run`, `labrig.resume`, the commands and the campaigns all come here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from labrig.analysis.result import AnyResult
from labrig.analysis.run import analyze_run
from labrig.devices.clocks import SystemClock
from labrig.devices.opening import Opening
from labrig.devices.rig import Rig
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
from labrig.plugins import require_devices_installed
from labrig.protocol.load import load_recorded_protocol
from labrig.record.provenance import collect_provenance
from labrig.record.reader import Run, open_run
from labrig.runner.attendant import Attendant
from labrig.runner.conduct import Outcome, conduct, conduct_without_rig
from labrig.runner.dry_run import plan_run
from labrig.runner.experiment import Experiment, RunPlan
from labrig.runner.needle_report import NeedleReport, report_needle
from labrig.runner.plan import count_needed_bytes, require_valid_calibration
from labrig.runner.run_record import RunOrder, open_record
from labrig.runner.session import Progress, Session


@dataclass(frozen=True)
class FinishedRun:
    """A run that has ended, on disk at `path`; `result` and `report` are None if it was not measured.

    `needle` says where the needle was left, None without a rig; `signal_name` is a signal that came after the end;
    `can_resume` says whether the run can be continued.
    """

    path: Path
    outcome: Outcome
    needle: NeedleReport | None = None
    signal_name: str | None = None
    can_resume: bool = False
    report: Path | None = None
    result: Mapping[str, object] | None = None


def perform(order: RunOrder, attendant: Attendant) -> FinishedRun:
    """Record a run, measure it and write its page.

    Raises
    ------
    FileFormatError
        When the rig cannot do what the protocol asks; nothing has moved and nothing has been written.
    OutputExistsError, DiskError, BusError, DriveError, CameraError
        When the run cannot begin.
    """
    return finish(record(order, attendant), order.experiment, order.command_line, attendant)


def record(order: RunOrder, attendant: Attendant) -> FinishedRun:
    """Record a run; nothing is measured. Raises as `perform`."""
    if order.runs_dir.exists() and not order.runs_dir.is_dir():
        raise InputError(
            f"{order.runs_dir} is a file, expected the folder of the runs", "name a folder with --runs-dir"
        )
    experiment, protocol = order.experiment, order.protocol
    experiment.require_parts()
    plan = plan_run(experiment, protocol, order.rig)
    if plan.problems:
        raise FileFormatError(plan.problems)
    for doubt in filter(None, (plan.refusal, *plan.warnings)):
        attendant.say(f"{'' if doubt is plan.refusal else 'warning: '}{doubt.message}; {doubt.hint}")
    require_free_bytes(order.runs_dir, count_needed_bytes(plan, order.rig))
    if order.rig is None:
        clock = SystemClock()
        recorder = open_record(order, plan.trials, clock, {})
        return FinishedRun(recorder.path, conduct_without_rig(experiment, recorder, clock))

    def begin(rig: Rig, progress: Progress) -> Session:
        require_valid_calibration(plan, rig)
        opening = partial(open_record, order, plan.trials, rig.clock, rig.describe())
        return Session(rig, rig.do_aside(opening), progress)

    return record_on_rig(order, plan, attendant, begin, partial(conduct, experiment, protocol))


def finish(
    ended: FinishedRun, experiment: Experiment, command_line: tuple[str, ...], attendant: Attendant
) -> FinishedRun:
    """Measure a recorded run and write its page, if it came to its end; of one that failed the page says why."""
    error = ended.outcome.error
    if error is not None and not is_measurable(error):
        return _show_failure(ended, experiment, attendant)
    left_in = ended.needle is not None and ended.needle.way_out
    ended = replace(ended, needle=ended.needle if left_in else None, can_resume=False)
    if ended.signal_name is not None:
        return _end_interrupted(ended, ended.signal_name)
    try:
        result = measure(ended.path, experiment, command_line, attendant)
        attendant.say("writing the report")
        report = write_page(open_run(ended.path), experiment, result)
    except KeyboardInterrupt as interruption:
        return _end_interrupted(ended, str(interruption) or "SIGINT")
    except AnswerIsNoError as failure:
        return replace(ended, outcome=Outcome(ended.outcome.exit_status, failure.message, failure))
    return replace(ended, report=report, result=result.document)


def measure(
    path: Path, experiment: Experiment, command_line: tuple[str, ...], attendant: Attendant
) -> AnyResult:
    """Measure a run with its own settings, and write a new numbered result."""
    with attendant.progress(f"analysing {path.name}", 1.0) as progress:
        return analyze_run(
            open_run(path),
            experiment,
            progress=lambda done, total: progress(done / total, f"{done} of {total} {experiment.counts}"),
            created=SystemClock().utc(),
            provenance=collect_provenance(command_line),
        )


def is_measurable(error: LabrigError) -> bool:
    """Return whether a run with this error can be measured: needles were inserted and withdrawn."""
    return isinstance(error, TrialsFailedError)


def _show_failure(ended: FinishedRun, experiment: Experiment, attendant: Attendant) -> FinishedRun:
    """Write the page of a run that failed, which says why; not after a fault of the disk, or a bug.

    Nothing that goes wrong with the page hides why the run failed.
    """
    if ended.outcome.exit_status != "failed" or isinstance(ended.outcome.error, DiskError | BugError):
        return ended
    try:
        return replace(ended, report=write_page(open_run(ended.path), experiment, None))
    except (LabrigError, KeyboardInterrupt) as failure:
        attendant.say(f"note: the page was not written: {failure}")
        return ended


def _end_interrupted(ended: FinishedRun, by: str) -> FinishedRun:
    """Return a run that came to its end and was interrupted afterwards."""
    state = "it is recorded; labrig reanalyze measures it and writes its page"
    message = f"interrupted by {by} when the run had ended; {state}"
    return replace(ended, outcome=Outcome(ended.outcome.exit_status, message, InterruptedRunError(message)))


def record_on_rig(
    order: RunOrder,
    plan: RunPlan,
    attendant: Attendant,
    begin: Callable[[Rig, Progress], Session],
    conduct_on: Callable[[Session], Outcome],
) -> FinishedRun:
    """Open a rig without power, begin a record, conduct a run on it, and close the rig; signals stop the axes first.

    Parameters
    ----------
    plan : RunPlan
        How long it takes, and of how many trials it is.
    begin : callable
        Opens the record.
    conduct_on : callable
        Makes the run, which may be paused meanwhile.
    """
    assert order.rig is not None
    protocol, doing = order.protocol, " ".join(("labrig", *order.command_line[1:]))
    lasts_s = plan.duration_s if order.rig.asks_person else 0.0
    opening = Opening(max_current_ma=protocol.current_limits_ma, power=False)
    ended: FinishedRun | None = None
    with attendant.watch() as watch:
        try:
            with (
                attendant.open_rig(order.rig, doing, protocol.seed, opening) as (opened, interrupted),
                attendant.progress(protocol.experiment, plan.work, lasts_s) as progress,
            ):
                session = begin(opened, progress)
                path = session.recorder.path
                watch(path)
                with attendant.take_requests(interrupted, path) as requests:
                    session.dialogue.requests = requests
                    outcome = conduct_on(session)
                is_over = isinstance(outcome.error, BugError | TargetMissedError)
                can_resume = plan.trials > 0 and not is_over
                ended = FinishedRun(path, outcome, report_needle(opened, path), can_resume=can_resume)
        except MachineError as failure:
            if ended is None:
                raise
            return replace(ended, outcome=ended.outcome.add(failure, "closing"))
    return replace(ended, signal_name=interrupted())


def write_page(run: Run, experiment: Experiment, result: AnyResult | None) -> Path:
    """Write `RUN/report.html` and return its path.

    Raises
    ------
    InputError
        When a drive or camera of the run is not installed.
    RecordError
        When record or result are so damaged that nothing can be shown.
    DiskError
        When the page cannot be written.
    """
    # Imported late: the processes that measure are forked before matplotlib is loaded, and stay small.
    from labrig.report.page import Page, write_report

    require_devices_installed(str(run.path), run.plugin_packages)
    protocol = load_recorded_protocol(run.protocol_path, {experiment.name: experiment.protocol_model})
    page = (
        Page(experiment.part("TEMPLATE"))
        if result is None
        else experiment.part("make_page")(run, protocol, result)
    )
    return write_report(
        run,
        protocol,
        page,
        result,
        SystemClock().utc(),
        kind=experiment.title,
        can_resume=bool(run.manifest.get("trials_planned")),
    )
