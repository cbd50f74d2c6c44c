"""The interface of experiments to the rest of labrig."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from labrig.analysis.experiment import MeasuredExperiment
from labrig.analysis.outcome import TaskOutcome
from labrig.analysis.result import AnyResult
from labrig.analysis.summary import Summary
from labrig.errors import Problem
from labrig.plugins import Plugin
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.specimen_file import TracksBySpecimen
from labrig.record.events import Event
from labrig.record.reader import Run
from labrig.report.page import Page
from labrig.report.view import View
from labrig.runner.session import Session


@dataclass(frozen=True)
class RunPlan:
    """What a run will do, by a dry run of its procedure.

    Attributes
    ----------
    trials : int
        Trials of the whole run; 0 for an experiment without trials.
    duration_s : float
        Rig time without that of the operator [s].
    moves, pictures, operator_steps : int
        Moves, pictures that are taken, and requests that the operator answers.
    problems : tuple of Problem
        Reasons against the run: moves beyond a limit, pictures that cannot be measured, a target out of view.
    refusal : Problem or None
        Why the answer will be no although the run could be made, such as no path to a target.
    warnings : tuple of Problem
        Why the answer may be no, such as a tolerance below what the camera can certify.
    notes : tuple of str
        What is good to know beforehand, as sentences, such as a random order of holes.
    uses_calibration : bool
        Whether lengths are measured by the rig's calibration, so that the camera has to be as it was then.
    """

    trials: int = 0
    duration_s: float = 0.0
    moves: int = 0
    pictures: int = 0
    operator_steps: int = 0
    problems: tuple[Problem, ...] = ()
    refusal: Problem | None = None
    warnings: tuple[Problem, ...] = ()
    notes: tuple[str, ...] = ()
    uses_calibration: bool = False

    @property
    def work(self) -> float:
        """The end of the progress: the moves, pictures and questions."""
        return float(self.moves + self.pictures + self.operator_steps)


@dataclass(frozen=True)
class Experiment(MeasuredExperiment):
    """An experiment as the registry returns it, to be run, resumed, replayed or shown.

    Attributes
    ----------
    plugin : Plugin
        The package that it comes from.
    title : str
        Its name in a report.
    moves_rig : bool
        Whether it has a procedure; a design has none.
    puts_needle_in_tissue : bool
        Whether a needle may be in tissue when a run of it ends early.
    maps_tracks : bool
        Whether it says which tracks a run left in specimens with a file.
    can_simulate : bool
        Whether a run of it can be computed without pictures.
    counts : str
        What the progress of its analysis counts: pictures, hinges.
    require_parts : callable
        Raises `PluginError` if a declared part does not exist.
    """

    plugin: Plugin
    title: str
    moves_rig: bool
    puts_needle_in_tissue: bool
    maps_tracks: bool
    can_simulate: bool
    counts: str
    require_parts: Callable[[], None]

    def find_problems(self, protocol: ExperimentProtocol) -> tuple[Problem, ...]:
        """Return why a protocol that moves no rig cannot be run."""
        return tuple(self.part("problems")(protocol))

    def run(self, protocol: ExperimentProtocol, session: Session) -> None:
        """Carry out the procedure.

        Raises
        ------
        AnswerIsNoError, SafetyStopError, InterruptedRunError, MachineError
            When it ends early; the caller stops the axes and closes the record.
        """
        self.part("procedure")(protocol, session)

    def simulate(self, protocol: ExperimentProtocol, seed: int) -> TaskOutcome:
        """Return what comes of one virtual run of a protocol that moves no rig."""
        return cast("TaskOutcome", self.part("simulate")(protocol, seed))

    def tell_values(
        self, events: Sequence[Event], truths: Sequence[Mapping[str, Any]]
    ) -> Mapping[str, float | int | bool | str | None]:
        """Return the quantities of a virtual run of the procedure. Raises `InputError` if it has none."""
        return cast("Mapping[str, Any]", self.part("values")(events, truths))

    def list_tracks(
        self, run: Run, protocol: ExperimentProtocol, result: AnyResult | None
    ) -> TracksBySpecimen:
        """Return the tracks that a run left in specimens with a file."""
        return cast("TracksBySpecimen", self.part("tracks")(run, protocol, result))

    def page(self, run: Run, protocol: ExperimentProtocol, result: AnyResult | None) -> Page:
        """Return the page of a run; without a result, the facts of its protocol."""
        return cast("Page", self.part("page")(run, protocol, result))

    def view(self, run: Run, result: AnyResult | None) -> View:
        """Return the additions to the rerun view of a run; without a result, what its record shows by itself."""
        return cast("View", self.part("follow")(run) if result is None else self.part("view")(run, result))

    def summarise(self, result: Mapping[str, Any]) -> Summary:
        """Return the terminal summary of a result."""
        return cast("Summary", self.part("summary")(result))
