"""Homing methods of a simulated drive, each as a sequence of moves of the shaft.

Methods below zero belong to manufacturers: -1 and -3 go with positive speed into the upper stop, -2 and
-4 with negative speed into the lower one; 1, 2, -1 and -2 end at the encoder's index.
"""

import math
from dataclasses import dataclass

from labrig.devices.simulated.shaft import MotorShaft

_TO_INDEX = frozenset({-2, -1, 1, 2})
_FOR_EVER = 1e12


@dataclass(frozen=True)
class HomingMove:
    """A move of a homing sequence.

    Parameters
    ----------
    target : float
        Counter to go to.
    slow : bool
        At the speed for the index, not for the switch.
    to_stop : bool
        Ends at a stop; the target gives only the direction.
    """

    target: float
    slow: bool = False
    to_stop: bool = False


def plan_homing(
    method: int, shaft: MotorShaft, counts_per_turn: float, offset: float
) -> tuple[HomingMove, ...]:
    """Return the moves of a method from where the shaft is, the home offset last."""
    if method in {35, 37}:
        return ()
    place, direction, back = _find_end(method, shaft)
    if place is None:
        return (HomingMove(direction * _FOR_EVER, to_stop=method < 0),)
    end = place - shaft.zero
    first = HomingMove(direction * _FOR_EVER if method < 0 else end, to_stop=method < 0)
    if method not in _TO_INDEX:
        return (first, HomingMove(end + offset, slow=True))
    index = _find_next_index(end, back, shaft.zero, counts_per_turn)
    return (first, HomingMove(index, slow=True), HomingMove(index + offset, slow=True))


def _find_end(method: int, shaft: MotorShaft) -> tuple[float | None, int, int]:
    """Return (place of the stop or switch, direction towards it, direction in which the index is sought)."""
    mechanics = shaft.mechanics
    ends = {
        **dict.fromkeys((-1, -3), (mechanics.upper_stop, 1)),
        **dict.fromkeys((-2, -4), (mechanics.lower_stop, -1)),
        **dict.fromkeys((1, 17), (mechanics.negative_switch, -1)),
        **dict.fromkeys((2, 18), (mechanics.positive_switch, 1)),
    }
    place, direction = ends[method]
    return place, direction, -direction


def _find_next_index(counter: float, direction: int, zero: float, per_turn: float) -> float:
    turns = (counter + zero) / per_turn
    turn = math.floor(turns) + 1 if direction > 0 else math.ceil(turns) - 1
    return turn * per_turn - zero
