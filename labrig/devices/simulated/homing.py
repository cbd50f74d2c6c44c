"""Homing methods of a simulated drive, each as the stretches that the shaft travels.

Those below zero are maxon's, with its signs: -1 and -3 go with positive speed into the upper stop, -2 and
-4 with negative speed into the lower one; 1, 2, 7, 11, 33, 34, -1 and -2 end at the encoder's index.
"""

import math
from dataclasses import dataclass

from labrig.devices.simulated.shaft import Shaft

_TO_INDEX = frozenset({-2, -1, 1, 2, 7, 11})
_FOR_EVER = 1e12


@dataclass(frozen=True)
class Stretch:
    """A part of homing.

    Parameters
    ----------
    target : float
        Counter to go to.
    slow : bool
        At the speed for the index, not that for the switch.
    to_stop : bool
        Ends where the shaft runs against something; the target is only a direction.
    """

    target: float
    slow: bool = False
    to_stop: bool = False


def plan_homing(method: int, shaft: Shaft, quadcounts_per_turn: int, offset: float) -> tuple[Stretch, ...]:
    """Return the stretches of a method from where the shaft stands, the home offset last."""
    if method in {0, 35, 37}:
        return ()
    if method in {33, 34}:
        index = _next_index(shaft.actual, 1 if method == 34 else -1, shaft.zero, quadcounts_per_turn)
        return (Stretch(index, slow=True), Stretch(index + offset, slow=True))
    place, direction, back = _end_of(method, shaft)
    if place is None:
        return (Stretch(direction * _FOR_EVER, to_stop=method < 0),)
    end = place - shaft.zero
    first = Stretch(direction * _FOR_EVER if method < 0 else end, to_stop=method < 0)
    if method not in _TO_INDEX:
        return (first, Stretch(end + offset, slow=True))
    index = _next_index(end, back, shaft.zero, quadcounts_per_turn)
    return (first, Stretch(index, slow=True), Stretch(index + offset, slow=True))


def _end_of(method: int, shaft: Shaft) -> tuple[float | None, int, int]:
    """Return (place of the stop or switch, direction towards it, direction in which the index is sought)."""
    mechanics = shaft.mechanics
    ends = {
        **dict.fromkeys((-1, -3), (mechanics.upper_stop, 1)),
        **dict.fromkeys((-2, -4), (mechanics.lower_stop, -1)),
        **dict.fromkeys((1, 17), (mechanics.negative_switch, -1)),
        **dict.fromkeys((2, 18), (mechanics.positive_switch, 1)),
        **dict.fromkeys((7, 23), (mechanics.home_switch, 1)),
        **dict.fromkeys((11, 27), (mechanics.home_switch, -1)),
    }
    place, direction = ends[method]
    return place, direction, -direction


def _next_index(counter: float, direction: int, zero: float, per_turn: int) -> float:
    turns = (counter + zero) / per_turn
    turn = math.floor(turns) + 1 if direction > 0 else math.ceil(turns) - 1
    return turn * per_turn - zero
