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
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import ClassVar, Generic, Self, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from labrig.errors import Fault, RecordError
from labrig.record.layout import (
    EVENT_LINES,
    FRAME_LINES,
    MARK_BAD,
    NOTE,
    REPEAT,
    RUN_STOP,
    SKIP,
    TRIAL_START,
    TRIAL_STOP,
    TRUTH_LINES,
    UNDO,
)

INCOMPLETE = "incomplete"
"""`exit_status` of a trial without a stop."""
INTERRUPTED = "interrupted"
"""`exit_status` of a trial that a later session found without a stop."""
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

    kind: ClassVar[str] = "run_start"

    experiment: str


class RunResume(RunStart):
    """The run resumes after an interruption."""

    kind: ClassVar[str] = "run_resume"


class RunStop(Event):
    """The run has ended: its status, the reason, and the fault of bus or drive that ended it.

    `error` is the class of the error that ended it, see `labrig.errors`; empty after a success.
    """

    kind: ClassVar[str] = RUN_STOP

    exit_status: str
    reason: str
    error: str = ""
    fault: Fault | None = None


class TrialStart(Event):
    """A trial starts; a person reads its `noun`. `repeats` is the trial that it replaces, interrupted or made again."""

    kind: ClassVar[str] = TRIAL_START
    noun: ClassVar[str] = "trial"

    trial: int
    repeats: int | None = None


class TrialStop(Event):
    """A trial has ended: `success`, `failed`, or `interrupted` if a resumed run found it without a stop.

    `stop` and `cause` say in a word and in words why it has failed.
    """

    kind: ClassVar[str] = TRIAL_STOP

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
    """A move of an axis: as asked for [mm or rad, per s], as sent, and the sent values in the units of the axis.

    The sent values are in quadcounts and rpm if the drive has these, else in counts and speed units of the drive.
    """

    kind: ClassVar[str] = "move"

    axis: str
    asked_position: float
    asked_speed: float
    sent_quadcounts: int | None = None
    sent_rpm: int | None = None
    sent_counts: int | None = None
    sent_speed_units: int | None = None
    position: float
    speed: float


class MoveDone(Event):
    """An axis has arrived at this position [mm or rad]."""

    kind: ClassVar[str] = "move_done"

    axis: str
    position: float


class AxesReferenced(Event):
    """The axes stand at zero from now on, where they are."""

    kind: ClassVar[str] = "axes_referenced"


class AxesStopped(Event):
    """Every axis was stopped, and stands still."""

    kind: ClassVar[str] = "axes_stopped"


class WithdrawalStart(Event):
    """The needle is withdrawn along its path in this many moves."""

    kind: ClassVar[str] = "withdrawal_start"

    moves: int


class WithdrawalStop(Event):
    """The needle is out."""

    kind: ClassVar[str] = "withdrawal_stop"


class Pause(Event):
    """A person has paused the run: at which safe point (a word), during which trial, and by what.

    The axes hold until the `Continue` that follows, or until the run ends.
    """

    kind: ClassVar[str] = "pause"

    point: str
    by: str
    trial: int | None = None


class Continue(Event):
    """The pause is over; a person has ended it by this."""

    kind: ClassVar[str] = "continue"

    by: str


class Skip(Event):
    """A person has left out a trial that had not started; `repeats` is the trial that it would have repeated."""

    kind: ClassVar[str] = SKIP

    trial: int
    repeats: int | None = None


class Repeat(Event):
    """A person has had a trial that had ended made again; the later trial takes its place."""

    kind: ClassVar[str] = REPEAT

    trial: int


class MarkBad(Event):
    """A person has marked a trial as bad, and why: it is not evaluated."""

    kind: ClassVar[str] = MARK_BAD

    trial: int
    reason: str


class OperatorNote(Event):
    """A person has written a note during a trial; None between two trials."""

    kind: ClassVar[str] = NOTE

    text: str
    trial: int | None = None


class Undo(Event):
    """A person has taken back the decision that came last: the kind of that event."""

    kind: ClassVar[str] = UNDO

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
    """The line of a picture: number, file, trial, role, and the positions of the axes at the exposure.

    `drawn` marks a picture that was drawn on; an imported picture has its `source`. Missing fields are None.
    """

    frame: int
    file: str
    trial: int | None = None
    role: str | None = None
    insertion_mm: float | None = None
    rotation_rad: float | None = None
    linear_mm: float | None = None
    drawn: bool = False
    source: str | None = None


_Line = TypeVar("_Line", bound=Line)
_Event = TypeVar("_Event", bound=Event)
_Truth = TypeVar("_Truth", bound=TruthLine)
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
        kind = line.get("kind")
        if isinstance(kind, str) and kind in by_kind:
            yield _parse(by_kind[kind], line, f"{run / EVENT_LINES}:{number}: {kind}")


def parse_frame_lines(run: Path, lines: Sequence[Mapping[str, object]]) -> Iterator[FrameLine]:
    """Yield the line of each picture. Raises `RecordError` as `parse_events` does."""
    for number, line in enumerate(lines, start=1):
        yield _parse(FrameLine, line, f"{run / FRAME_LINES}:{number}")


def parse_truth_lines(
    run: Path, lines: Sequence[Mapping[str, object]], model: type[_Truth]
) -> Iterator[_Truth]:
    """Yield what a simulated world drew of each trial. Raises `RecordError` as `parse_events` does."""
    for number, line in enumerate(lines, start=1):
        yield _parse(model, line, f"{run / TRUTH_LINES}:{number}")


def join_trials(events: Iterable[_Start | _Stop]) -> tuple[RecordedTrial[_Start, _Stop], ...]:
    """Return the trials of a run; the last start of a repeated trial counts."""
    trials: dict[int, RecordedTrial[_Start, _Stop]] = {}
    for event in events:
        if isinstance(event, TrialStart):
            trials[event.trial] = RecordedTrial(event, None)
        elif event.trial in trials:
            trials[event.trial] = RecordedTrial(trials[event.trial].start, event)
    return tuple(trials.values())


def _parse(model: type[_Line], line: Mapping[str, object], where: str) -> _Line:
    try:
        return model.read(line)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        wrong = (
            f"it does not say its {field!r}"
            if first["type"] == "missing"
            else f"{field}: {first['msg'].lower()}"
        )
        raise RecordError(f"{where}: {wrong}", _HINT) from error
