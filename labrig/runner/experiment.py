"""The interface of experiments to the rest of labrig."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache, partial
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from labrig.analysis.experiment import MeasuredExperiment
from labrig.errors import InputError, LabrigError, PluginError, Problem
from labrig.plugins import EXPERIMENTS, INTERFACE, Plugin, find_plugin
from labrig.protocol.sections import ExperimentProtocol

if TYPE_CHECKING:  # an analysis imports its experiment's package, and must load nothing that moves or draws
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
    uses_calibration: bool = False

    @property
    def work(self) -> float:
        """The end of the progress: the moves, pictures and questions."""
        return float(self.moves + self.pictures + self.operator_steps)


PLACES: Mapping[str, str] = {
    name: place
    for place, names in (
        ("protocol", "Protocol"),
        ("procedure", "run"),
        ("analysis", "measure UNITS conclude analyze find_problems estimate_s"),
        ("result", "RunResult summarise"),
        ("page", "TEMPLATE make_page make_films"),
        ("view", "make_view follow"),
        ("virtual", "tell_values"),
    )
    for name in names.split()
}
"""Part of an experiment -> the module of its package in which it stands; a small one is a single module.

`find_problems(protocol)` says why a protocol that moves no rig cannot be run, `estimate_s(protocol)` how long it
computes; `tell_values(events, truths)` tells the
quantities of a virtual run. `TEMPLATE` has the words of the page, `make_page(run, protocol, result)` what is drawn;
`make_films(run, content)` shows a needle's way, `make_view(run, result)` and `follow(run)` draw in the viewer, and
`summarise(result)` returns the tables of the result for a terminal, where the page's verdict follows.
"""


@dataclass(frozen=True)
class Experiment(MeasuredExperiment):
    """An experiment, as its entry point names it; its parts are found by their names, see `PLACES`.

    At the least it has a `Protocol` and `run(protocol, session)`, and `measure(picture, protocol) -> row` with the
    `UNITS` of its columns, or `analyze(run, protocol, request) -> Findings` with a `RunResult`. What it lacks of the
    others is the default: the table of rows is its result, its page and its summary.

    Attributes
    ----------
    name : str
        The value of `experiment:` in a protocol file; also the name of the entry point.
    module : str
        The module, or package, that holds its parts: `__name__` where the entry point names it.
    title : str
        Its name in a report.
    reanalysis_keys : tuple of str
        Sections of the protocol, or single keys of one, that a reanalysis may change.
    counts : str
        What the progress of its analysis counts: pictures, hinges.
    interface : int
        The version of the interface that it was written for.
    """

    name: str
    module: str
    title: str = ""
    reanalysis_keys: tuple[str, ...] = ("analysis",)
    counts: str = "pictures"
    interface: int = INTERFACE

    @property
    def plugin(self) -> Plugin:
        """The package that it comes from."""
        return find_plugin(EXPERIMENTS, self.name)

    @property
    def moves_rig(self) -> bool:
        """Whether it has a procedure; one that only computes says with `find_problems` why it cannot be run."""
        return self.find_part("run") is not None or self.find_part("find_problems") is None

    def find_part(self, name: str) -> Any:
        """Return a part; None if it has none. Raises `PluginError` when its module cannot be imported."""
        try:
            return _find_part(self.module, name)
        except Exception as error:
            raise self._blame(error) from error

    def part(self, name: str) -> Any:
        """Return a part, or its default. Raises `InputError` when it has none."""
        found = self.find_part(name)
        if found is None and name in _DEFAULTS:
            module, attribute = _DEFAULTS[name]
            found = getattr(import_module(module), attribute)
            return partial(found, self) if name == "analyze" else found
        if found is None:
            raise InputError(f"the experiment {self.name} has no {name}", "it cannot do this")
        return found

    def call(self, code: Callable[[], Any], more: str = "") -> Any:
        """Return what code of its package returns; what that raises by mistake is blamed on it, with file and line.

        `more` ends the hint. Raises `LabrigError` as it comes, and `PluginError`.
        """
        try:
            return code()
        except Exception as error:
            is_labrigs = self.plugin.package == "labrig" or type(error).__module__.startswith("labrig.")
            if is_labrigs or isinstance(error, LabrigError):
                raise
            raise self._blame(error, more) from error

    def _blame(self, error: Exception, more: str = "") -> PluginError:
        frames = traceback.extract_tb(error.__traceback__)
        package = find_spec(self.module.partition(".")[0])
        root = "" if package is None else (package.origin or "").removesuffix("__init__.py")
        own = [frame for frame in frames if root and frame.filename.startswith(root)] or list(frames)
        where = f", in {own[-1].filename}, line {own[-1].lineno}" if own else ""
        return PluginError(
            f"{self.plugin}: {type(error).__name__}: {error}{where}",
            f"mend it, or ask who wrote {self.plugin.package}{more}",
        )

    def require_parts(self) -> None:
        """Refuse an experiment that lacks a part that it needs, before anything moves. Raises `PluginError`."""
        model = self.find_part("Protocol")
        if not (isinstance(model, type) and issubclass(model, ExperimentProtocol)):
            raise self._name_missing("Protocol, a subclass of ExperimentProtocol", "Protocol")
        if self.find_part("run") is None and self.find_part("find_problems") is None:
            raise self._name_missing("run(protocol, session)", "run")
        if self.find_part("analyze") is None and self.find_part("measure") is None:
            raise self._name_missing(
                "measure(picture, protocol) or analyze(run, protocol, request)", "measure"
            )

    def _name_missing(self, what: str, name: str) -> PluginError:
        """Return that a part is missing, with what was probably meant."""
        near = get_close_matches(name, dir(import_module(self.module)), 1)
        return PluginError(
            f"{self.plugin}: {self.module} has no {what}",
            f"did you mean {name} where it says {near[0]}?" if near else "see: labrig manual extend",
        )

    def run(self, protocol: ExperimentProtocol, session: Session) -> None:
        """Carry out the procedure.

        Raises
        ------
        AnswerIsNoError, SafetyStopError, InterruptedRunError, MachineError
            When it ends early; the caller stops the axes and closes the record.
        """
        self.call(partial(self.part("run"), protocol, session), f"; the record is {session.recorder.path}")


@cache
def _find_part(module: str, name: str) -> Any:
    """Return a part of the experiment in a module or package; None without it."""
    place = f"{module}.{PLACES[name]}"
    is_package = hasattr(import_module(module), "__path__") and find_spec(place) is not None
    return getattr(import_module(place if is_package else module), name, None)


_DEFAULTS: Mapping[str, tuple[str, str]] = {
    "analyze": ("labrig.analysis.row_table", "analyze_rows"),
    "RunResult": ("labrig.analysis.row_table", "RowTable"),
    "summarise": ("labrig.analysis.row_table", "summarise"),
    "TEMPLATE": ("labrig.report.row_page", "TEMPLATE"),
    "make_page": ("labrig.report.row_page", "make_page"),
    "make_view": ("labrig.report.view", "show_record_alone"),
    "follow": ("labrig.report.view", "follow_record_alone"),
}
"""Part -> module and name of what stands in its place."""
