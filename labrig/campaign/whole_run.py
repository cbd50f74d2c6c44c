"""Depth `rig`: a whole run on a simulated rig, with camera, bus and record, measured as any other run."""

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import NoReturn

from labrig.analysis.outcome import TaskOutcome
from labrig.analysis.result import AnyResult, list_quantities
from labrig.analysis.run import analyze_run
from labrig.devices.clocks import SystemClock
from labrig.devices.opening import Opening
from labrig.devices.operator import NO_OFFER, Offer, OperatorRequest
from labrig.devices.rig import open_rig
from labrig.devices.rig_file import RigDescription
from labrig.errors import AnswerIsNoError, BugError, FileFormatError, TrialsFailedError
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.provenance import CodeChanges, collect_provenance
from labrig.record.reader import open_run
from labrig.record.sink import RecordSink
from labrig.runner.conduct import Outcome, conduct, conduct_without_rig
from labrig.runner.dry_run import plan_run
from labrig.runner.experiment import Experiment, RunPlan
from labrig.runner.plan import require_valid_calibration
from labrig.runner.run_record import RecordOrder, open_record
from labrig.runner.supervised_record import begin_session

_COMMAND = ("labrig", "campaign")


def run_whole(
    experiment: Experiment, protocol: ExperimentProtocol, rig: RigDescription | None
) -> TaskOutcome:
    """Make and measure a run in a temporary folder, and return what came of it.

    Raises
    ------
    FileFormatError
        When the rig cannot do what the protocol asks.
    LabrigError
        When the run cannot begin, or cannot be measured although it succeeded.
    """
    plan = plan_run(experiment, protocol, rig)
    if plan.problems:
        raise FileFormatError(plan.problems)
    with tempfile.TemporaryDirectory(prefix="labrig-campaign-") as folder:
        order = RecordOrder(experiment, protocol, rig, Path(folder), "run", _COMMAND, {}, plan.trials)
        outcome = _record(order, plan)
        if outcome.error is not None and not _is_measurable(outcome.error):
            if isinstance(outcome.error, BugError):
                raise outcome.error
            return TaskOutcome(outcome.exit_status, outcome.reason or None, {})
        return _measure(experiment, Path(folder) / "run", outcome)


def _record(order: RecordOrder, plan: RunPlan) -> Outcome:
    if order.rig is None:
        clock = SystemClock()
        return conduct_without_rig(order.experiment, open_record(order, CodeChanges(), clock, {}), clock)
    opening = Opening(max_current_ma=order.protocol.current_limits_ma, power=False)
    with ExitStack() as stack:
        rig = stack.enter_context(
            open_rig(
                order.rig,
                seed=order.protocol.seed,
                person=_Nobody(),
                interrupted=lambda: None,
                doing=" ".join(_COMMAND),
                opening=opening,
            )
        )
        require_valid_calibration(plan, rig)

        def begin() -> RecordSink:
            return open_record(order, CodeChanges(), rig.clock, rig.describe())

        session = begin_session(rig, begin, lambda _done, _doing: None)
        return conduct(order.experiment, order.protocol, session)


class _Nobody:
    """Stands where a person would: a simulated rig asks nobody."""

    def ask(
        self,
        request: OperatorRequest,
        meanwhile: Callable[[], None],  # noqa: ARG002
        offer: Offer = NO_OFFER,  # noqa: ARG002
    ) -> NoReturn:
        """Refuse a request."""
        raise BugError(f"a campaign asked a person: {request.text}")


def _is_measurable(error: Exception) -> bool:
    return isinstance(error, TrialsFailedError)


def _measure(experiment: Experiment, run: Path, outcome: Outcome) -> TaskOutcome:
    """Measure a recorded run; one whose pictures cannot be measured has no values."""
    analyze = partial(analyze_run, open_run(run), experiment, workers=1)
    try:
        result: AnyResult = analyze(created=SystemClock().utc(), provenance=collect_provenance(_COMMAND))
    except AnswerIsNoError as error:
        return TaskOutcome(outcome.exit_status, error.message, {})
    return TaskOutcome(outcome.exit_status, outcome.reason or None, list_quantities(result.content))
