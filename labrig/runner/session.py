"""What every procedure works with: it asks the operator, moves axes, takes pictures and records events.

A procedure calls the session and nothing behind it. The rig below is one of the makers of `RigCalls`: an opened one,
real or simulated, or a record that is replayed.

It also carries what a person may do in between (`dialogue`): a pause flows one way, from a request (Ctrl+C, a key at a
question, `labrig pause`) to the next safe point, to an event of the record, to the evaluation and the report.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from labrig.devices.axis_description import AxisDescription
from labrig.devices.axis_positions import AxisPositions, collect_axis_positions
from labrig.devices.drives.drive import DriveReading
from labrig.devices.needle_state import RigState, RollZero
from labrig.devices.operator import Answer, Choice, OperatorRequest, Paused, request_details
from labrig.devices.rig_calls import RigCalls
from labrig.devices.rig_file import RigDescription
from labrig.devices.state_line import write_state_line
from labrig.errors import AnswerIsNoError, ConditionMetError, InputError, OperatorDeclinedError, Problem
from labrig.record.events import (
    RESCHEDULING,
    AxesReferenced,
    AxesStopped,
    ConditionMet,
    Continue,
    Decisions,
    Event,
    MarkBad,
    Move,
    MoveDone,
    OperatorNote,
    OperatorQuestion,
    Pause,
    PictureRole,
    PlainRole,
    Repeat,
    Skip,
    TrialStart,
    TrialStop,
    Undo,
    ValueMeasured,
)
from labrig.record.layout import picture_file
from labrig.record.sink import RecordSink
from labrig.runner.dialogue import AFTER_ANSWER, BEFORE_QUESTION, TRIAL_END, Dialogue
from labrig.runner.sight import Sight, TakenPicture
from labrig.runner.trials import Again, Past, Trial, list_remaining, make_same_again, put_repeats_first
from labrig.vision.picture import Picture


class Progress(Protocol):
    """Receives the progress of a procedure."""

    def __call__(self, done: float, doing: str) -> None:
        """Receive how many of the planned moves, pictures and questions are done, and a sentence."""
        ...


_T = TypeVar("_T")

_AT_START_MM = 0.05
"""How far needle and sheath may stand from zero to be where an insertion begins."""

_INTO_TISSUE = ("insertion", "linear")
"""The axes that bring needle and sheath into a specimen."""


class _OtherTrialError(Exception):
    """A person has chosen that another trial is made than the one that was about to start."""


class TrialRun(Generic[_T]):
    """A trial that is being made in a `with` block: its `number`, `what` is made, and the trial that it `repeats`."""

    def __init__(self, session: "Session", trial: Trial[_T]) -> None:
        self.number, self.what, self.repeats = trial.number, trial.what, trial.repeats
        self._session, self._trial = session, trial

    def __enter__(self) -> Self:
        self._session.dialogue.begin_attempt(self._trial)
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None
    ) -> bool:
        session, dialogue = self._session, self._session.dialogue
        if error is None:
            self._stop("success")
        is_own = isinstance(error, AnswerIsNoError) and not isinstance(error, ConditionMetError)
        fails = is_own and session.state.needle_in_tissue is False
        if isinstance(error, AnswerIsNoError) and fails:
            self._stop("failed", getattr(error, "reason", "refused"), error.message)
            dialogue.failed[self.number] = error
            session.tell(f"trial {self.number + 1} has failed: {error.message}")
        dialogue.attempt = None
        return fails or isinstance(error, _OtherTrialError)

    def _stop(self, exit_status: str, stop: str | None = None, cause: str = "") -> None:
        """End the trial, unless the block has done so."""
        session = self._session
        if not session.dialogue.has_started:
            session.record(TrialStart(trial=self.number, repeats=self.repeats))
        if session.dialogue.trial == self.number:
            session.record(TrialStop(trial=self.number, exit_status=exit_status, stop=stop, cause=cause))


class _ContinuedError(Exception):
    """A pause is ended from elsewhere, by what its message says."""


_POINTS = {BEFORE_QUESTION: "before the next question", AFTER_ANSWER: "after the answer"}
"""How a person reads where a pause has begun."""

_AFTER_THE_ANSWER = "once the question at its terminal is answered"
"""When a pause begins that is asked for during a question."""


@dataclass(frozen=True)
class Session:
    """The rig, the record of this run, the receiver of progress, and what its person may do.

    `rig`, `recorder`, `progress`, `dialogue` and `make_sight` are for the runner; a procedure needs none of them.
    """

    rig: RigCalls
    recorder: RecordSink
    progress: Progress
    dialogue: Dialogue = field(default_factory=Dialogue)
    make_sight: Callable[..., Sight] = Sight

    def record(self, event: Event) -> None:
        """Append an event, stamped with the rig time. The end of a trial is a safe point."""
        self._write(partial(self.recorder.record_event, event, self.rig.clock.now_s()))
        ends_trial = isinstance(event, TrialStop) and event.trial == self.dialogue.trial
        self.dialogue.note_event(event)
        if ends_trial:
            self.reach_safe_point(TRIAL_END)

    def _write(self, write: Callable[[], _T]) -> _T:
        """Write into the record, the CAN frames so far first; the axes are supervised while the disk is waited for."""
        frames = self.rig.take_can_frames()

        def write_all() -> _T:
            self.recorder.can_frames(frames)
            return write()

        return self.rig.do_aside(write_all)

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
        for name in sorted({condition.value for condition in conditions} & values.keys()):
            value = values[name]
            self.record(
                ValueMeasured(trial=trial, name=name, value=value, reason=reason if value is None else "")
            )
            for met in conditions:
                if met.value == name and value is not None and met.holds(value):
                    self.record(
                        ConditionMet(trial=trial, action=met.do, condition=str(met), name=name, value=value)
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
        return frozenset(self.rig.needle.state.referenced)

    @property
    def is_referenced(self) -> bool:
        """Whether every axis has its reference."""
        return self.referenced == dict(self.description.axes.items()).keys()

    @property
    def is_judged(self) -> bool:
        """Whether conditions of the protocol are on values that `judge` takes."""
        return bool(self.dialogue.conditions)

    def axis(self, name: str) -> AxisDescription:
        """Return an axis of the rig file: insertion, rotation or linear."""
        return self.description.axes.named(name)

    def stands_at_start(self) -> bool:
        """Return whether every axis has kept its reference, and needle and sheath stand where an insertion begins."""
        return self.is_referenced and _stands_at_start(self.read_states())

    # What a procedure says

    def tell(self, doing: str) -> None:
        """Say what is being done, for whoever watches the progress."""
        self.progress(self.dialogue.calls, doing)

    def warn(self, problem: Problem) -> None:
        """Say why the answer of the run may be no; `labrig check` prints it, and the run goes on."""
        self.dialogue.warnings.append(problem)

    def open_sight(self, *, finds_tip: bool = False) -> Sight:
        """Return what reads pictures by the rig's calibration, the needle's tip too if that is asked for.

        Raises `InputError` where a file of it is missing.
        """
        return self.compute(partial(self.make_sight, self.description, finds_tip=finds_tip))

    def tell_place(self, place: str) -> None:
        """Say where the run is, such as `hole 3 of 18, gel 2 of 4`, for the questions that follow."""
        self.dialogue.place = place

    def tell_next_point(self, point: str) -> None:
        """Say when a pause that is asked for now begins; empty for the end of the trial in progress."""
        self.dialogue.next_point = point

    def recall_roll_zero(self, needle_id: str) -> RollZero | None:
        """Return the certified roll zero of this needle as it is clamped, or None."""
        return self.rig.needle.recall_roll_zero(needle_id)

    def certify_roll_zero(self, roll_zero: RollZero) -> None:
        """Remember the roll zero of a needle. Raises `SafetyStopError` if the rotation axis has no reference."""
        self.rig.needle.certify_roll_zero(roll_zero)

    def record_truth(self, trial: int) -> None:
        """Record what is true of the present insertion in a simulated world; nothing on a bench."""
        for line in self.rig.truth():
            self._write(partial(self.recorder.truth, trial=trial, **line))

    @property
    def past(self) -> Past:
        """What the record of an interrupted run holds; nothing of a run that begins."""
        return self.dialogue.past

    # Pauses, and what a person chooses

    def trials(
        self,
        planned: Sequence[_T],
        *,
        again: Again[_T] = make_same_again,
        order: Callable[[Trial[_T]], Any] = put_repeats_first,
        starts_itself: bool = False,
    ) -> Iterator["TrialRun[_T]"]:
        """Yield the trials that remain, each to be made in a `with` block.

        A person may skip the next one at a question before it starts, or have an earlier one made again; what an
        interrupted session has made is left out. A block that raises `AnswerIsNoError` while no needle is in tissue
        ends its trial as failed, the others are made, and the run ends as failed.

        Parameters
        ----------
        planned : sequence
            What is made in each trial, such as its hole; the first is trial 0.
        again, order : callable
            See `list_remaining`.
        starts_itself : bool
            Whether the block records start and stop itself; otherwise a `TrialStart` is recorded before the first
            move or picture, and a `TrialStop` at the end.
        """
        dialogue = self.dialogue
        dialogue.planned = len(planned)

        def remaining(decisions: Decisions) -> list[Trial[_T]]:
            return list_remaining(planned, dialogue.begun, decisions, again, order)

        def can_repeat(trial: int) -> bool:
            try:
                return bool(remaining(dialogue.decisions.add(Repeat(trial=trial))))
            except InputError:
                return False

        dialogue.can_repeat, dialogue.starts_itself = can_repeat, starts_itself
        while left := remaining(dialogue.decisions):
            yield TrialRun(self, left[0])

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
        if any(condition.action == "stop" for condition in met):
            hint = "look at the needle and the gel; labrig resume continues the run"
            raise ConditionMetError(f"the protocol ends the run: {because}", hint)
        by = "condition" if met else self.dialogue.requests.find(point)
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
            self.read_states()  # states.jsonl then says where the axes wait
        dialogue.requests.begin()
        place = _POINTS.get(point) or dialogue.describe_point(ended=point == TRIAL_END)
        request, reschedules = Paused(f"{place}, because {because}" if because else place), False
        while (answer := self._ask_once(request, paused=True)).choice is not None:
            reschedules = self._decide(answer) or reschedules
        if not answer.confirmed:
            raise OperatorDeclinedError(
                "the operator ended the run during a pause", "labrig resume continues it"
            )
        self.record(Continue(by=answer.note))
        dialogue.requests.end()
        if reschedules and dialogue.can_leave:
            raise _OtherTrialError

    def _decide(self, answer: Answer) -> bool:
        """Record what was chosen instead of an answer; return whether other trials remain now."""
        dialogue, attempt = self.dialogue, self.dialogue.attempt
        if answer.choice not in dialogue.make_offer().choices:
            return False
        match answer.choice:
            case Choice.NOTE:
                self.record(OperatorNote(text=answer.note, trial=dialogue.trial))
            case Choice.UNDO if dialogue.last_undoable is not None:
                undone = dialogue.last_undoable
                self.record(Undo(undone=undone.kind))
                return isinstance(undone, RESCHEDULING)
            case Choice.MARK_BAD if dialogue.marked_trial is not None:
                self.record(MarkBad(trial=dialogue.marked_trial, reason=answer.note))
            case Choice.REPEAT if dialogue.finished is not None:
                self.record(Repeat(trial=dialogue.finished))
                return True
            case Choice.SKIP if attempt is not None:
                self.record(Skip(trial=attempt.number, repeats=attempt.repeats))
                return True
        return False

    def _look_for_continuation(self) -> None:
        """End a pause that is to end."""
        if (by := self.dialogue.requests.find_continuation()) is not None:
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
            if self._decide(answer) and self.dialogue.can_leave:
                raise _OtherTrialError
        if answer.confirmed:
            self.reach_safe_point(AFTER_ANSWER)
        return answer

    def _ask_once(self, request: OperatorRequest, *, paused: bool = False) -> Answer:
        """Ask once and record it."""
        offer = self.dialogue.make_offer()
        try:
            announce = partial(self.dialogue.requests.announce, _AFTER_THE_ANSWER)
            answer = self.rig.ask(request, offer, self._look_for_continuation if paused else announce)
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
            self.dialogue.note_answer(request, confirmed=answer.confirmed)
        return answer

    def take_picture(self, role: PictureRole = PlainRole.PICTURE, trial: int | None = None) -> TakenPicture:
        """Take a picture, record it with the axis positions at its exposure, and return it."""
        self._begin_trial()
        trial = self.dialogue.trial if trial is None else trial
        taken = self.rig.take_picture()
        self.dialogue.calls += 1
        times = {"t_bound_s": taken.t_bound_s, "fraction": taken.fraction}
        known = {name: value for name, value in times.items() if value is not None} | vars(taken.positions)
        number = self._write(
            partial(self.recorder.frame, taken.image, taken.t_s, trial=trial, role=role, **known)
        )
        return TakenPicture(number, taken)

    def compute(self, call: Callable[[], _T]) -> _T:
        """Return what takes long to compute, or to read from a file; the axes are supervised meanwhile.

        Raises
        ------
        InterruptedRunError, SafetyStopError, BusError, DriveError
            The axes have been stopped.
        """
        return self.rig.do_aside(call)

    def draw(
        self,
        taken: TakenPicture,
        paint: Callable[[Picture], Picture],
        role: PictureRole,
        trial: int | None = None,
    ) -> Path:
        """Record a picture with a drawing on it, and return its file."""
        image = self.compute(partial(taken.photograph.paint, paint))
        now_s = self.rig.clock.now_s()
        number = self._write(partial(self.recorder.frame, image, now_s, trial=trial, role=role, drawn=True))
        return self.picture_path(number)

    def picture_path(self, frame: int) -> Path:
        """Return the file of a recorded picture."""
        return self.recorder.path / picture_file(frame)

    def move(
        self,
        axis_name: str,
        position: float,
        speed: float,
        *,
        passing: Sequence[float] = (),
        then: Callable[[], object] = lambda: None,
    ) -> None:
        """Move one axis to `position` [mm or rad] at `speed` [per s] and wait until it has arrived.

        The states of all axes are recorded at the rig file's rate until the axis is in its position window.

        Parameters
        ----------
        passing : sequence of float
            Positions on the way, in order, upwards.
        then : callable
            Called at the first reading beyond each of them; the axis does not stop.

        Raises
        ------
        LimitError
            Before anything is sent, when the position or speed is beyond the axis' limits.
        DriveError, InterruptedRunError
            From the rig while waiting; the caller's rig stops the axes.
        """
        self.start(axis_name, position, speed)
        states: Mapping[str, DriveReading] = {}
        for place in passing:
            if not _is_past(states.get(axis_name), place):
                states = self.wait_until(axis_name, place)
            then()
        if not _is_past(states.get(axis_name)):
            states = self.wait_until(axis_name)
        self.record(MoveDone(axis=axis_name, position=states[axis_name].position))
        if axis_name in _INTO_TISSUE:
            self._note_way_out(states)

    def _begin_trial(self) -> None:
        """Record the start of a trial whose block leaves that to the session."""
        dialogue, attempt = self.dialogue, self.dialogue.attempt
        if attempt is not None and not dialogue.starts_itself and not dialogue.has_started:
            self.record(TrialStart(trial=attempt.number, repeats=attempt.repeats))

    def wait_until(self, axis_name: str, passing: float | None = None) -> Mapping[str, DriveReading]:
        """Record the states of all axes until one has arrived, or is beyond a position on its way up; return the last.

        Raises
        ------
        DriveError, BusError, InterruptedRunError
            All axes have been stopped.
        """
        while True:
            self.rig.await_reading(axis_name, passing)
            self.dialogue.requests.announce(self.dialogue.describe_next_point())
            states = self.read_states()
            if _is_past(states[axis_name], passing):
                return states

    def _note_way_out(self, states: Mapping[str, DriveReading]) -> None:
        """Remember that no needle is in tissue once needle and sheath of this run are back, by kept references."""
        is_own = self.state.needle_in_tissue is True and self.state.since_run == self.run_name
        if is_own and self.is_referenced and _stands_at_start(states):
            self.rig.needle.mark_out()

    def start(self, axis_name: str, position: float, speed: float) -> None:
        """Start a move and return at once; an axis in motion continues to the new position without a stop.

        Raises
        ------
        LimitError, SafetyStopError, DriveError, BusError
        """
        self._begin_trial()
        self.rig.check_move(axis_name, position, speed)
        goes_in = (
            axis_name in _INTO_TISSUE and position > _AT_START_MM and self.dialogue.specimen is not False
        )
        if goes_in and not (self.state.needle_in_tissue and self.state.since_run == self.run_name):
            self.rig.needle.mark_in_tissue(self.run_name)
        self.dialogue.calls += 1
        self.record(Move(axis=axis_name, **vars(self.rig.start_move(axis_name, position, speed))))

    def read_states(self) -> Mapping[str, DriveReading]:
        """Read every axis now, record it, and return it. Raises as `wait_until`."""
        states = self.rig.read_states()
        line = write_state_line(self.description, states)
        self._write(partial(self.recorder.state, self.rig.clock.now_s(), **line))
        return states

    def read_positions(self) -> AxisPositions:
        """Read the positions of the axes now, as `read_states` does."""
        return collect_axis_positions(self.read_states())

    def wait(self, duration_s: float) -> None:
        """Let rig time pass; the axes are supervised. Raises as `wait_until`."""
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
    return f"{met.name} of trial {met.trial + 1} is {met.value:.4g} ({met.action} when {met.condition})"


def _is_past(state: DriveReading | None, passing: float | None = None) -> bool:
    """Return whether an axis has arrived, or is beyond a position."""
    return state is not None and (state.target_reached or (passing is not None and state.position >= passing))


def _stands_at_start(states: Mapping[str, DriveReading]) -> bool:
    return all(abs(states[name].position) <= _AT_START_MM for name in _INTO_TISSUE)
