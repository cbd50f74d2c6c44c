"""The small object that an entry point of the group `labrig.experiments` names."""

import re
from dataclasses import dataclass

from labrig.errors import InputError
from labrig.plugins import INTERFACE

_PART = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
_OPTIONAL = ("procedure", "resume")
PARTS = ("protocol", "result", "plan", "analyze", "page", "summary", "view", "compare", *_OPTIONAL)
"""What a declaration names by module and attribute."""


@dataclass(frozen=True)
class ExperimentDeclaration:
    """An experiment's name, title, and where its parts stand: `package.module:name` each.

    Attributes
    ----------
    name : str
        What a protocol file has behind `experiment:`; the entry point has the same.
    title : str
        What it is called in a report.
    protocol, result : str
        Its models: a subclass of `labrig.protocol.ExperimentProtocol` and one of `labrig.analysis.Result`.
    plan : str
        `plan(protocol, rig) -> RunPlan`.
    procedure : str or None
        `run(protocol, session) -> None`; None for an experiment that moves no rig.
    analyze : str
        `analyze(run, protocol, request) -> Findings`, or a generator that asks for pictures to be measured.
    page : str
        `page(run, protocol, result) -> Page`.
    summary : str
        `summarise(document) -> Summary`.
    resume : str or None
        `resume(protocol, run) -> Remainder`; None where an interrupted run is not continued.
    view : str
        `view(run, result) -> View`; by default the record alone is shown.
    compare : str
        `compare(old, new) -> ResultComparison`; by default numbers are all that a reanalysis can change.
    reanalysis_keys : tuple of str
        Sections of the protocol that a reanalysis may change.
    puts_needle_in_tissue : bool
        Whether a needle may be in tissue where a run of it was cut short.
    counts : str
        What its analysis counts while it goes on: pictures, hinges.
    interface : int
        Version of the interface that it is written for.

    Raises
    ------
    InputError
        When a part is not written as `package.module:name`.
    """

    name: str
    title: str
    protocol: str
    result: str
    plan: str
    procedure: str | None
    analyze: str
    page: str
    summary: str
    resume: str | None = None
    view: str = "labrig.report.view:show_record_alone"
    compare: str = "labrig.analysis.summary:compare_numbers_alone"
    reanalysis_keys: tuple[str, ...] = ()
    puts_needle_in_tissue: bool = False
    counts: str = "pictures"
    interface: int = INTERFACE

    def __post_init__(self) -> None:
        """Refuse a part that is written in another way."""
        for name in PARTS:
            part = getattr(self, name)
            if part is None and name in _OPTIONAL:
                continue
            if not isinstance(part, str) or not _PART.fullmatch(part):
                raise InputError(
                    f"experiment {self.name}: {name} is {part!r}, expected package.module:name",
                    "name the module and the function or class in it",
                )
