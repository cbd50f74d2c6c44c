"""What every procedure works with: it asks the operator, moves axes, takes pictures and records events.

A procedure calls the session and nothing behind it. The rig below is one of the makers of `RigCalls`: an opened one,
real or simulated, or a record that is replayed.

It also carries what a person may do in between (`dialogue`): a pause flows one way, from a request (Ctrl+C, a key at a
question, `labrig pause`) to the next safe point, to an event of the record, to the evaluation and the report.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

from labrig.devices.axis import AxisReadback
from labrig.devices.axis_description import AxisDescription
from labrig.devices.axis_positions import AxisPositions, collect_axis_positions
from labrig.devices.needle_state import RigState, RollZero
from labrig.devices.operator import Answer, Choice, OperatorRequest, Paused, request_details
from labrig.devices.past_insertion import PastInsertion
from labrig.devices.rig_calls import RigCalls
from labrig.devices.rig_file import RigDescription
from labrig.devices.state_line import write_state_line
from labrig.errors import ConditionMetError, OperatorDeclinedError
from labrig.record.decisions import RESCHEDULING, Decisions
from labrig.record.events import (
    AxesReferenced,
    AxesStopped,
    ConditionMet,
    Continue,
    Event,
    MarkBad,
    Move,
    MoveDone,
    OperatorNote,
    OperatorQuestion,
    Pause,
    PictureRole,
    Repeat,
    Skip,
    TrialStop,
    Undo,
    ValueMeasured,
)
from labrig.record.layout import picture_file
from labrig.record.sink import RecordSink
from labrig.runner.dialogue import Attempt, Dialogue
from labrig.runner.pausing import AFTER_ANSWER, AT_QUESTION, BEFORE_QUESTION, TRIAL_END
from labrig.vision.picture import Picture


class Progress(Protocol):
    """Receives the progress of a procedure."""

    def __call__(self, done: float, doing: str) -> None:
        """Receive how much of the estimate is done (rig time [s]; pictures if nothing moves), and a sentence."""
        ...


_T = TypeVar("_T")

_AT_START_MM = 0.05
"""How far needle and sheath may stand from zero to be where an insertion begins."""

WhileMoving = Callable[[Mapping[str, AxisReadback]], None]


@dataclass(frozen=True, eq=False)
class TakenPicture:
    """A recorded picture: its number, the picture, and the axis positions at its exposure."""

    frame: int
    image: Picture
    positions: AxisPositions


class _OtherTrialError(Exception):
    """A person has chosen that another trial is made than the one that was about to start."""


class _ContinuedError(Exception):
    """A pause is ended from elsewhere, by what its message says."""


_POINTS = {
    BEFORE_QUESTION: "before the next question",
    AFTER_ANSWER: "after the answer",
    AT_QUESTION: "at the question",
}
"""How a person reads where a pause has begun."""


@dataclass(frozen=True)
class Session:
    """The rig, the record of this run, the receiver of progress, and what its person may do.

    `rig`, `recorder` and `dialogue` are for the runner; a procedure needs none of them.
    """

    rig: RigCalls
    recorder: RecordSink
    progress: Progress
    dialogue: Dialogue = field(default_factory=Dialogue)

    def record(self, event: Event) -> None:
        """Append an event, stamped with the rig time. The end of a trial is a safe point."""
        self.recorder.can_frames(self.rig.take_can_frames())
        self.recorder.record_event(event, self.rig.clock.now_s())
        ends_trial = isinstance(event, TrialStop) and event.trial == self.dialogue.trial
        self.dialogue.note_event(event)
        if ends_trial:
            self.reach_safe_point(TRIAL_END)

    def judge(self, trial: int, values: Mapping[str, float | None], reason: str = "") -> None:
        """Record values of a trial that conditions of the protocol are on, and each condition that they meet.

        At the next safe point the run then pauses, or stops.

        Parameters
        ----------
        trial : int
            The trial.
        values : mapping of str to float or None
            The values by name; None for one that could not be measured. Others than those of conditions are left out.
        reason : str
            Why one could not be measured.
        """
        conditions = self.dialogue.conditions
        for name in sorted({condition.name for condition in conditions} & values.keys()):
            value = values[name]
            self.record(
                ValueMeasured(trial=trial, name=name, value=value, reason=reason if value is None else "")
            )
            for met in conditions:
                if met.name == name and value is not None and met.holds(value):
                    self.record(
                        ConditionMet(
                            trial=trial, action=met.action, condition=met.text, name=name, value=value
                        )
                    )

    # What a procedure may know

    @property
    def description(self) -> RigDescription:
        """The rig file."""
        return self.rig.description

    @property
    def run_name(self) -> str:
        """The name of the run."""
        return self.recorder.run_name

    @property
    def state(self) -> RigState:
        """What is known of the needle across runs."""
        return self.rig.needle.state

    @property
    def referenced(self) -> frozenset[str]:
        """The axes that have their reference."""
        return self.rig.referenced

    @property
    def is_referenced(self) -> bool:
        """Whether every axis has its reference."""
        return self.referenced == dict(self.description.axes.items()).keys()

    @property
    def decisions(self) -> Decisions:
        """What a person has decided so far."""
        return self.dialogue.decisions

    @property
    def is_judged(self) -> bool:
        """Whether conditions of the protocol are on values that `judge` takes."""
        return bool(self.dialogue.conditions)

    def axis(self, name: str) -> AxisDescription:
        """Return an axis of the rig file: insertion, rotation or linear."""
        return dict(self.description.axes.items())[name]

    def stands_at_start(self) -> bool:
        """Return whether every axis has kept its reference, and needle and sheath stand where an insertion begins."""
        if not self.is_referenced:
            return False
        states = self.read_states()
        return all(abs(states[name].position) <= _AT_START_MM for name in ("insertion", "linear"))

    # What a procedure says

    def tell_place(self, place: str) -> None:
        """Say where the run is, such as `hole 3 of 18, gel 2 of 4`, for the questions that follow."""
        self.dialogue.place = place

    def tell_next_point(self, point: str) -> None:
        """Say when a pause that is asked for now begins; empty for the end of the trial in progress."""
        self.dialogue.next_point = point

    def mark_needle_in_tissue(self) -> None:
        """Remember, across a crash, that this run is putting a needle into tissue. Raises `DiskError`."""
        self.rig.needle.mark_in_tissue(self.run_name)

    def mark_needle_out(self) -> None:
        """Remember that no needle is in tissue. Raises `DiskError`."""
        self.rig.needle.mark_out()

    def recall_roll_zero(self, needle_id: str) -> RollZero | None:
        """Return the certified roll zero of this needle as it is clamped, or None."""
        return self.rig.needle.recall_roll_zero(needle_id)

    def certify_roll_zero(self, roll_zero: RollZero) -> None:
        """Remember the roll zero of a needle. Raises `SafetyStopError` if the rotation axis has no reference."""
        self.rig.needle.certify_roll_zero(roll_zero)

    def record_truth(self, trial: int) -> None:
        """Record what is true of the present insertion in a simulated world; nothing on a bench."""
        for line in self.rig.truth():
            self.recorder.truth(trial=trial, **line)

    def recall(self, insertions: Sequence[PastInsertion]) -> None:
        """Repeat in a simulated world what earlier sessions of this run did, once the needle is mounted."""
        self.rig.recall(insertions)

    # Pauses, and what a person chooses

    def attempt(
        self,
        trial: int,
        make: Callable[[], _T],
        *,
        repeats: int | None = None,
        can_repeat: Callable[[int], bool] | None = None,
    ) -> _T | None:
        """Make a trial that a person may still skip, or put off to have the one before it made again.

        Afterwards `dialogue.decisions` says what has been decided; the caller makes what remains.

        Parameters
        ----------
        trial : int
            Its number.
        make : callable
            Makes it, from the questions before it to its stop.
        repeats : int or None
            The trial whose place it takes.
        can_repeat : callable
            Whether there is room to make a trial of this number again; by default always.

        Returns
        -------
        What `make` returns; None if a person chose otherwise before the trial started.
        """
        attempt = Attempt(trial, repeats) if can_repeat is None else Attempt(trial, repeats, can_repeat)
        self.dialogue.begin_attempt(attempt)
        try:
            return make()
        except _OtherTrialError:
            return None
        finally:
            self.dialogue.end_attempt()

    def reach_safe_point(self, point: str, *, in_tissue: bool = False) -> bool:
        """Pause here if that is asked for, by a person or a condition, until a person continues; return whether it was.

        Parameters
        ----------
        point : str
            A word for the record. Between two safe points of the same word something has to be recorded, so that a
            replay pauses at the same one.
        in_tissue : bool
            Whether axes may be moving: they are stopped, and hold. The caller starts its move again.

        Raises
        ------
        SafetyStopError
            When the person ends the run instead.
        ConditionMetError
            When a condition of the protocol ends it.
        InterruptedRunError, BusError, DriveError
            The axes have been stopped.
        """
        met = self.dialogue.take_met()
        because = ", ".join(_describe_met(condition) for condition in met)
        if any(condition.action == "stop_when" for condition in met):
            raise ConditionMetError(
                f"the protocol ends the run: {because}",
                "look at the needle and the gel; labrig resume continues the run; trials are numbered from 0",
            )
        by = "ask_when" if met else self.dialogue.requests.find(point)
        if by is None:
            return False
        self._pause(point, by, in_tissue=in_tissue, because=because)
        return True

    def _pause(self, point: str, by: str, *, in_tissue: bool = False, because: str = "") -> None:
        """Hold until a person continues, who may decide things meanwhile. Raises as `reach_safe_point` does."""
        dialogue = self.dialogue
        self.record(Pause(point=point, by=by, trial=dialogue.trial))
        if in_tissue:
            self.stop()
        dialogue.requests.begin()
        place = _POINTS.get(point) or dialogue.describe_point(ended=point == TRIAL_END)
        request, reschedules = Paused(f"{place}, because {because}" if because else place), False
        while (answer := self._ask_once(request, paused=True)).choice is not None:
            reschedules = self._decide(answer, paused=True) or reschedules
        if not answer.confirmed:
            raise OperatorDeclinedError(
                "the operator ended the run during a pause", "labrig resume continues it"
            )
        self.record(Continue(by=answer.note))
        dialogue.requests.end()
        if reschedules and dialogue.can_leave:
            raise _OtherTrialError

    def _decide(self, answer: Answer, *, paused: bool) -> bool:
        """Record what was chosen instead of an answer; return whether other trials remain now."""
        dialogue, attempt = self.dialogue, self.dialogue.attempt
        if answer.choice not in dialogue.list_choices(paused=paused):
            return False
        match answer.choice:
            case Choice.PAUSE:
                self._pause(AT_QUESTION, "prompt")
            case Choice.NOTE:
                self.record(OperatorNote(text=answer.note, trial=dialogue.trial))
            case Choice.UNDO:
                return self._undo()
            case Choice.MARK_BAD if dialogue.marked_trial is not None:
                self.record(MarkBad(trial=dialogue.marked_trial, reason=answer.note))
            case Choice.REPEAT if dialogue.finished is not None:
                self.record(Repeat(trial=dialogue.finished))
                return True
            case Choice.SKIP if attempt is not None:
                self.record(Skip(trial=attempt.trial, repeats=attempt.repeats))
                return True
        return False

    def _undo(self) -> bool:
        """Take back what came last: a decision, or the answer to a question, which is asked once more."""
        last = self.dialogue.last_undoable
        if isinstance(last, OperatorRequest):
            self.record(Undo(undone=OperatorQuestion.kind))
            self._ask_operator(last)
            return False
        assert last is not None
        self.record(Undo(undone=last.kind))
        return isinstance(last, RESCHEDULING)

    def _look_for_requests(self) -> None:
        """Tell who has asked for a pause when it will begin."""
        self.dialogue.requests.announce(self.dialogue.describe_next_point())

    def _look_while_asking(self) -> None:
        """Tell who has asked for a pause during a question."""
        self.dialogue.requests.announce("once the question at its terminal is answered")

    def _look_for_continuation(self) -> None:
        """End a pause that is to end."""
        by = self.dialogue.requests.find_continuation()
        if by is not None:
            raise _ContinuedError(by)

    # Questions

    def ask(self, request: OperatorRequest) -> Answer:
        """Ask the operator to do and confirm something, and return the answer; the axes hold still meanwhile.

        Raises
        ------
        SafetyStopError
            When the operator does not confirm.
        """
        answer = self._ask_operator(request)
        if not answer.confirmed:
            raise OperatorDeclinedError(
                f"the operator said no to: {request.text}", "start the run again when it can be confirmed"
            )
        return answer

    def offer(self, request: OperatorRequest) -> bool:
        """Ask the operator for something optional, and return whether it was confirmed."""
        return self._ask_operator(request).confirmed

    def _ask_operator(self, request: OperatorRequest) -> Answer:
        """Ask, and do what is chosen instead, until there is an answer. Before and after it is a safe point."""
        self.reach_safe_point(BEFORE_QUESTION)
        while (answer := self._ask_once(request)).choice is not None:
            if self._decide(answer, paused=False) and self.dialogue.can_leave:
                raise _OtherTrialError
        if answer.confirmed:
            self.reach_safe_point(AFTER_ANSWER)
        return answer

    def _ask_once(self, request: OperatorRequest, *, paused: bool = False) -> Answer:
        """Ask once and record it."""
        offer = self.dialogue.make_offer(paused=paused)
        try:
            answer = self.rig.ask(
                request,
                offer,
                also=self._look_for_continuation if paused else self._look_while_asking,
                of_person=paused,
            )
        except _ContinuedError as by:
            answer = Answer(confirmed=True, note=str(by))
        self.record(
            OperatorQuestion(
                request=type(request).__name__,
                details=request_details(request, self.recorder.path),
                confirmed=answer.confirmed,
                answer=answer.note,
                reading=answer.reading,
                pixel=answer.pixel,
                choice=answer.choice,
            )
        )
        if not paused and answer.choice is None:
            self.dialogue.note_answer(request)
        return answer

    def take_picture(self, role: PictureRole, trial: int | None = None) -> TakenPicture:
        """Take a picture, record it with the axis positions at its exposure, and return it."""
        taken = self.rig.take_picture()
        self.recorder.can_frames(self.rig.take_can_frames())
        times = {"t_bound_s": taken.t_bound_s, "fraction": taken.fraction}
        known = {name: value for name, value in times.items() if value is not None} | asdict(taken.positions)
        number = self.recorder.frame(taken.image, taken.t_s, trial=trial, role=role, **known)
        return TakenPicture(number, taken.image, taken.positions)

    def compute(self, call: Callable[[], _T]) -> _T:
        """Return what takes long to compute, or to read from a file; the axes are supervised meanwhile.

        Raises
        ------
        InterruptedRunError, SafetyStopError, BusError, DriveError
            The axes have been stopped.
        """
        return self.rig.do_aside(call)

    def draw(self, image: Picture, role: PictureRole, trial: int | None = None) -> Path:
        """Record a picture with a drawing on it, and return its file."""
        number = self.recorder.frame(image, self.rig.clock.now_s(), trial=trial, role=role, drawn=True)
        return self.picture_path(number)

    def picture_path(self, frame: int) -> Path:
        """Return the file of a recorded picture."""
        return self.recorder.path / picture_file(frame)

    def move(
        self, axis_name: str, position: float, speed: float, while_moving: WhileMoving | None = None
    ) -> None:
        """Move one axis to `position` [mm or rad] at `speed` [per s] and wait until it has arrived.

        The states of all axes are recorded at the rig file's rate until the axis is in its position window.
        `while_moving` receives each of them.

        Raises
        ------
        LimitError
            Before anything is sent, when the position or speed is beyond the axis' limits.
        DriveError, InterruptedRunError
            From the rig while waiting; the caller's rig stops the axes.
        """
        self.start(axis_name, position, speed)
        arrived = False
        while not arrived:
            states = self.record_next_states()
            if while_moving is not None:
                while_moving(states)
            arrived = states[axis_name].target_reached
        self.record(MoveDone(axis=axis_name, position=states[axis_name].position))

    def start(self, axis_name: str, position: float, speed: float) -> None:
        """Start a move and return at once; an axis in motion continues to the new position without a stop.

        Raises
        ------
        LimitError, SafetyStopError, DriveError, BusError
        """
        setpoint = self.rig.start_move(axis_name, position, speed)
        self.record(Move(axis=axis_name, **setpoint.document()))

    def record_next_states(self) -> Mapping[str, AxisReadback]:
        """Wait for one period of the recorded states, record the states of all axes, and return them.

        Raises
        ------
        DriveError, BusError, InterruptedRunError
            All axes have been stopped.
        """
        self.rig.wait(1 / self.description.recording.state_rate_hz)
        self._look_for_requests()
        return self.read_states()

    def read_states(self) -> Mapping[str, AxisReadback]:
        """Read every axis now, record it, and return it. Raises as `record_next_states`."""
        states = self.rig.read_states()
        self.recorder.can_frames(self.rig.take_can_frames())
        self.recorder.state(self.rig.clock.now_s(), **write_state_line(self.description, states))
        return states

    def read_positions(self) -> AxisPositions:
        """Read the positions of the axes now, as `read_states` does."""
        return collect_axis_positions(self.read_states())

    def wait(self, duration_s: float) -> None:
        """Let rig time pass; the axes are supervised. Raises as `record_next_states`."""
        self.rig.wait(duration_s)

    def stop(self) -> None:
        """Stop every axis, and record that they stand still. Raises `SafetyStopError`."""
        self.rig.stop()
        self.record(AxesStopped())

    def reference_axes(self) -> None:
        """Set the present positions of all axes to zero, and record that.

        Raises
        ------
        SafetyStopError
            When a needle is or may be in tissue: its depth and roll would be lost.
        DriveError, BusError
        """
        self.rig.reference_axes()
        self.record(AxesReferenced())


def _describe_met(met: ConditionMet) -> str:
    return f"{met.name} of trial {met.trial} is {met.value:.4g} ({met.action}: {met.condition})"
