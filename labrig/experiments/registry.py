"""Finds experiments by name, with what a run, an analysis and a report ask of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

from labrig.analysis.experiment import Analyze
from labrig.analysis.result import AnyResult, Result, load_result
from labrig.analysis.summary import ResultComparison, Summary
from labrig.devices.rig_file import RigDescription
from labrig.experiments.declared import PROTOCOL_MODELS, DeclaredExperiment, find_declared
from labrig.plugins import EXPERIMENTS, require_installed
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run
from labrig.report.page import Page
from labrig.report.view import NO_VIEW, View
from labrig.runner.experiment import Remainder, RunPlan
from labrig.runner.session import Session

_NO_COMPARISON = ResultComparison()
_Part = TypeVar("_Part")


@dataclass(frozen=True)
class RegisteredExperiment(DeclaredExperiment):
    """An experiment with its parts typed, each imported when it is first used; see `labrig.runner.Experiment`."""

    def __reduce__(self) -> tuple[object, ...]:
        """Cross to another process by name."""
        return find_experiment, (self.name,)

    @property
    def result_model(self) -> type[Result]:
        """The model of its result."""
        model: type[Result] = self.part("result")
        return model

    @property
    def analyze(self) -> Analyze:
        """The function that makes a result of a run."""
        analyze: Analyze = self.part("analyze")
        return analyze

    def plan(self, protocol: ExperimentProtocol, rig: RigDescription | None) -> RunPlan:
        """Return what the protocol is going to ask of a rig."""
        plan: RunPlan = self.part("plan")(protocol, rig)
        return plan

    def run(self, protocol: ExperimentProtocol, session: Session) -> None:
        """Carry out the procedure."""
        self.part("procedure")(protocol, session)

    def resume(self, protocol: ExperimentProtocol, run: Run) -> Remainder:
        """Return what is left of an interrupted run."""
        remainder: Remainder = self.part("resume")(protocol, run)
        return remainder

    def page(self, run: Run, protocol: ExperimentProtocol, result: AnyResult | None) -> Page:
        """Return what the report shows of a run."""
        page: Page = self.part("page")(run, protocol, result)
        return page

    def view(self, run: Run, result: AnyResult | None) -> View:
        """Return what the rerun view shows beside pictures, axes and events."""
        if self.declaration.view is None or result is None:
            return NO_VIEW
        view: View = self.part("view")(run, result)
        return view

    def summarise(self, result: Mapping[str, Any]) -> Summary:
        """Return what a terminal shows of a result."""
        summary: Summary = self.part("summary")(result)
        return summary

    def compare(self, old: Mapping[str, Any], new: Mapping[str, Any]) -> ResultComparison:
        """Return what a reanalysis changed beside the numbers."""
        if self.declaration.compare is None:
            return _NO_COMPARISON
        comparison: ResultComparison = self.part("compare")(old, new)
        return comparison


@cache
def find_experiment(name: str) -> RegisteredExperiment:
    """Return the experiment of this name. Raises as `find_declared`."""
    declared = find_declared(name)
    return RegisteredExperiment(declared.plugin, declared.declaration)


def experiment_of(run: Run) -> RegisteredExperiment:
    """Return the experiment of a run; of a withdrawal that of the run whose needle it took out.

    Raises
    ------
    InputError
        When no installed package has it; names the package that made the record.
    """
    name = str(run.protocol.get("experiment"))
    require_installed(EXPERIMENTS, name, str(run.path), run.plugin_packages)
    return find_experiment(name)


def protocol_of(run: Run) -> ExperimentProtocol:
    """Return the protocol of a run as its experiment's model.

    Raises
    ------
    RecordError
        When it is missing or was changed.
    FileFormatError
        When this labrig no longer knows what it says.
    """
    return load_protocol(run.protocol_path, PROTOCOL_MODELS)


def result_of(run: Run, number: int | None = None) -> AnyResult | None:
    """Return a result of a run: the one of that number, or the newest; None where it has none.

    Raises
    ------
    InputError, RecordError
        As `labrig.analysis.load_result` and `experiment_of`.
    """
    return load_result(run, experiment_of(run).result_model, number)


def view_of(run: Run) -> View:
    """Return what the experiment of a run adds to its rerun view.

    Raises
    ------
    InputError
        When the experiment is not installed, or cannot be imported.
    RecordError
        When the result is damaged.
    """
    return experiment_of(run).view(run, result_of(run))
