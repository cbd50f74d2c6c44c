"""Depth `rig`: a whole run on a simulated rig, with camera, bus and record, measured as any other run."""

import tempfile
from pathlib import Path

from labrig.analysis.experiment import TaskOutcome
from labrig.analysis.result import AnyResult, list_quantities
from labrig.analysis.run import analyze_run
from labrig.devices.clocks import SystemClock
from labrig.devices.rig_file import RigDescription
from labrig.errors import AnswerIsNoError, BugError
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.provenance import collect_provenance
from labrig.record.reader import open_run
from labrig.runner.attendant import Attendant
from labrig.runner.conduct import Outcome
from labrig.runner.experiment import Experiment
from labrig.runner.run_record import RunOrder
from labrig.runner.whole_run import is_measurable, record

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
    with tempfile.TemporaryDirectory(prefix="labrig-campaign-") as folder:
        order = RunOrder(experiment, protocol, rig, Path(folder), "run", _COMMAND, {})
        ended = record(order, Attendant())
        outcome = ended.outcome
        if outcome.error is not None and not is_measurable(outcome.error):
            if isinstance(outcome.error, BugError):
                raise outcome.error
            return TaskOutcome(outcome.exit_status, outcome.reason or None, {})
        return _measure(experiment, ended.path, outcome)


def _measure(experiment: Experiment, run: Path, outcome: Outcome) -> TaskOutcome:
    """Measure a recorded run; one whose pictures cannot be measured has no values."""
    now, provenance = SystemClock().utc(), collect_provenance(_COMMAND)
    try:
        result: AnyResult = analyze_run(
            open_run(run), experiment, workers=1, created=now, provenance=provenance
        )
    except AnswerIsNoError as error:
        return TaskOutcome(outcome.exit_status, error.message, {})
    return TaskOutcome(outcome.exit_status, outcome.reason or None, list_quantities(result.content))
