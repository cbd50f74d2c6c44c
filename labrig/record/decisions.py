"""What a person decided during a run: trials that were skipped, repeated or marked as bad, notes, and pauses.

The same fold of the events tells it while the run is made, when it is resumed, and when it is evaluated.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

from pydantic import ValidationError

from labrig.record.events import (
    Continue,
    Event,
    MarkBad,
    OperatorNote,
    Pause,
    Repeat,
    Skip,
    TrialStop,
    Undo,
)

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


def count_trials_done(lines: Sequence[Mapping[str, object]]) -> int:
    """Return how many trials ended in success and are evaluated, from the lines of the events in their order.

    A trial that was made again, or marked as bad, counts for nothing.
    """
    kinds = {model.kind: model for model in READ}
    read = []
    for line in lines:
        if line.get("kind") in kinds:
            with suppress(ValidationError):  # of a damaged line; whoever reads its events names it
                read.append(kinds[str(line["kind"])].read(line))
    decisions = fold_decisions(read)
    done = [
        line.get("trial")
        for line in lines
        if line.get("kind") == TrialStop.kind and line.get("exit_status") == "success"
    ]
    return sum(isinstance(trial, int) and not decisions.explain_left_out(trial) for trial in done)
