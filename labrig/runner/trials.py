"""The trials of a run that remain: those planned, less those begun or skipped, plus those that are made again.

It is told anew after each trial, while a run is made and when it is resumed: a person may skip one, or have one made
again, and an interrupted one is made again under a number of its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeAlias, TypeVar

from labrig.devices.axis_positions import AxisPositions
from labrig.record.events import NO_DECISIONS, UNENDED, Decisions, RecordedTrial

T = TypeVar("T")

Again: TypeAlias = Callable[[T, Sequence[T]], T]
"""(what was lost, all that is planned or was made again) -> what takes its place; `InputError` without room for it."""


@dataclass(frozen=True)
class Trial(Generic[T]):
    """A trial that is to be made: its number, unique in a run, what is made, and the trial whose place it takes."""

    number: int
    what: T
    repeats: int | None = None


AnyTrial: TypeAlias = RecordedTrial[Any, Any]
"""A trial that has started."""


def is_lost(trial: AnyTrial, decisions: Decisions) -> bool:
    """Return whether another trial takes its place: it was interrupted, or a person has had it made again."""
    return trial.exit_status in UNENDED or trial.start.trial in decisions.repeated


@dataclass(frozen=True)
class Past:
    """What the record of an interrupted run holds.

    Attributes
    ----------
    begun : tuple of RecordedTrial
    decisions : Decisions
        Of its person.
    needle_path : tuple of AxisPositions
        The path of a needle that may still be in tissue; empty if it was out.
    """

    begun: tuple[AnyTrial, ...] = ()
    decisions: Decisions = NO_DECISIONS
    needle_path: tuple[AxisPositions, ...] = ()

    @property
    def kept(self) -> int:
        """How many trials are kept."""
        return sum(not is_lost(trial, self.decisions) for trial in self.begun)


NO_PAST = Past()
"""A run that begins."""


def make_same_again(lost: T, _used: Sequence[T]) -> T:
    """Return the same: a trial that is made again takes nothing up."""
    return lost


def put_repeats_first(trial: Trial[Any]) -> tuple[bool, int]:
    """Return the key by which trials that are made again come first."""
    return trial.repeats is None, trial.number


def list_remaining(
    planned: Sequence[T],
    begun: Sequence[AnyTrial],
    decisions: Decisions,
    again: Again[T] = make_same_again,
    order: Callable[[Trial[T]], Any] = put_repeats_first,
) -> list[Trial[T]]:
    """Return the trials that remain, in the order in which they are made.

    Parameters
    ----------
    planned : sequence
        What is made in each trial; the first is trial 0.
    begun : sequence of RecordedTrial
        In the order of the record.
    decisions : Decisions
        What a person has skipped, and had made again.
    again, order : callable
        Where a trial is made again, and the key by which trials are sorted.

    Raises
    ------
    InputError
        From `again`, where there is no room.
    """
    numbers = {trial.start.trial for trial in begun} | {skip.trial for skip in decisions.skipped}
    settled = {trial.start.repeats for trial in begun} | {skip.repeats for skip in decisions.skipped}
    made, used = dict(enumerate(planned)), list(planned)
    for trial in begun:
        number, repeats = trial.start.trial, trial.start.repeats
        if repeats is not None and number not in made:
            made[number] = again(made[repeats], used)
            used.append(made[number])
    left = [Trial(number, what) for number, what in enumerate(planned) if number not in numbers]
    number = max([len(planned) - 1, *numbers]) + 1
    for lost in begun:
        if is_lost(lost, decisions) and lost.start.trial not in settled:
            used.append(again(made[lost.start.trial], used))
            left.append(Trial(number, used[-1], lost.start.trial))
            number += 1
    return sorted(left, key=order)
