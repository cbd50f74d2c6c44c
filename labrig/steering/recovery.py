"""Recovery: a needle that is blocked, or that would miss, is withdrawn part of the way, turned, and goes in again.

A withdrawn needle lies in its own cut, and goes in again along it while the bevel points as it did. With the bevel
turned it leaves the cut, but only after a length along which the cut still guides it. So the needle is withdrawn by
that length beyond the place where it is to leave, and the pose there is the one estimated when the tip first passed.
No measurement of ours says how long the guided length is. Its uncertainty is added to that of the heading, because the
tip bends to the wrong side meanwhile.

What was seen on the way counts: a stretch in which the needle did not bend is taken for a cavity that it will pass
again. So a path is only tried if the target can still be reached from where the cavity ends.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from labrig.errors import InputError
from labrig.steering.bending import Turn
from labrig.steering.cavities import TipBelief
from labrig.steering.tip import TipState, freeze

Stretch = tuple[float, float]
"""From and to which insertion length [mm]."""

_HEADING = 3
_LIKELY = 0.5
_LEAST_MM = 1.0
# Distance between the places from which paths are tried.
_APART_MM = 3.0
# The filter notices a cavity, and its end, so long after the tip [mm]: a bend shows late, and a straight path later.
_NOTICED_MM, _END_NOTICED_MM = 6.0, 2.0


@dataclass(frozen=True)
class RecoverySettings:
    """Whether and how a needle recovers.

    Parameters
    ----------
    most_attempts : int
        So often it may be withdrawn in an insertion.
    back_mm : float
        Least length by which it is withdrawn, besides what the old cut guides it.
    leaves_track_mm : float
        Length along which a needle that goes in again follows its old cut with its bevel turned.
    leaves_track_sd_mm : float
        Standard deviation of that length.
    """

    most_attempts: int
    back_mm: float
    leaves_track_mm: float
    leaves_track_sd_mm: float

    def __post_init__(self) -> None:
        """Refuse a number that is not positive."""
        for name, value in vars(self).items():
            if not value > 0:
                raise InputError(f"{name} is {value:g}, it must be above 0")


@dataclass(frozen=True, eq=False)
class PassedPlace:
    """A place that the tip has passed: the estimate there, and the turns that had not acted yet."""

    insertion_mm: float
    belief: TipBelief
    turns: tuple[Turn, ...]


def find_cavities(passed: Sequence[PassedPlace]) -> tuple[Stretch, ...]:
    """Return the stretches on which the tip was probably in a cavity, from and to which insertion length."""
    found = list[Stretch]()
    for before, place in pairwise(passed):
        if place.belief.cavity > _LIKELY:
            from_mm = before.insertion_mm - _NOTICED_MM
            to_mm = place.insertion_mm - _END_NOTICED_MM
            if found and found[-1][1] >= from_mm:
                from_mm = found.pop()[0]
            found.append((from_mm, to_mm))
    return tuple(found)


def list_places_back(
    passed: Sequence[PassedPlace],
    unfit: Sequence[Stretch],
    before_mm: float,
    recovery: RecoverySettings,
) -> Iterator[PassedPlace]:
    """Yield the places from which a withdrawn needle could go on, the nearest first.

    Parameters
    ----------
    passed : sequence of PassedPlace
        In order of depth.
    unfit : sequence of (float, float)
        Insertion lengths from and to which no place is wanted.
    before_mm : float
        Insertion length before which all places lie.
    recovery : RecoverySettings
    """
    next_mm = before_mm - recovery.back_mm
    for place in reversed(passed):
        at_mm = place.insertion_mm
        fits = not any(from_mm <= at_mm <= to_mm for from_mm, to_mm in unfit)
        if at_mm <= next_mm and at_mm - recovery.leaves_track_mm >= _LEAST_MM and fits:
            next_mm = at_mm - _APART_MM
            yield place


def widen_belief(belief: TipBelief, recovery: RecoverySettings) -> TipBelief:
    """Return the estimate with the uncertainty of the heading at which the tip leaves its old cut."""
    tip, outside, inside = (_widen(tip, recovery) for tip in (belief.tip, belief.outside, belief.inside))
    return TipBelief(tip, outside, inside, belief.cavity)


def _widen(tip: TipState, recovery: RecoverySettings) -> TipState:
    covariance = tip.covariance.copy()
    covariance[_HEADING, _HEADING] += (2.0 * tip.curvature * recovery.leaves_track_sd_mm) ** 2
    return replace(tip, covariance=freeze(covariance))
