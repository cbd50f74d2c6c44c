"""The events and picture lines of every run, as frozen models that writer and readers share.

An experiment derives its own events from `Event`, those of its trials from `TrialStart` and `TrialStop`, and its roles
of pictures from `PictureRole`:

.. code-block:: python

    class GelStart(TrialStart):
        specimen: str
        repeats: int | None = None  # has a default: written only if it differs


    class Flip(Event):
        kind: ClassVar[str] = "flip"
        trial: int
        to_rad: float


    session.record(Flip(trial=0, to_rad=math.pi))  # writes the line
    run.read_events(Flip)  # reads those lines again

A line is `kind`, `t_s`, then the fields in the order of the model. A field without a default is always written, None as
null; so are infinite and undefined numbers, which a reader gets back as None. A reader ignores fields that its model
lacks, so that it can read lines of later versions. `Run.lines("events")` gives the lines of every kind as documents,
even of kinds without a model.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Generic, Self, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from labrig.errors import Fault, RecordError
from labrig.record.layout import EVENT_LINES, INCOMPLETE

INTERRUPTED = "interrupted"
"""`exit_status` of a trial that a later session found without a stop."""
UNENDED = (INCOMPLETE, INTERRUPTED)
"""`exit_status` of a trial in whose place another is made when its run goes on."""
_HINT = "no labrig wrote it so; take the file from a copy of the run"


class Line(BaseModel):
    """A line of a record with its rig time `t_s` [s]; NaN in an event that has not been recorded yet."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    t_s: float = math.nan

    @classmethod
    def read(cls, line: Mapping[str, object]) -> Self:
        """Return the model of a line. Raises pydantic's `ValidationError`."""
        return cls.model_validate({name: line[name] for name in cls.model_fields if name in line})


class Event(Line):
    """An event: its `kind`, and the fields that its model adds."""

    kind: ClassVar[str]
    """By default the name of the class: `BevelTurned` is `bevel_turned`."""

    @classmethod
    def __pydantic_init_subclass__(cls, **_settings: object) -> None:
        """Name the kind after the class, unless the class or one above it does."""
        if not hasattr(cls, "kind"):
            cls.kind = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    def line_fields(self) -> dict[str, object]:
        """Return the fields of the line behind `kind` and `t_s`."""
        return self.model_dump(exclude={"t_s"}, exclude_defaults=True)


class RunStart(Event):
    """The run starts; names its experiment."""

    experiment: str


class RunResume(RunStart):
    """The run resumes after an interruption."""

    kind: ClassVar[str] = "run_resume"


class RunStop(Event):
    """The run has ended: its status, the reason, and the fault of bus or drive that ended it.

    `error` is the class of the error that ended it, see `labrig.errors`; empty after a success.
    """

    exit_status: str
    reason: str
    error: str = ""
    fault: Fault | None = None


class TrialStart(Event):
    """A trial starts; a person reads its `noun`. `repeats` is the trial that it replaces, interrupted or made again."""

    noun: ClassVar[str] = "trial"

    trial: int
    repeats: int | None = None


class TrialStop(Event):
    """A trial has ended: `success`, `failed`, or `interrupted` if a resumed run found it without a stop.

    `stop` and `cause` say in a word and in words why it has failed.
    """

    trial: int
    exit_status: str
    stop: str | None = None
    cause: str = ""


class OperatorQuestion(Event):
    """A request to the operator, by class and fields, and the answer: yes or no, a note, a reading or a pixel.

    `choice` is what the operator did instead of answering; `answer` then is the text of a note or a reason.
    """

    kind: ClassVar[str] = "operator"

    request: str
    details: Mapping[str, object]
    confirmed: bool
    answer: str
    reading: float | None = None
    pixel: tuple[float, float] | None = None
    choice: str | None = None


class Move(Event):
    """A move of an axis: as asked for [mm or rad, per s], as sent, and the sent values in the units of the axis."""

    axis: str
    asked_position: float
    asked_speed: float
    sent_counts: int | None = None
    sent_speed_units: int | None = None
    position: float
    speed: float


