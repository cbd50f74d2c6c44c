"""How far a value may be wrong before fewer than half arrive: what is tried next, how often, and what it says.

A search steps outwards from the stated value, each step twice the one before, until fewer than half arrive; then it
bisects. A value is repeated until Wilson's interval of the share leaves out one half, and at most N times. At the
answer it is repeated N times. Whatever is tried next follows from what has been found alone.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from labrig.campaign.statistics import bound_share

FIRST_LOOK = 5
"""Repetitions: of five that all arrive, or none, the interval leaves out one half."""

_LOOK_AGAIN = 2
_CLOSE = 0.15
"""The answer is known to this share of its distance from the stated value."""
_SMALLEST_STEP = 1.0 / 32.0
"""Share of the first step below which no value is told from the stated one."""
_AT_SDS = (1.0, 2.0)
_MOST_ARRIVE = 0.95


@dataclass(frozen=True)
class Tally:
    """How many of `n` repetitions arrived, and how those ended that did not."""

    n: int = 0
    arrived: int = 0
    ends: Mapping[str, int] = field(default_factory=dict)

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the share; all of it where nothing was tried."""
        return bound_share(self.arrived, self.n) or (0.0, 1.0)

    def add(self, end: str | None) -> "Tally":
        """Return this with one more repetition; `end` is None for one that arrived."""
        if end is None:
            return Tally(self.n + 1, self.arrived + 1, self.ends)
        return Tally(self.n + 1, self.arrived, {**self.ends, end: self.ends.get(end, 0) + 1})


@dataclass(frozen=True)
class Ask:
    """What is tried next: a distance from the stated value, and how often in all."""

    distance: float
    repetitions: int


@dataclass(frozen=True)
class Way:
    """The distances that a search may try.

    Attributes
    ----------
    first_step : float
        The first distance; one standard deviation, where there is one.
    limit : float
        The largest.
    sd : float or None
        Where the arrival is asked for besides.
    whole : bool
        Whether only whole distances make sense.
    """

    first_step: float
    limit: float
    sd: float | None = None
    whole: bool = False

    def list_rungs(self) -> Iterator[float]:
        """Yield the distances of the way outwards."""
        step = self.first_step
        while step < self.limit:
            yield step
            step *= 2.0
        yield self.limit

    def halve(self, low: float, high: float) -> float | None:
        """Return the distance between two that is tried; None where they are close enough."""
        if self.whole:
            middle = float(round(0.5 * (low + high)))
            return middle if low < middle < high else None
        if high - low <= max(_CLOSE * high, _SMALLEST_STEP * self.first_step):
            return None
        return 0.5 * (low + high)

    @property
    def at_sds(self) -> tuple[float, ...]:
        """One and two standard deviations, as far as they are within the limit."""
        return () if self.sd is None else tuple(k * self.sd for k in _AT_SDS if k * self.sd <= self.limit)


Tallies = Mapping[float, Tally]
"""What was found, by distance from the stated value."""


def arrives(tally: Tally, most: int) -> bool | None:
    """Return whether half or more arrive; None while that is open: more repetitions tell.

    Parameters
    ----------
    most : int
        Repetitions after which the share itself decides.
    """
    if tally.n < min(FIRST_LOOK, most):
        return None
    low, high = tally.interval
    if tally.n < most and low <= 0.5 <= high:
        return None
    return 2 * tally.arrived >= tally.n


def find_next(way: Way, tallies: Tallies, most: int) -> Ask | None:
    """Return what is tried next; None when the search is at its end."""
    bracket = _find_bracket(way, tallies, most)
    if isinstance(bracket, Ask):
        return bracket
    for distance in way.at_sds:
        if (n := _count(tallies, distance)) < (wanted := min(_LOOK_AGAIN * FIRST_LOOK, most)):
            return Ask(distance, max(n + 1, wanted))
    return None


def find_answer(way: Way, tallies: Tallies, most: int) -> float | None:
    """Return the distance at which a finished search found that fewer than half arrive; None if there is none."""
    bracket = _find_bracket(way, tallies, most)
    assert not isinstance(bracket, Ask)
    return bracket


def _find_bracket(way: Way, tallies: Tallies, most: int) -> Ask | float | None:
    """Return what is to be tried, else the answer."""
    low, high = 0.0, math.inf
    for rung in way.list_rungs():
        verdict = arrives(tallies.get(rung, Tally()), most)
        if verdict is None:
            return _ask_again(rung, tallies, most)
        if not verdict:
            high = rung
            break
        low = rung
    else:
        return None
    while (middle := way.halve(low, high)) is not None:
        verdict = arrives(tallies.get(middle, Tally()), most)
        if verdict is None:
            return _ask_again(middle, tallies, most)
        low, high = (middle, high) if verdict else (low, middle)
    # Repeated to the end, a value may turn out to arrive after all; the search then goes on beyond it.
    return high if _count(tallies, high) >= most else Ask(high, most)


def _ask_again(distance: float, tallies: Tallies, most: int) -> Ask:
    n = _count(tallies, distance)
    return Ask(distance, min(most, max(FIRST_LOOK, _LOOK_AGAIN * n)))


def _count(tallies: Tallies, distance: float) -> int:
    return tallies.get(distance, Tally()).n


def find_sure_sides(tallies: Tallies, answer: float | None) -> tuple[float | None, float | None]:
    """Return the nearest distances on both sides of the answer where the interval of the share leaves out one half.

    At the first more than half arrive, at the second fewer; None where no tried distance is sure. Without an answer the
    first is the farthest of all.
    """
    end = math.inf if answer is None else answer
    more = [distance for distance, tally in tallies.items() if distance < end and tally.interval[0] > 0.5]
    fewer = [distance for distance, tally in tallies.items() if distance >= end and tally.interval[1] < 0.5]
    return max(more, default=None), min(fewer, default=None)


def find_safe(tallies: Tallies) -> float | None:
    """Return the farthest distance up to which at least 95 % arrived wherever it was tried; None for none."""
    safe = None
    for distance in sorted(tallies):
        if tallies[distance].arrived < _MOST_ARRIVE * tallies[distance].n:
            break
        safe = distance
    return safe


def estimate_left(way: Way, tallies: Tallies, most: int) -> int:
    """Return roughly how many repetitions a search still takes, for the time that is left."""
    ask = find_next(way, tallies, most)
    if ask is None:
        return 0
    missed = any(arrives(tally, most) is False for tally in tallies.values())
    now = ask.repetitions - _count(tallies, ask.distance)
    return now + (2 * FIRST_LOOK if missed else 4 * FIRST_LOOK + most)
