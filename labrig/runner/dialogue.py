"""What a session knows of its person: the trial in progress, decisions so far, and what may be chosen now."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from labrig.devices.operator import Choice, Offer, OperatorRequest
from labrig.errors import AnswerIsNoError, Problem, TargetMissedError, TrialsFailedError
from labrig.protocol.conditions import Condition
from labrig.record.events import (
    DECISIONS,
    ConditionMet,
    Decisions,
    Event,
    Move,
    RecordedTrial,
    TrialStart,
    TrialStop,
    Undo,
)
from labrig.runner.trials import NO_PAST, AnyTrial, Past, Trial
from labrig.text import format_count

BEFORE_QUESTION, AFTER_ANSWER, TRIAL_END = "before_question", "after_answer", "trial_end"
"""The safe points that every run has, as the record names them."""


class PauseRequests:
    """Requests to pause a run, and to continue it; here nobody can ask.

    A request comes from outside (Ctrl+C at the terminal, `labrig pause` in another one) and waits for the next safe
    point. These are, without any code of the experiment: before each question, after its answer, and the end of each
    trial. An experiment names further ones with `Session.reach_safe_point`.
    """

    def find(self, point: str) -> str | None:  # noqa: ARG002
        """Return by what a pause at this safe point is asked for, such as `Ctrl+C`; None if by nothing."""
        return None

    def announce(self, when: str) -> None:
        """Tell those who have asked for a pause since the last call when it will begin."""

    def begin(self) -> None:
        """Note that the axes hold: the requests so far are met."""

    def find_continuation(self) -> str | None:
        """Return by what the pause is to end, such as `labrig continue`; None if by nothing so far."""
        return None

    def end(self) -> None:
        """Note that the run continues."""


@dataclass
class Dialogue:
    """Kept by a session from the events that it records.

    Attributes
    ----------
    requests : PauseRequests
        Requests to pause.
    decisions : Decisions
        Those that hold; a resumed run begins with those of its record.
    conditions : tuple of Condition
        Those of the protocol, on values that are measured.
    trial : int or None
        The trial in progress.
    finished : int or None
        The last trial that has ended in this session.
    attempt : Trial or None
        The trial that is about to be made, or is being made.
    has_started : bool
        Whether that trial has started.
    starts_itself : bool
        Whether its procedure records its start.
    can_repeat : callable
        Tells whether there is room to make a trial of this number again.
    place : str
        Where the run is, such as `hole 3 of 18, gel 2 of 4`; empty if nobody has said it.
    specimen : bool or None
        Whether a specimen lies before the sheath; None if nobody has said it.
    calls : int
        The moves, pictures and questions so far: how far the run is.
    warnings : list of Problem
        What the procedure has said to whoever checks the protocol.
    past : Past
        What the record of an interrupted run holds.
    begun : list of RecordedTrial
        The trials so far, those of earlier sessions too.
    planned : int
        How many trials the run has.
    failed : dict of int to AnswerIsNoError
        Why trials have failed, by their numbers.
    next_point : str
        When a pause that is asked for now begins, as a person is told; empty for the end of the trial in progress.
    """

    requests: PauseRequests = field(default_factory=PauseRequests)
    decisions: Decisions = field(default_factory=Decisions)
    conditions: tuple[Condition, ...] = ()
    trial: int | None = None
    finished: int | None = None
    attempt: Trial[Any] | None = None
    starts_itself: bool = False
    can_repeat: Callable[[int], bool] = lambda _trial: False
    place: str = ""
    next_point: str = ""
    specimen: bool | None = None
    calls: int = 0
    warnings: list[Problem] = field(default_factory=list)
    past: Past = NO_PAST
    begun: list[AnyTrial] = field(default_factory=list)
    planned: int = 0
    failed: dict[int, AnswerIsNoError] = field(default_factory=dict)
    has_started: bool = False
    _noun: str = "trial"
    _undoable: list[Event] = field(default_factory=list)
    _met: list[ConditionMet] = field(default_factory=list)

    # What happens

    def recall(self, past: Past) -> None:
        """Go on from the record of an interrupted run."""
        self.past, self.decisions, self.begun = past, past.decisions, list(past.begun)
        for trial in past.begun:
            if trial.stop is not None and trial.exit_status == "failed":
                reason = trial.stop.stop or "trial_failed"
                self.failed[trial.start.trial] = TargetMissedError(trial.stop.cause, reason=reason)

    def note_event(self, event: Event) -> None:
        """Take note of a recorded event."""
        self.decisions = self.decisions.add(event)
        match event:
            case TrialStart():
                self.trial, self._noun, self.has_started = event.trial, event.noun, True
                self.begun.append(RecordedTrial(event, None))
                self._undoable.clear()
            case TrialStop():
                self.finished = event.trial if event.trial == self.trial else self.finished
                self.begun = [
                    replace(made, stop=event) if made.start.trial == event.trial else made
                    for made in self.begun
                ]
                self.trial, self.next_point = None, ""
                self._undoable.clear()
            case Move():
                self._undoable.clear()
            case Undo():
                self._undoable.pop()
            case ConditionMet():
                self._met.append(event)
            case _ if isinstance(event, DECISIONS):
                self._undoable.append(event)

    def note_answer(self, request: OperatorRequest, *, confirmed: bool) -> None:
        """Take note of an answer."""
        self.calls += 1
        if confirmed and request.brings_gel is not None:
            self.specimen = request.brings_gel
        self._undoable.clear()

    def take_met(self) -> tuple[ConditionMet, ...]:
        """Return the conditions that were met since the last safe point; there is none afterwards."""
        met = tuple(self._met)
        self._met.clear()
        return met

    def begin_attempt(self, attempt: Trial[Any]) -> None:
        """Take note that a trial is about to be made."""
        self.attempt, self.has_started = attempt, False

    def find_failure(self) -> TrialsFailedError | None:
        """Return why the run has failed, by its trials that are to be evaluated; None if none of them has failed."""
        left_out = self.decisions.explain_left_out
        counted = [error for trial, error in self.failed.items() if not left_out(trial)]
        if not counted:
            return None
        reasons = [getattr(error, "reason", "refused") for error in counted]
        worst = min(range(len(counted)), key=lambda place: reasons[place] == "reached_in_plane_only")
        return TrialsFailedError(
            f"{len(counted)} of {format_count(self.planned, self._noun)} failed; {reasons[worst].replace('_', ' ')}: "
            f"{counted[worst].message}",
            counted[worst].hint or ("the report shows which, and why" if self.planned > 1 else ""),
            reason=reasons[worst],
        )

    # What may be done now

    @property
    def can_leave(self) -> bool:
        """Whether the trial that is about to be made has not started, so that it can be left out."""
        return self.attempt is not None and not self.has_started

    @property
    def marked_trial(self) -> int | None:
        """The trial that a mark is for: the one in progress, else the last one."""
        return self.finished if self.trial is None else self.trial

    @property
    def last_undoable(self) -> Event | None:
        """The decision that came last, if it can be taken back: nothing was answered and nothing has moved since."""
        return self._undoable[-1] if self._undoable else None

    def list_choices(self) -> Iterator[Choice]:
        """Yield what may be chosen instead of an answer."""
        if self._can_repeat():
            yield Choice.REPEAT
        if self.can_leave and self.trial is None:
            yield Choice.SKIP
        if self.marked_trial is not None and self.marked_trial not in self.decisions.bad:
            yield Choice.MARK_BAD
        yield Choice.NOTE
        if self._undoable:
            yield Choice.UNDO

    def _can_repeat(self) -> bool:
        trial = self.finished
        if self.attempt is None or trial is None or self.trial is not None:
            return False
        return trial not in self.decisions.repeated and self.can_repeat(trial)

    def make_offer(self) -> Offer:
        """Return what may be chosen, with the line that says where the run is."""
        return Offer(tuple(self.list_choices()), self.place)

    def describe_next_point(self) -> str:
        """Return when a pause that is asked for now will begin."""
        if self.trial is None:
            return "at the next question"
        return self.next_point or f"after this {self._noun}"

    def describe_point(self, *, ended: bool) -> str:
        """Return where a pause is that has begun at the end of a trial, or within it."""
        return f"{'after' if ended else 'during'} this {self._noun}"