class MoveDone(Event):
    """An axis has arrived at this position [mm or rad]."""

    axis: str
    position: float


class AxesReferenced(Event):
    """The axes stand at zero from now on, where they are."""


class AxesStopped(Event):
    """Every axis was stopped, and stands still."""


class WithdrawalStart(Event):
    """The needle is withdrawn along its path in this many moves."""

    moves: int


class WithdrawalStop(Event):
    """The needle is out."""


class Pause(Event):
    """A person has paused the run: at which safe point (a word), during which trial, and by what.

    The axes hold until the `Continue` that follows, or until the run ends.
    """

    point: str
    by: str
    trial: int | None = None


class Continue(Event):
    """The pause is over; a person has ended it by this."""

    by: str


class Skip(Event):
    """A person has left out a trial that had not started; `repeats` is the trial that it would have repeated."""

    trial: int
    repeats: int | None = None


class Repeat(Event):
    """A person has had a trial that had ended made again; the later trial takes its place."""

    trial: int


class MarkBad(Event):
    """A person has marked a trial as bad, and why: it is not evaluated."""

    trial: int
    reason: str


class OperatorNote(Event):
    """A person has written a note during a trial; None between two trials."""

    kind: ClassVar[str] = "note"

    text: str
    trial: int | None = None


class Undo(Event):
    """A person has taken back the decision that came last: the kind of that event."""

    undone: str


class ValueMeasured(Event):
    """A value that conditions of the protocol are on; None if it could not be measured, and why."""

    kind: ClassVar[str] = "value"

    trial: int
    name: str
    value: float | None
    reason: str = ""


class ConditionMet(Event):
    """A condition of the protocol is met by a value of a trial; `action` is what the run does: ask or stop."""

    kind: ClassVar[str] = "condition"

    trial: int
    action: str
    condition: str
    name: str
    value: float


class PictureRole(StrEnum):
    """What a picture was taken for; an experiment derives its own roles."""


class PlainRole(PictureRole):
    """A picture of an experiment that takes all of them for one purpose."""

    PICTURE = "picture"


class TruthLine(Line):
    """What a simulated world drew for a trial; an experiment derives the model of what it compares."""

    trial: int


class FrameLine(Line):
    """The line of a picture: number, file and its SHA-256, trial, role, and the positions of the axes at the exposure.

    `drawn` marks a picture that was drawn on; an imported picture has its `source`. Missing fields are None.
    """

    frame: int
    file: str
    sha256: str = ""
    trial: int | None = None
    role: str | None = None
    insertion_mm: float | None = None
    rotation_rad: float | None = None
    linear_mm: float | None = None
    drawn: bool = False
    source: str | None = None


_Line = TypeVar("_Line", bound=Line)
_Event = TypeVar("_Event", bound=Event)
_Start = TypeVar("_Start", bound=TrialStart)
_Stop = TypeVar("_Stop", bound=TrialStop)


@dataclass(frozen=True)
class RecordedTrial(Generic[_Start, _Stop]):
    """The start and stop of a recorded trial; `stop` is None if it has none.

    `left_out` is why a person had it left out of the evaluation; empty if it is to be evaluated.
    """

    start: _Start
    stop: _Stop | None
    left_out: str = ""

    @property
    def exit_status(self) -> str:
        """The status of its stop; `incomplete` without one."""
        return INCOMPLETE if self.stop is None else self.stop.exit_status


def parse_events(
    run: Path, lines: Sequence[Mapping[str, object]], models: Iterable[type[_Event]]
) -> Iterator[_Event]:
    """Yield the events of the models' kinds, in the order of the record; errors name `run`.

    Raises
    ------
    RecordError
        When a line of such a kind does not fit its model; names file, line and field.
    """
    by_kind = {model.kind: model for model in models}
    for number, line in enumerate(lines, start=1):
        if (model := by_kind.get(str(line.get("kind")))) is not None:
            yield _parse(model, line, f"{run / EVENT_LINES}:{number}: {model.kind}")


