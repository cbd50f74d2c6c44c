"""The motor shaft of a simulated drive: profile, stops, counter and motor current, and the searches of its homing.

The current is that of a simple model of motor and position controller. A motor that turns carries its friction, in the
direction of its motion. A shaft that something holds
makes the position controller push harder the further it lags, by a constant current for each turn of lag. A motor at
rest without lag carries nothing: screw and gear hold themselves. The output current limit of the drive caps all of it.
Inertia is left out. The motor is a small brushed one with a gearhead, not a certain one.

Homing methods below zero belong to manufacturers: -1 and -3 go with positive speed into the upper stop, -2 and -4 with
negative speed into the lower one; 1, 2, -1 and -2 end at the encoder's index.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from labrig.devices.trapezoid import (
    Limits,
    Profile,
    make_brake_profile,
    make_move_profile,
    make_rest_profile,
)

_FRICTION_MA = 60.0
"""Current that carries the friction of motor and gearhead: 1.5 mNm, at 25 mNm/A."""

_STIFFNESS_MA_PER_TURN = 4000.0
"""Current with which the position controller answers a lag of one turn of the motor."""


_HALVINGS = 40


@dataclass(frozen=True)
class Mechanics:
    """Stops and switches of the shaft; places in its counts, None if absent.

    Parameters
    ----------
    lower_stop, upper_stop : float or None
        Hard stops.
    negative_switch, positive_switch : float or None
        Limit switches: the negative one is active at or below its place, the positive one at or above.
    """

    lower_stop: float | None = None
    upper_stop: float | None = None
    negative_switch: float | None = None
    positive_switch: float | None = None


class MotorShaft:
    """Where the shaft should be, where it is, and what its counter reads.

    Parameters
    ----------
    mechanics : Mechanics
        Its stops and switches.
    now_s : float
        The present time; shaft and counter start at zero.

    Attributes
    ----------
    still_s : float
        Instant at which the shaft came to rest last, or will.
    """

    def __init__(self, mechanics: Mechanics, now_s: float) -> None:
        self.mechanics = mechanics
        self.zero = 0.0
        self.profile: Profile = make_rest_profile(now_s, 0.0)
        self.demand = self.actual = self.velocity = 0.0
        self.ticked_s = self.still_s = now_s
        self._jam: float | None = None

    @property
    def position(self) -> float:
        """Where the shaft is, independent of the counter [counts]."""
        return self.actual + self.zero

    @property
    def stuck(self) -> bool:
        """Whether something blocks the shaft."""
        return self.demand != self.actual

    def jam(self) -> None:
        """Block the shaft where it is."""
        self._jam = self.position

    def free(self) -> None:
        """Take the blockage away."""
        self._jam = None

    def current_ma(self, counts_per_turn: float, limit_ma: float) -> float:
        """Return the motor current under an output current limit [mA]."""
        lag_turns = (self.demand - self.actual) / counts_per_turn
        current_ma = _STIFFNESS_MA_PER_TURN * lag_turns
        if direction := (0.0 if self.stuck else self.velocity) or lag_turns:
            current_ma += math.copysign(_FRICTION_MA, direction)
        return max(-limit_ma, min(limit_ma, current_ma))

    def is_at_rest(self, now_s: float) -> bool:
        """Tell whether the profile has ended."""
        return now_s >= self.profile.end_s

    def at(self, t_s: float) -> tuple[float, float]:
        """Return (demanded, actual) counter at a time within the present profile."""
        demand = self.profile.at(t_s)[0]
        return demand, self._clip_to_stops(demand)

    def tick(self, now_s: float) -> None:
        """Follow the profile to this time."""
        self.demand, self.velocity = self.profile.at(now_s)
        self.actual = self._clip_to_stops(self.demand)
        self.ticked_s = now_s

    def _clip_to_stops(self, counter: float) -> float:
        if self._jam is not None:
            return self._jam - self.zero
        low, high = self.mechanics.lower_stop, self.mechanics.upper_stop
        if low is not None and counter < low - self.zero:
            return low - self.zero
        if high is not None and counter > high - self.zero:
            return high - self.zero
        return counter

    def find_first_time(self, is_past: Callable[[float, float], bool], now_s: float) -> float:
        """Return the instant since the last tick at which (demand, actual) passed a condition."""
        before_s, after_s = self.ticked_s, now_s
        for _ in range(_HALVINGS):
            middle_s = (before_s + after_s) / 2
            if is_past(*self.at(middle_s)):
                after_s = middle_s
            else:
                before_s = middle_s
        return after_s

    def _follow(self, profile: Profile, t_s: float) -> None:
        if profile.end_s > t_s or not self.is_at_rest(t_s):
            self.still_s = profile.end_s
        self.profile = profile

    def go(self, t_s: float, target: float, limits: Limits) -> None:
        """Start a profile to a target."""
        self._follow(make_move_profile(t_s, *self.profile.at(t_s), target, limits), t_s)

    def brake(self, t_s: float, deceleration: float) -> None:
        """Come to rest."""
        self._follow(make_brake_profile(t_s, *self.profile.at(t_s), deceleration), t_s)

    def hold(self, t_s: float) -> None:
        """Stand still where the shaft is: power was switched, and friction holds it."""
        self._follow(make_rest_profile(t_s, self.at(t_s)[1]), t_s)
        self.tick(max(t_s, self.ticked_s))

    def count_from(self, t_s: float, counter: float) -> None:
        """Set the counter at the present position."""
        self.zero = self.position - counter
        self._follow(make_rest_profile(t_s, counter), t_s)
        self.tick(max(t_s, self.ticked_s))


_FOR_EVER = 1e12
HOMING_HERE = frozenset({35, 37})
"""Homing methods that move nothing."""

SEARCHES = {
    -1: ("upper_stop", 1), -2: ("lower_stop", -1), -3: ("upper_stop", 1), -4: ("lower_stop", -1),
    1: ("negative_switch", -1), 2: ("positive_switch", 1),
    17: ("negative_switch", -1), 18: ("positive_switch", 1),
}  # fmt: skip
"""Homing method -> what it seeks, and the direction towards it; the index is sought on the way back."""

_TO_INDEX = frozenset({-2, -1, 1, 2})


def plan_search(method: int, shaft: MotorShaft, counts_per_turn: float, offset: float) -> tuple[float, ...]:
    """Return the counters to which a method goes one after the other, the home offset last.

    At a stop, the first one is only the direction: what blocks the shaft ends it.
    """
    if method in HOMING_HERE:
        return ()
    end, direction = SEARCHES[method]
    place: float | None = getattr(shaft.mechanics, end)
    if place is None:
        return (direction * _FOR_EVER,)
    found = place - shaft.zero
    first = direction * _FOR_EVER if method < 0 else found
    if method not in _TO_INDEX:
        return first, found + offset
    home = _find_next_index(found, -direction, shaft.zero, counts_per_turn)
    return first, home, home + offset


def _find_next_index(counter: float, direction: int, zero: float, per_turn: float) -> float:
    turns = (counter + zero) / per_turn
    turn = math.floor(turns) + 1 if direction > 0 else math.ceil(turns) - 1
    return turn * per_turn - zero
