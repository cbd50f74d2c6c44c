"""Finds experiments by name, and imports a part of one when it is first used."""

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

from labrig.analysis.experiment import Analyze
from labrig.analysis.result import AnyResult, Result, load_result
from labrig.analysis.summary import ResultComparison, Summary
from labrig.devices.rig_file import RigDescription
from labrig.errors import InputError, PluginError
from labrig.experiments.declaration import ExperimentDeclaration
from labrig.plugins import EXPERIMENTS, Plugin, find_plugin, installed
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run
from labrig.report.page import Page
from labrig.report.view import NO_VIEW, View
from labrig.runner.experiment import Experiment, Remainder, RunPlan
from labrig.runner.session import Session

_NO_COMPARISON = ResultComparison()
_Part = TypeVar("_Part")


@dataclass(frozen=True)
class RegisteredExperiment:
    """An experiment of an installed package; see `labrig.runner.Experiment`."""

    plugin: Plugin
    declaration: ExperimentDeclaration

    def __reduce__(self) -> tuple[object, ...]:
        """Cross to another process by name."""
        return find_experiment, (self.name,)

    @property
    def name(self) -> str:
        """What a protocol file has behind `experiment:`."""
        return self.declaration.name

    @property
    def title(self) -> str:
        """What it is called in a report."""
        return self.declaration.title

    @property
    def moves_rig(self) -> bool:
        """Whether it has a procedure."""
        return self.declaration.procedure is not None

    @property
    def can_resume(self) -> bool:
        """Whether an interrupted run of it can be continued."""
        return self.declaration.resume is not None

    @property
    def puts_needle_in_tissue(self) -> bool:
        """Whether a needle may be in tissue where a run of it was cut short."""
        return self.declaration.puts_needle_in_tissue

    @property
    def counts(self) -> str:
        """What its analysis counts while it goes on."""
        return self.declaration.counts

    @property
    def reanalysis_keys(self) -> tuple[str, ...]:
        """Sections of the protocol that a reanalysis may change."""
        return self.declaration.reanalysis_keys

    @property
    def protocol_model(self) -> type[ExperimentProtocol]:
        """The model of its protocol."""
        model: type[ExperimentProtocol] = self._part("protocol")
        return model

    @property
    def result_model(self) -> type[Result]:
        """The model of its result."""
        model: type[Result] = self._part("result")
        return model

    @property
    def analyze(self) -> Analyze:
        """The function that makes a result of a run."""
        analyze: Analyze = self._part("analyze")
        return analyze

    def plan(self, protocol: ExperimentProtocol, rig: RigDescription | None) -> RunPlan:
        """Return what the protocol is going to ask of a rig."""
        plan: RunPlan = self._part("plan")(protocol, rig)
        return plan

    def run(self, protocol: ExperimentProtocol, session: Session) -> None:
        """Carry out the procedure."""
        self._part("procedure")(protocol, session)

    def resume(self, protocol: ExperimentProtocol, run: Run) -> Remainder:
        """Return what is left of an interrupted run."""
        remainder: Remainder = self._part("resume")(protocol, run)
        return remainder

    def page(self, run: Run, protocol: ExperimentProtocol, result: AnyResult | None) -> Page:
        """Return what the report shows of a run."""
        page: Page = self._part("page")(run, protocol, result)
        return page

    def view(self, run: Run, result: AnyResult | None) -> View:
        """Return what the rerun view shows beside pictures, axes and events."""
        if self.declaration.view is None or result is None:
            return NO_VIEW
        view: View = self._part("view")(run, result)
        return view

    def summarise(self, result: Mapping[str, Any]) -> Summary:
        """Return what a terminal shows of a result."""
        summary: Summary = self._part("summary")(result)
        return summary

    def compare(self, old: Mapping[str, Any], new: Mapping[str, Any]) -> ResultComparison:
        """Return what a reanalysis changed beside the numbers."""
        if self.declaration.compare is None:
            return _NO_COMPARISON
        comparison: ResultComparison = self._part("compare")(old, new)
        return comparison

    def _part(self, name: str) -> Any:
        """Import a part; a declaration that names none is refused, and so is a name that leads nowhere."""
        where = getattr(self.declaration, name)
        if where is None:
            raise InputError(f"the experiment {self.name} has no {name}", "it moves no rig, or ends as it is")
        module, _, attribute = where.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise PluginError(
                f"{self.plugin}: its {name} is not at {where}: {error}",
                f"install another version of {self.plugin.package}",
            ) from error


@cache
def find_experiment(name: str) -> RegisteredExperiment:
    """Return the experiment of this name.

    Raises
    ------
    InputError
        When no installed package has it, or several have.
    PluginError
        When its declaration cannot be imported or is none.
    MachineError
        When labrig's own are missing.
    """
    plugin = find_plugin(EXPERIMENTS, name)
    declaration = plugin.load()
    if not isinstance(declaration, ExperimentDeclaration) or declaration.name != name:
        raise PluginError(
            f"{plugin} is declared by {declaration!r}, expected an ExperimentDeclaration of the same name",
            f"install another version of {plugin.package}",
        )
    return RegisteredExperiment(plugin, declaration)


class ProtocolModels(Mapping[str, type[ExperimentProtocol]]):
    """The model of each experiment's protocol, imported when it is asked for."""

    def __getitem__(self, name: str) -> type[ExperimentProtocol]:
        if name not in installed(EXPERIMENTS):
            raise KeyError(name)
        return find_experiment(name).protocol_model

    def __iter__(self) -> Iterator[str]:
        return iter(installed(EXPERIMENTS))

    def __len__(self) -> int:
        return len(installed(EXPERIMENTS))

    def __contains__(self, name: object) -> bool:
        return name in installed(EXPERIMENTS)


PROTOCOL_MODELS = ProtocolModels()
"""Of every experiment that is installed."""


def experiment_of(run: Run) -> Experiment:
    """Return the experiment of a run; of a withdrawal that of the run whose needle it took out.

    Raises
    ------
    InputError
        When no installed package has it; names the package that made the record.
    """
    name = str(run.protocol.get("experiment"))
    if name not in PROTOCOL_MODELS:
        package = run.plugin_packages.get(name, "a package that its record does not name")
        raise InputError(
            f"{run.path} is a run of the experiment {name}, which is not installed",
            f"it was made with {package}: install it; labrig runs check, view and export need none of it",
        )
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
    """Return what the experiment of a run adds to its rerun view; nothing where it is not installed.

    Raises
    ------
    RecordError
        When the result is damaged.
    """
    if run.protocol.get("experiment") not in PROTOCOL_MODELS:
        return NO_VIEW
    return experiment_of(run).view(run, result_of(run))
