"""One session of a recorded run, as devices see it: from opening a rig to closing it."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from labrig.devices.camera import Exposure
from labrig.devices.needle_state import NEW, RigState, parse_current_limits, parse_roll_zero
from labrig.devices.operator import Answer, Choice
from labrig.errors import RecordError
from labrig.record.can_log import CanFrame
from labrig.record.events import OperatorQuestion, RunStop, TrialStart
from labrig.record.reader import Run


@dataclass(frozen=True)
class Question:
    """What the operator was asked, and the answer."""

    request: str
    details: Mapping[str, Any]
    answer: Answer
    t_s: float


@dataclass(frozen=True)
class Span:
    """Start and end (exclusive) of a session in the record [s]."""

    t0_s: float
    end_s: float

    def __contains__(self, t_s: float) -> bool:
        return self.t0_s <= t_s < self.end_s

    def of(self, lines: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        """Return the lines of this session."""
        return [line for line in lines if line["t_s"] in self]


@dataclass(frozen=True)
class Recording:
    """What devices did in one session of a run; all times are its own.

    Attributes
    ----------
    run : Path
        The folder of the run.
    started : datetime
        Calendar time.
    span : Span
        Its place in the record.
    can_frames, questions, truth : tuple
        What passed on the bus, what the operator was asked, and what was true of the simulated world.
    pictures : iterable of (int, Exposure)
        What the camera saw, each picture with its number; read on demand.
    first_frame : int
        Number of the first picture, taken or drawn.
    camera : Mapping
        The settings that the camera read back.
    state : RigState
        The state of the rig when it was opened.
    stopped_by : str or None
        The signal that ended it.
    exact : bool
        Whether its time was simulated, so that everything repeats to the last bit.
    to_the_end : bool
        Whether it ended in success.
    is_first : bool
        Whether it began the run; the others resumed it.
    trials : frozenset of int
        The trials that began in it.
    guards : int
        Level of what the rig guarded against; 0 in records of before there was any.
    """

    run: Path
    started: datetime
    span: Span
    can_frames: tuple[CanFrame, ...]
    questions: tuple[Question, ...]
    truth: tuple[dict[str, object], ...]
    pictures: Iterable[tuple[int, Exposure]]
    first_frame: int
    camera: Mapping[str, str | float]
    state: RigState
    stopped_by: str | None
    exact: bool
    to_the_end: bool
    is_first: bool
    trials: frozenset[int]
    guards: int


def read_recordings(run: Run, *, exact: bool) -> tuple[Recording, ...]:
    """Return the sessions of a run in order: the first, and one for each time that it was resumed.

    Raises
    ------
    RecordError
        When the record is damaged, or does not say what devices it had.
    """
    sessions = [run.manifest, *run.sessions]
    with _name_damage(run):
        starts_s = [0.0, *(float(session["t0_s"]) for session in run.sessions)]
    frames = tuple(run.can_frames)
    ends_s = [*starts_s[1:], math.inf]
    with _name_damage(run):
        return tuple(
            _read_session(run, session, Span(start_s, end_s), frames, exact=exact)
            for session, start_s, end_s in zip(sessions, starts_s, ends_s, strict=True)
        )


def make_recording_without_rig(run: Run) -> Recording:
    """Return the one session of a run that moved nothing."""
    return _make_recording(run, run.manifest, Span(0.0, math.inf), (), _NO_DEVICES, exact=True)


@contextmanager
def _name_damage(run: Run) -> Iterator[None]:
    """Turn the error of a value that is missing from manifest or events, or of another kind, into that of damage."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RecordError(
            f"{run.path} cannot be replayed: {type(error).__name__}: {error}",
            "compare it with a copy of the run",
        ) from error


_NO_DEVICES: dict[str, Any] = {"camera": {"readback": {}}}


def _read_session(
    run: Run, session: Mapping[str, Any], span: Span, frames: tuple[CanFrame, ...], *, exact: bool
) -> Recording:
    devices = session.get("devices")
    if not isinstance(devices, Mapping) or "camera" not in devices:
        raise RecordError(
            f"the manifest of {run.path} does not say what devices it had", "it cannot be replayed"
        )
    return _make_recording(run, session, span, frames, devices, exact=exact)


def _make_recording(
    run: Run,
    session: Mapping[str, Any],
    span: Span,
    frames: tuple[CanFrame, ...],
    devices: Mapping[str, Any],
    *,
    exact: bool,
) -> Recording:
    events = span.of(run.lines("events"))
    lines = span.of(run.lines("frames"))
    seen = [line for line in lines if not line.get("drawn")]
    trials = {event["trial"] for event in events if event["kind"] == TrialStart.kind}
    ending = events[-1] if events and events[-1]["kind"] == RunStop.kind else {}
    return Recording(
        run=run.path,
        started=datetime.fromisoformat(str(session["started"])),
        span=span,
        can_frames=tuple(frame._replace(t_s=frame.t_s - span.t0_s) for frame in frames if frame.t_s in span),
        questions=tuple(
            _read_question(event, span.t0_s) for event in events if event["kind"] == OperatorQuestion.kind
        ),
        truth=tuple(_read_truth(line) for line in run.lines("truth") if line.get("trial") in trials),
        pictures=((int(line["frame"]), _read_exposure(run, line, span.t0_s)) for line in seen),
        first_frame=int(lines[0]["frame"]) if lines else 0,
        camera=dict(devices["camera"]["readback"]),
        state=_read_state(devices.get("state")),
        stopped_by=_find_signal(str(ending.get("reason", ""))),
        exact=exact,
        to_the_end=ending.get("exit_status") == "success",
        is_first=session is run.manifest,
        trials=frozenset(trials),
        guards=int(devices.get("guards", 0)),
    )


def _read_exposure(run: Run, line: Mapping[str, Any], t0_s: float) -> Exposure:
    """Return a picture with the time that its camera gave; without one if the time was that of the call."""
    image, bound_s = run.read_frame(int(line["frame"])), line.get("t_bound_s")
    if bound_s is None:
        return Exposure(image)
    return Exposure(image, float(line["t_s"]) - t0_s, float(bound_s), line.get("fraction"))


def _read_question(event: Mapping[str, Any], t0_s: float) -> Question:
    pixel = event.get("pixel")
    answer = Answer(
        confirmed=bool(event["confirmed"]),
        note=str(event["answer"]),
        reading=event.get("reading"),
        pixel=None if pixel is None else (pixel[0], pixel[1]),
        choice=None if event.get("choice") is None else Choice(event["choice"]),
    )
    return Question(str(event["request"]), event["details"], answer, event["t_s"] - t0_s)


def _read_truth(line: Mapping[str, Any]) -> dict[str, object]:
    """Return what the world wrote; the procedure added the trial."""
    return {key: value for key, value in line.items() if key != "trial"}


def _read_state(recorded: object) -> RigState:
    if not isinstance(recorded, Mapping):
        return NEW
    return RigState(
        needle_in_tissue=recorded.get("needle_in_tissue"),
        since_run=recorded.get("since_run"),
        referenced=tuple(recorded.get("referenced", ())),
        note=str(recorded.get("note", "")),
        roll_zero=parse_roll_zero(recorded.get("roll_zero")),
        current_limits=parse_current_limits(recorded.get("current_limits")),
    )


def _find_signal(reason: str) -> str | None:
    found = re.match(r"interrupted by (\w+)", reason)
    return None if found is None else found.group(1)
