"""What an experiment is to the rest of labrig: the one interface behind which each of them stands."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from labrig.analysis.experiment import MeasuredExperiment
from labrig.analysis.result import AnyResult
from labrig.analysis.summary import ResultComparison, Summary
from labrig.devices.rig_file import RigDescription
from labrig.errors import Problem
from labrig.plugins import Plugin
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run
from labrig.report.page import Page
from labrig.report.view import View
from labrig.runner.session import Session


@dataclass(frozen=True)
class PlannedMove:
    """One move of one axis: where from, where to [mm or rad], how fast [per s]; `where` is the protocol's key."""

    where: str
    axis: str
    start: float
    position: float
    speed: float

    @property
    def duration_s(self) -> float:
        """Time at the set speed [s]; the ramps are short beside it."""
        return abs(self.position - self.start) / self.speed


@dataclass(frozen=True)
class RunPlan:
    """What an experiment is going to do, known before anything moves.

    Attributes
    ----------
    trials : int
        Trials of the whole run; none of an experiment that counts none.
    duration_s : float
        Rig time without the operator's [s].
    pictures, operator_steps : int
        Pictures that are taken, and requests that the operator answers.
    problems : tuple of Problem
        What rules the run out: moves beyond a limit, pictures that cannot be measured, a target out of view.
    refusal : Problem or None
        Why the answer is going to be no although the run could be made, as where no path leads to a target.
    """

    trials: int = 0
    duration_s: float = 0.0
    pictures: int = 0
    operator_steps: int = 0
    problems: tuple[Problem, ...] = ()
    refusal: Problem | None = None

    @property
    def work(self) -> float:
        """What progress counts up to: rig time [s], or pictures where nothing moves."""
        return self.duration_s or float(self.pictures)


@dataclass(frozen=True)
class Remainder:
    """What is left of an interrupted run: how many trials are kept, how many are left, and what makes those."""

    kept: int
    left: int
    run: Callable[[Session], None]


@dataclass(frozen=True)
class Experiment(MeasuredExperiment):
    """An experiment, as the registry hands it to whoever runs, resumes, replays or shows it.

    Attributes
    ----------
    plugin : Plugin
        The package that it comes from.
    title : str
        What it is called in a report.
    moves_rig : bool
        Whether it has a procedure; a design has none.
    can_resume : bool
        Whether an interrupted run of it can be continued.
    puts_needle_in_tissue : bool
        Whether a needle may be in tissue where a run of it was cut short.
    counts : str
        What its analysis counts while it goes on: pictures, hinges.
    require_parts : callable
        Raises `PluginError` where a part that it declares is not there.
    """

    plugin: Plugin
    title: str
    moves_rig: bool
    can_resume: bool
    puts_needle_in_tissue: bool
    counts: str
    require_parts: Callable[[], None]

    def plan(self, protocol: ExperimentProtocol, rig: RigDescription | None) -> RunPlan:
        """Return what the protocol is going to ask of a rig; None for a protocol that moves none."""
        return cast("RunPlan", self.part("plan")(protocol, rig))

    def run(self, protocol: ExperimentProtocol, session: Session) -> None:
        """Carry out the procedure.

        Raises
        ------
        AnswerIsNoError, SafetyStopError, InterruptedRunError, MachineError
            However it ends before its end; the caller stops the axes and closes the record.
        """
        self.part("procedure")(protocol, session)

    def resume(self, protocol: ExperimentProtocol, run: Run) -> Remainder:
        """Return what is left of an interrupted run. Raises `InputError` when there is no room for the rest."""
        return cast("Remainder", self.part("resume")(protocol, run))

    def page(self, run: Run, protocol: ExperimentProtocol, result: AnyResult | None) -> Page:
        """Return what the report shows of a run; without a result, the facts of its protocol."""
        return cast("Page", self.part("page")(run, protocol, result))

    def view(self, run: Run, result: AnyResult | None) -> View:
        """Return what the rerun view shows beside pictures, axes and events; nothing without a result."""
        return View() if result is None else cast("View", self.part("view")(run, result))

    def summarise(self, result: Mapping[str, Any]) -> Summary:
        """Return what a terminal shows of a result."""
        return cast("Summary", self.part("summary")(result))

    def compare(self, old: Mapping[str, Any], new: Mapping[str, Any]) -> ResultComparison:
        """Return what a reanalysis changed beside the numbers, such as commands that would have differed."""
        return cast("ResultComparison", self.part("compare")(old, new))


def total_duration_s(moves: Sequence[PlannedMove]) -> float:
    """Return the time that moves take one after another [s]."""
    return sum(move.duration_s for move in moves)
