"""Replays a record: the same procedure asks again, gets the recorded answers, and has to ask the same.

What is compared is what the procedure asks and says: moves, pictures, questions, stops, and every event. Times and
readings are answers, and are not compared.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labrig.devices.check import check_calibration
from labrig.devices.check_result import CheckStatus
from labrig.devices.clocks import SimulatedClock
from labrig.devices.replayed.rig import ReplayedRig, load_recorded_rig
from labrig.devices.replayed.tape import SessionPart, Tape, TapeDiffersError, TapeEndsError, list_sessions
from labrig.devices.rig_file import RigDescription
from labrig.errors import InputError, RecordError
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.agreement import Agreement, Deviation, Verdict
from labrig.record.events import Event, Move, OperatorQuestion, Pause
from labrig.record.json_lines import as_recorded
from labrig.record.layout import COPY_HINT
from labrig.record.reader import Run
from labrig.runner.conduct import Outcome, conduct, conduct_without_rig
from labrig.runner.dialogue import Dialogue, PauseRequests
from labrig.runner.experiment import Experiment
from labrig.runner.past import read_past
from labrig.runner.session import Progress, Session
from labrig.runner.trials import Past

_TARGET_INCREMENTS = 10
"""By so many increments of the encoder may the target of a move differ: what servos at rest dither."""

_ANSWERS = frozenset({"t_s", "seq"})
_OF_A_FRAME = ("trial", "role")


@dataclass(frozen=True)
class Place:
    """Where in a record something is: rig time [s], the last picture, the trial."""

    t_s: float
    frame: int | None
    trial: int | None


@dataclass
class Replay:
    """The result of a replay.

    Attributes
    ----------
    agreement : Agreement
        What differs.
    place : Place or None
        Where the first decision, or number beyond its tolerance, is.
    stopped : bool
        Whether the replay had to end there: what was asked then has no recorded answer.
    ended_early : str
        Where an incomplete record ends; empty for a complete one.
    counts : dict
        The numbers of what was compared.
    """

    agreement: Agreement = field(default_factory=Agreement)
    place: Place | None = None
    stopped: bool = False
    ended_early: str = ""
    counts: dict[str, int] = field(default_factory=dict)

    @property
    def verdict(self) -> Verdict:
        """The verdict."""
        return self.agreement.verdict

    @property
    def first_difference(self) -> Deviation | None:
        """The first decision, or number beyond its tolerance."""
        return self.agreement.first


def replay_run(run: Run, experiment: Experiment, protocol: ExperimentProtocol, progress: Progress) -> Replay:
    """Run the procedure of a record with its recorded answers, session by session.

    Raises
    ------
    InputError
        For a run that was not made by a procedure.
    RecordError
        When the record is damaged.
    """
    if not experiment.moves_rig and experiment.part("find_problems")(protocol):
        raise InputError(
            f"{run.path} holds imported pictures; no procedure made it", "there is nothing to replay"
        )
    if run.withdraws is not None:
        raise InputError(
            f"{run.path} is the withdrawal of the needle of run {run.withdraws}; it goes as a person answers",
            "there is nothing to replay; its states, events and can.log show what was done",
        )
    found = Replay()
    description = load_recorded_rig(run) if experiment.moves_rig else None
    if description is not None:
        _require_calibration(description)

    def conduct_again(part: SessionPart, tape: Tape, journal: ReplayedRecord, past: Past | None) -> Outcome:
        if description is None:
            return conduct_without_rig(experiment, journal, SimulatedClock())
        rig, requests = ReplayedRig(run, description, part, tape), RecordedRequests(tape)
        return conduct(experiment, protocol, Session(rig, journal, progress, Dialogue(requests)), past)

    for number, part in enumerate(list_sessions(run)):
        tape = Tape(run, part)
        journal = ReplayedRecord(run, tape, description, found)
        past = read_past(run.until(part.t0_s)) if number else None
        _compare_session(journal, tape, part, partial(conduct_again, part, tape, journal, past))
        if found.stopped:
            break
    return found


def _require_calibration(rig: RigDescription) -> None:
    """Refuse a calibration that is not of the pictures; a rig without one calibrates, or measures in pixels."""
    named = {name.removesuffix(".json") for name in rig.calibration_paths()}
    for result in check_calibration(rig):
        if result.status is CheckStatus.FAIL and result.check.removeprefix("calibration ") in named:
            raise InputError(f"the record's {result.check}: {result.value}", COPY_HINT)


def replay_work(run: Run, experiment: Experiment) -> float:
    """Return the end of the progress of a replay: the moves, pictures and questions of the record."""
    if not experiment.moves_rig:
        return 1.0
    drawn = sum(bool(line.drawn) for line in run.frame_lines)
    return float(len(run.read_events(Move, OperatorQuestion)) + len(run.frame_lines) - drawn)


def _compare_session(
    journal: "ReplayedRecord", tape: Tape, part: SessionPart, conduct_again: Callable[[], Outcome]
) -> None:
    """Conduct one session again, and add what differs."""
    try:
        outcome = conduct_again()
        if isinstance(outcome.error, RecordError):
            raise outcome.error
        if tape.peek() is not None:
            tape.differ("nothing more")
    except TapeDiffersError as error:
        journal.note(Deviation("what is asked", error.recorded, error.now))
        journal.found.stopped = True
    except TapeEndsError:
        if tape.peek() is None:
            begin_s, end_s = part.t0_s, tape.total_t_s
            journal.found.ended_early = (
                f"the session that began at t = {begin_s:.3f} s was interrupted at t = {end_s:.3f} s"
            )


class ReplayedRecord:
    """Compares what a procedure records with the record, line by line; see `RecordSink`.

    Parameters
    ----------
    run : Run
        The record.
    tape : Tape
        The lines of a session.
    rig : RigDescription or None
        The rig file.
    found : Replay
        Gets what differs.
    """

    def __init__(self, run: Run, tape: Tape, rig: RigDescription | None, found: Replay) -> None:
        self.run_name = run.path.name
        self.path: Path = run.path
        self._tape = tape
        self._axes = {} if rig is None else dict(rig.axes.items())
        self.found = found

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:  # noqa: ARG002 - answers
        """Compare what a picture or a drawing is for, and return its number."""
        what = "drawing" if fields.get("drawn") else "frame"
        line = self._tape.expect(what, f"{what} {fields.get('role')}")
        now = as_recorded(fields)
        self._compare(
            what, {key: line.get(key) for key in _OF_A_FRAME}, {key: now.get(key) for key in _OF_A_FRAME}
        )
        self._take("pictures")
        return int(line["frame"])

    def state(self, t_s: float, **fields: object) -> None:  # noqa: ARG002 - readings are answers
        """Go on behind the reading that the procedure was given."""
        self._tape.expect("state", "a reading of the axes")
        self._take("readings")

    def event(self, kind: str, t_s: float, **fields: object) -> None:  # noqa: ARG002
        """Compare an event."""
        if self._tape.is_over:  # the procedure ends because nothing more can be compared
            return
        line = self._tape.expect(kind, kind)
        recorded = {key: value for key, value in line.items() if key not in _ANSWERS}
        now = as_recorded({"kind": kind, **fields})
        if kind == Move.kind:
            self._compare_target(recorded, now)
        self._compare(kind, recorded, now)
        self._take("moves" if kind == Move.kind else "questions" if kind == "operator" else "events")

    def record_event(self, event: Event, t_s: float) -> None:
        """Compare an event."""
        self.event(event.kind, t_s, **event.line_fields())

    def truth(self, **fields: object) -> None:
        """Do nothing: what is true of a world is no answer."""

    def can_frames(self, frames: Iterable[tuple[float, int, bytes, str]]) -> None:
        """Do nothing: nothing is sent."""

    def close(self, exit_status: str, reason: str, ended: datetime, **updates: object) -> None:
        """Do nothing: the last event states how the run ended."""

    def note(self, deviation: Deviation) -> None:
        """Take note of a value that is not the recorded one, and where the first one beyond its tolerance is."""
        self.found.agreement.add(deviation)
        self._note_place()

    def _note_place(self) -> None:
        if self.found.place is None and self.found.agreement.first is not None:
            tape = self._tape
            self.found.place = Place(tape.total_t_s, tape.frame, tape.trial)

    def _compare(self, name: str, recorded: Mapping[str, object], now: Mapping[str, object]) -> None:
        self.found.agreement.compare(name, recorded, now)
        self._note_place()

    def _compare_target(self, recorded: dict[str, object], now: dict[str, object]) -> None:
        """Compare the target of a move in increments of its encoder."""
        before, after = recorded.pop("asked_position"), now.pop("asked_position")
        if before == after:
            return
        axis = self._axes[str(recorded["axis"])]
        size = abs(float(str(after)) - float(str(before)))
        tolerance = _TARGET_INCREMENTS / axis.scale().counts_per_unit
        self.note(Deviation(f"move.{recorded['axis']}_{axis.unit}", before, after, size, tolerance))

    def _take(self, what: str) -> None:
        self._tape.take()
        self.found.counts[what] = self.found.counts.get(what, 0) + 1


class RecordedRequests(PauseRequests):
    """Asks for a pause at the safe points where the record has one.

    Parameters
    ----------
    tape : Tape
        Knows the next event of the record.
    """

    def __init__(self, tape: Tape) -> None:
        self._tape = tape

    def find(self, point: str) -> str | None:
        """Return by what the record was paused, if its next line is a pause at this point."""
        line = self._tape.peek()
        if line is None or line.what != Pause.kind or line.fields.get("point") != point:
            return None
        return str(line.fields.get("by"))
