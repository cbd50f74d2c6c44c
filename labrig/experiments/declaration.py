"""The small object that an entry point of the group `labrig.experiments` names."""

import re
from dataclasses import dataclass

from labrig.errors import InputError
from labrig.plugins import INTERFACE

_PART = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
_OPTIONAL = ("procedure", "problems", "tracks", "simulate", "values")
PARTS = ("protocol", "result", "analyze", "page", "summary", "view", "follow", *_OPTIONAL)
"""What a declaration names by module and attribute."""


@dataclass(frozen=True)
class ExperimentDeclaration:
    """An experiment's name, title, and the places of its parts, each as `package.module:name`.

    Attributes
    ----------
    name : str
        The value of `experiment:` in a protocol file; also the name of the entry point.
    title : str
        Its name in a report.
    protocol, result : str
        Its models: a subclass of `labrig.protocol.ExperimentProtocol` and one of `labrig.analysis.Result`.
    procedure : str or None
        `run(protocol, session) -> None`; None for an experiment that moves no rig. A run can be paused at each question
        and at the end of each trial; see `Session.reach_safe_point` and `Session.attempt` for more.
    analyze : str
        `analyze(run, protocol, request) -> Findings`, or a generator that asks for pictures to be measured. It leaves
        out each trial that has `left_out`.
    page : str
        `page(run, protocol, result) -> Page`.
    summary : str
        `summarise(document) -> Summary`.
    problems : str or None
        `find_problems(protocol) -> tuple of Problem`, why a protocol that moves no rig cannot be run.
    tracks : str or None
        `list_tracks(run, protocol, result) -> TracksBySpecimen`, the tracks that a run left in specimens with a file;
        the result is None if the run was not measured. None: an experiment that leaves no tracks.
    simulate : str or None
        `simulate(protocol, seed) -> TaskOutcome`, one virtual run of a protocol that moves no rig.
    values : str or None
        `tell_values(events, truths)`, the quantities of a virtual run of the procedure; None: a campaign makes whole
        runs.
    view : str
        `view(run, result) -> View`; by default only the record is shown.
    follow : str
        `follow(run) -> View`, of a run that is being made or was not measured; by default only the record is shown.
    reanalysis_keys : tuple of str
        Sections of the protocol that a reanalysis may change.
    puts_needle_in_tissue : bool
        Whether a needle may be in tissue when a run of it ends early.
    counts : str
        What the progress of its analysis counts: pictures, hinges.
    interface : int
        The version of the interface that it was written for.

    Raises
    ------
    InputError
        When a part is not written as `package.module:name`.
    """

    name: str
    title: str
    protocol: str
    result: str
    procedure: str | None
    analyze: str
    page: str
    summary: str
    problems: str | None = None
    tracks: str | None = None
    simulate: str | None = None
    values: str | None = None
    view: str = "labrig.report.view:show_record_alone"
    follow: str = "labrig.report.view:follow_record_alone"
    reanalysis_keys: tuple[str, ...] = ()
    puts_needle_in_tissue: bool = False
    counts: str = "pictures"
    interface: int = INTERFACE

    def __post_init__(self) -> None:
        """Refuse a part that is not written as `package.module:name`."""
        for name in PARTS:
            part = getattr(self, name)
            if part is None and name in _OPTIONAL:
                continue
            if not isinstance(part, str) or not _PART.fullmatch(part):
                raise InputError(
                    f"experiment {self.name}: {name} is {part!r}, expected package.module:name",
                    "name the module and the function or class in it",
                )
