"""What every procedure works with: it asks the operator, moves axes, takes pictures and records events.

It also carries what a person may do in between (`dialogue`): a pause flows one way, from a request (Ctrl+C, a key at a
question, `labrig pause`) to the next safe point, to an event of the record, to the evaluation and the report.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

from labrig.devices.axis import AxisReadback
from labrig.devices.operator import Answer, Choice, OperatorRequest, Paused, request_details
from labrig.devices.rig import Rig
from labrig.errors import ConditionMetError, SafetyStopError
from labrig.record.decisions import RESCHEDULING
from labrig.record.events import (
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
from labrig.runner.axis_positions import AxisPositions, collect_axis_positions
from labrig.runner.dialogue import Attempt, Dialogue
from labrig.runner.pausing import AFTER_ANSWER, AT_QUESTION, BEFORE_QUESTION, TRIAL_END
from labrig.vision.picture import Picture


class Progress(Protocol):
    """Receives the progress of a procedure."""

    def __call__(self, done: float, doing: str) -> None:
        """Receive how much of the estimate is done (rig time [s]; pictures if nothing moves), and a sentence."""
        ...


_T = TypeVar("_T")

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
    """The opened rig, the record of this run, the receiver of progress, and what its person may do."""

    rig: Rig
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
        """Record values of a trial that conditions of the protocol are on, and each condition that they newly meet.

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
        dialogue = self.dialogue
        for name in sorted(dialogue.watch.names & values.keys()):
            value, before = values[name], dialogue.watch
            unknown = reason if value is None else ""
            self.record(ValueMeasured(trial=trial, name=name, value=value, reason=unknown))
            for met in dialogue.watch.list_newly_met(before) if value is not None else ():
                self.record(
                    ConditionMet(trial=trial, action=met.action, condition=met.text, name=name, value=value)
                )

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
        dialogue, started_s = self.dialogue, self.rig.clock.now_s()
        self.record(Pause(point=point, by=by, trial=dialogue.trial))
        if in_tissue:
            self.rig.stop()
        dialogue.requests.begin()
        place = _POINTS.get(point) or dialogue.describe_point(ended=point == TRIAL_END)
        request, reschedules = Paused(f"{place}, because {because}" if because else place), False
        while (answer := self._ask_once(request, paused=True)).choice is not None:
            reschedules = self._decide(answer, paused=True) or reschedules
        dialogue.note_pause(self.rig.clock.now_s() - started_s)
        if not answer.confirmed:
            raise SafetyStopError("the operator ended the run during a pause", "labrig resume continues it")
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
            raise SafetyStopError(
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
        """Ask once and record it; an answer counts for the time that answers take."""
        offer, started_s = self.dialogue.make_offer(paused=paused), self.rig.clock.now_s()
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
            self.dialogue.note_answer(request, self.rig.clock.now_s() - started_s)
        return answer

    def take_picture(self, role: PictureRole, trial: int | None = None) -> TakenPicture:
        """Take a picture, record it with the axis positions at its exposure, and return it.

        The exposure lies between two readings of the encoders. The positions are interpolated to the time of the camera
        or, without one, half-way. At 1 mm/s their error is a few hundredths of a millimetre.
        """
        before = collect_axis_positions(self.rig.read_states())
        frame, states = self.rig.take_picture()
        positions = before.interpolate_to(
            collect_axis_positions(states), 0.5 if frame.fraction is None else frame.fraction
        )
        self.recorder.can_frames(self.rig.take_can_frames())
        known = {**frame.time_fields(), **asdict(positions)}
        number = self.recorder.frame(frame.image, frame.t_s, trial=trial, role=role, **known)
        return TakenPicture(number, frame.image, positions)

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
        setpoint = self.rig.axis(axis_name).start_move(position, speed)
        self.record(Move(axis=axis_name, **setpoint.document()))

    def record_next_states(self) -> Mapping[str, AxisReadback]:
        """Wait for one period of the recorded states, record the states of all axes, and return them.

        Raises
        ------
        DriveError, BusError, InterruptedRunError
            All axes have been stopped.
        """
        self.rig.wait(self.rig.state_period_s)
        self._look_for_requests()
        states = self.rig.read_states()
        self._record_states(states)
        return states

    def _record_states(self, states: Mapping[str, AxisReadback]) -> None:
        self.recorder.can_frames(self.rig.take_can_frames())
        self.recorder.state(self.rig.clock.now_s(), **_state_fields(self.rig, states))


def _describe_met(met: ConditionMet) -> str:
    return f"{met.name} of trial {met.trial} is {met.value:.4g} ({met.action}: {met.condition})"


def _state_fields(rig: Rig, states: Mapping[str, AxisReadback]) -> dict[str, object]:
    """Return the fields of a state line: positions, statuswords, motor currents [mA], then the inputs by their names.

    A rig that replays a record of before reads neither currents nor inputs.
    """
    columns = {axis.name: f"{axis.name}_{axis.unit}" for axis in rig.axes}
    fields: dict[str, object] = {columns[name]: state.position for name, state in states.items()}
    fields |= {f"{name}_statusword": state.statusword for name, state in states.items()}
    if rig.reads_load:
        fields |= {f"{name}_current_ma": state.current_ma for name, state in states.items()}
    for axis in rig.axes:
        channels = axis.description.inputs
        inputs = states[axis.name].inputs
        fields |= {channels[name].column(name): value for name, value in inputs.items()}
    return fields
