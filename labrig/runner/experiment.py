"""The interface of experiments to the rest of labrig."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from labrig.analysis.experiment import MeasuredExperiment
from labrig.analysis.outcome import TaskOutcome
from labrig.analysis.result import AnyResult
from labrig.analysis.summary import Summary
from labrig.devices.rig_file import RigDescription
from labrig.errors import Problem
from labrig.plugins import Plugin
from labrig.protocol.conditions import Condition
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.specimen_file import TracksBySpecimen
from labrig.record.decisions import NO_DECISIONS, Decisions
from labrig.record.reader import Run
from labrig.report.page import Page
from labrig.report.view import View
from labrig.runner.session import Session


@dataclass(frozen=True)
class PlannedMove:
    """One move of one axis: start and end [mm or rad], and speed [per s]; `where` is the protocol's key."""

    where: str
    axis: str
    start: float
    position: float
    speed: float

    @property
    def duration_s(self) -> float:
        """Time at the set speed [s]; the ramps are negligible."""
        return abs(self.position - self.start) / self.speed


@dataclass(frozen=True)
class RunPlan:
    """What a run will do, known before anything moves.

    Attributes
    ----------
    trials : int
        Trials of the whole run; 0 for an experiment without trials.
    duration_s : float
        Rig time without that of the operator [s].
    pictures, operator_steps : int
        Pictures that are taken, and requests that the operator answers.
    moves : tuple of PlannedMove
        Those of one trial, in order: the sheath goes in, the needle goes in and out, the sheath comes out.
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
    pictures: int = 0
    operator_steps: int = 0
    moves: tuple[PlannedMove, ...] = ()
    problems: tuple[Problem, ...] = ()
    refusal: Problem | None = None
    warnings: tuple[Problem, ...] = ()
    notes: tuple[str, ...] = ()
    uses_calibration: bool = False

    @property
    def work(self) -> float:
        """The end of the progress: rig time [s], or pictures if nothing moves."""
        return self.duration_s or float(self.pictures)


@dataclass(frozen=True)
class Remainder:
    """The rest of an interrupted run: how many trials are kept, how many are left, and the call that makes those.

    The session that makes the rest begins with `decisions`, those of its person so far, and `conditions`, those of the
    protocol.
    """

    kept: int
    left: int
    run: Callable[[Session], None]
    decisions: Decisions = NO_DECISIONS
    conditions: tuple[Condition, ...] = ()


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
    can_resume : bool
        Whether an interrupted run of it can be continued.
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
    can_resume: bool
    puts_needle_in_tissue: bool
    maps_tracks: bool
    can_simulate: bool
    counts: str
    require_parts: Callable[[], None]

    def plan(self, protocol: ExperimentProtocol, rig: RigDescription | None) -> RunPlan:
        """Return the plan of a run; the rig is None for a protocol that moves none."""
        return cast("RunPlan", self.part("plan")(protocol, rig))

    def run(self, protocol: ExperimentProtocol, session: Session) -> None:
        """Carry out the procedure.

        Raises
        ------
        AnswerIsNoError, SafetyStopError, InterruptedRunError, MachineError
            When it ends early; the caller stops the axes and closes the record.
        """
        self.part("procedure")(protocol, session)

    def resume(self, protocol: ExperimentProtocol, run: Run) -> Remainder:
        """Return the rest of an interrupted run. Raises `InputError` when there is no room for it."""
        remainder = cast("Remainder", self.part("resume")(protocol, run))
        return replace(remainder, decisions=run.decisions, conditions=protocol.conditions)

    def simulate(self, protocol: ExperimentProtocol, rig: RigDescription | None, seed: int) -> TaskOutcome:
        """Return what comes of one virtual run, without pictures; the same seed gives the same bits in any process.

        The rig is None for a protocol that moves none.

        Raises
        ------
        InputError
            When the experiment has no such part, or it cannot simulate what the protocol asks for.
        """
        return cast("TaskOutcome", self.part("simulate")(protocol, rig, seed))

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


def total_duration_s(moves: Sequence[PlannedMove]) -> float:
    """Return the total duration of moves made one after another [s]."""
    return sum(move.duration_s for move in moves)
