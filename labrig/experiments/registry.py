"""Finds experiments by name, and the protocol, result and view of a run by its experiment."""

from labrig.analysis.result import AnyResult, load_result
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.plugins import EXPERIMENTS, require_installed
from labrig.protocol.load import load_recorded_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run
from labrig.report.view import View
from labrig.runner.experiment import Experiment


def find_run_experiment(run: Run) -> Experiment:
    """Return the experiment of a run; for a withdrawal, that of the run whose needle it withdrew.

    Raises
    ------
    InputError
        When no installed package has it; the message names the package that made the record.
    """
    name = str(run.protocol.get("experiment"))
    require_installed(EXPERIMENTS, name, str(run.path), run.plugin_packages)
    return find_experiment(name)


def load_run_protocol(run: Run) -> ExperimentProtocol:
    """Return the protocol of a run as its experiment's model.

    Raises
    ------
    RecordError
        When it is missing or was changed.
    FileFormatError
        When this version of labrig cannot read it.
    """
    return load_recorded_protocol(run.protocol_path, PROTOCOL_MODELS)


def load_run_result(run: Run, number: int | None = None) -> AnyResult | None:
    """Return the result of a run with that number, or the newest; None if the run has no result.

    Raises
    ------
    InputError, RecordError
        As `labrig.analysis.load_result` and `find_run_experiment`.
    """
    return load_result(run, find_run_experiment(run).part("RunResult"), number)


def make_run_view(run: Run) -> View:
    """Return the additions of a run's experiment to its rerun view.

    Raises
    ------
    InputError
        When the experiment is not installed, or cannot be imported.
    RecordError
        When the result is damaged.
    """
    experiment, result = find_run_experiment(run), load_run_result(run)
    view: View = experiment.part("make_view")(run, result) if result is not None else follow_run(run)
    return view


def follow_run(run: Run) -> View:
    """Return what is drawn of a run that is being made. Raises `InputError` as `find_run_experiment`."""
    view: View = find_run_experiment(run).part("follow")(run)
    return view