def parse_lines(
    path: Path, lines: Sequence[Mapping[str, object]], model: type[_Line], first: int = 0
) -> Iterator[_Line]:
    """Yield lines of one model, the first of which has a number from 0 in its file; raises as `parse_events`."""
    for number, line in enumerate(lines, start=first + 1):
        yield _parse(model, line, f"{path}:{number}")


def _parse(model: type[_Line], line: Mapping[str, object], where: str) -> _Line:
    try:
        return model.read(line)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        raise RecordError(f"{where}: {field!r}: {first['msg'].lower()}", _HINT) from error


DECISIONS = (Skip, Repeat, MarkBad, OperatorNote)
"""The events that an `Undo` can take back."""

RESCHEDULING = (Skip, Repeat)
"""Those after which other trials remain."""

READ = (*DECISIONS, Undo)
"""The events that `fold_decisions` reads."""


@dataclass(frozen=True)
class Decisions:
    """The decisions that hold, in the order in which they were made."""

    made: tuple[Event, ...] = ()

    @property
    def skipped(self) -> tuple[Skip, ...]:
        """Trials that were left out before they started."""
        return tuple(event for event in self.made if isinstance(event, Skip))

    @property
    def repeated(self) -> frozenset[int]:
        """Trials whose place a later trial takes."""
        return frozenset(event.trial for event in self.made if isinstance(event, Repeat))

    @property
    def bad(self) -> Mapping[int, str]:
        """Trials that were marked as bad, with the reason; the last mark counts."""
        return {event.trial: event.reason for event in self.made if isinstance(event, MarkBad)}

    @property
    def notes(self) -> tuple[OperatorNote, ...]:
        """Notes."""
        return tuple(event for event in self.made if isinstance(event, OperatorNote))

    def explain_left_out(self, trial: int) -> str:
        """Return why a trial is left out of the evaluation; empty if it is to be evaluated."""
        if trial in self.bad:
            return f"marked as bad: {self.bad[trial]}"
        return "repeated" if trial in self.repeated else ""

    def add(self, event: Event) -> "Decisions":
        """Return the decisions after one more event; one that decides nothing changes nothing."""
        if isinstance(event, Undo):
            undoes = bool(self.made) and self.made[-1].kind == event.undone
            return replace(self, made=self.made[:-1]) if undoes else self
        return replace(self, made=(*self.made, event)) if isinstance(event, DECISIONS) else self


NO_DECISIONS = Decisions()
"""A person has decided nothing."""


def fold_decisions(events: Iterable[Event]) -> Decisions:
    """Return the decisions that hold after these events, which stand in the order of the record."""
    decisions = NO_DECISIONS
    for event in events:
        decisions = decisions.add(event)
    return decisions


@dataclass(frozen=True)
class PastPause:
    """A pause of a recorded run; `duration_s` is None if the run ended during it."""

    start: Pause
    duration_s: float | None


def list_pauses(events: Iterable[Pause | Continue]) -> tuple[PastPause, ...]:
    """Return the pauses of a run, in the order of the record."""
    listed = tuple(events)
    return tuple(
        PastPause(event, following.t_s - event.t_s if isinstance(following, Continue) else None)
        for event, following in pairwise((*listed, None))
        if isinstance(event, Pause)
    )


def count_trials_done(run: Path, lines: Sequence[Mapping[str, object]]) -> int:
    """Return how many trials ended in success and are evaluated, from the lines of the events in their order.

    A trial that was made again, or marked as bad, counts for nothing. Raises `RecordError` as `parse_events`.
    """
    events = list(parse_events(run, lines, (TrialStop, *READ)))
    left_out = fold_decisions(events).explain_left_out
    stops = [event for event in events if isinstance(event, TrialStop) and event.exit_status == "success"]
    return sum(not left_out(stop.trial) for stop in stops)
