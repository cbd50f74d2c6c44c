"""One session of a record as a tape: what was asked and answered, one line after another."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

from labrig.errors import RecordError
from labrig.record.events import RunStop, TrialStart
from labrig.record.layout import COPY_HINT, INCOMPLETE
from labrig.record.reader import Run

_STREAMS = {"events": "event", "states": "state", "frames": "frame", "truth": "truth"}


@dataclass(frozen=True)
class TapeLine:
    """A line of a record: `what` is `state`, `frame`, `drawing`, or the kind of an event."""

    what: str
    fields: Mapping[str, Any]


class TapeEndsError(Exception):
    """The record holds nothing more: it was cut short, or a device ended the run here."""


class TapeDiffersError(Exception):
    """The procedure asks something else than the record has next: from here on the two cannot be compared."""

    def __init__(self, recorded: str, now: str) -> None:
        super().__init__(f"the record has {recorded}, the replay {now}")
        self.recorded, self.now = recorded, now


@dataclass(frozen=True)
class SessionPart:
    """The place of a session in a record: its first and its last time (exclusive) [s], and its devices.

    `started` is its calendar time in ISO text; the first session began the run, and the others resumed it.
    """

    t0_s: float
    end_s: float
    started: str
    devices: Mapping[str, Any]


def list_sessions(run: Run) -> tuple[SessionPart, ...]:
    """Return the sessions of a run, in order. Raises `RecordError` when the manifest does not say enough."""
    sessions = (run.manifest, *run.sessions)
    try:
        starts_s = [0.0, *(float(session["t0_s"]) for session in run.sessions)]
        ends_s = [*starts_s[1:], math.inf]
        return tuple(
            SessionPart(start_s, end_s, str(session["started"]), dict(session.get("devices") or {}))
            for session, start_s, end_s in zip(sessions, starts_s, ends_s, strict=True)
        )
    except (KeyError, TypeError, ValueError) as error:
        raise RecordError(
            f"the manifest of {run.path} does not say when its sessions began", COPY_HINT
        ) from error


class Tape:
    """The lines of one session, in the order in which they were recorded.

    Parameters
    ----------
    run : Run
        The record.
    part : SessionPart
        The session.

    Attributes
    ----------
    t_s : float
        Time of the line that was taken last [s of the session].
    frame, trial : int or None
        The last picture, and the trial.
    is_over : bool
        Whether nothing is compared any more.

    Raises
    ------
    RecordError
        When a line does not say its place in the order of all lines.
    """

    def __init__(self, run: Run, part: SessionPart) -> None:
        self.t_s = 0.0
        self.frame: int | None = None
        self.trial: int | None = None
        self.is_over = False
        self._t0_s = part.t0_s
        self._lines = tuple(_order_lines(run, part))
        self._next = 0

    @property
    def total_t_s(self) -> float:
        """Time of the line that was taken last, in the run [s]."""
        return self._t0_s + self.t_s

    def peek(self) -> TapeLine | None:
        """Return the next line; None at the end."""
        return self._lines[self._next] if self._next < len(self._lines) else None

    def expect(self, what: str, now: str) -> Mapping[str, Any]:
        """Return the fields of the next line, which has to be of this kind; it stays the next one.

        Raises
        ------
        TapeEndsError
            When nothing more is recorded, or a device ended the run here.
        TapeDiffersError
            When something else is recorded.
        """
        line = self.peek()
        ended = line is not None and line.what == RunStop.kind != what and _was_ended_by_rig(line.fields)
        if line is None or ended:
            self.is_over = True
            raise TapeEndsError
        if line.what != what:
            self.differ(now)
        return line.fields

    def differ(self, now: str) -> NoReturn:
        """Raise that the record has another line next."""
        line, self.is_over = self.peek(), True
        raise TapeDiffersError("nothing more" if line is None else describe_line(line), now)

    def take(self) -> None:
        """Go on behind the next line."""
        line = self._lines[self._next]
        self._next += 1
        self.t_s = max(self.t_s, float(line.fields["t_s"]) - self._t0_s)
        if line.what in {"frame", "drawing"}:
            self.frame = int(line.fields["frame"])
        if line.what == TrialStart.kind:
            self.trial = int(line.fields["trial"])


def describe_line(line: TapeLine) -> str:
    """Return a line in words."""
    named = {
        key: line.fields[key]
        for key in ("axis", "asked_position", "request", "role", "trial")
        if key in line.fields
    }
    details = ", ".join(f"{key} {value}" for key, value in named.items() if value is not None)
    return f"{line.what} ({details})" if details else line.what


def _order_lines(run: Run, part: SessionPart) -> Iterator[TapeLine]:
    """Yield the lines of a session by their place, up to the first that is missing."""
    try:
        lines = sorted(
            (int(fields["seq"]), stream, fields) for stream in _STREAMS for fields in run.lines(stream)
        )
    except (KeyError, TypeError, ValueError) as error:
        raise RecordError(
            f"{run.path} has lines without their place in the order of all lines (seq)",
            "it cannot be replayed; labrig reanalyze measures its pictures",
        ) from error
    inside, place = False, None
    for seq, stream, fields in lines:
        if stream != "truth":
            inside = part.t0_s <= float(fields["t_s"]) < part.end_s
        if not inside:
            continue
        if place is not None and seq != place + 1:
            if run.manifest.get("exit_status") != INCOMPLETE:
                raise RecordError(f"{run.path} lacks line {place + 1} of its session", COPY_HINT)
            return  # a power cut has taken lines of one file and not of another
        place = seq
        if stream != "truth":
            yield TapeLine(_name(stream, fields), fields)
        if fields.get("kind") == RunStop.kind:
            return  # what follows is where the axes came to rest, which no procedure asked for


def _name(stream: str, fields: Mapping[str, Any]) -> str:
    if stream == "events":
        return str(fields["kind"])
    return "drawing" if fields.get("drawn") else _STREAMS[stream]


_OF_THE_RIG = frozenset(
    {"SafetyStopError", "InterruptedRunError", "LimitError", "CameraError", "DiskError", "LockedError"}
)


def _was_ended_by_rig(stop: Mapping[str, Any]) -> bool:
    """Return whether the rig, a signal or the disk ended the run: a procedure that goes on would not know it."""
    return stop.get("fault") is not None or stop.get("error") in _OF_THE_RIG
