"""The motor shaft of a simulated drive: its profile, its mechanical stops, and its counter."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from labrig.devices.simulated.motor import Motor
from labrig.devices.trapezoid import (
    Limits,
    Profile,
    make_brake_profile,
    make_move_profile,
    make_rest_profile,
)

_HALVINGS = 40


@dataclass(frozen=True)
class Mechanics:
    """Motor, stops and switches of the shaft, and what is wired to the drive; places in its counts, None if absent.

    Parameters
    ----------
    lower_stop, upper_stop : float or None
        Hard stops.
    negative_switch, positive_switch : float or None
        Limit switches: the negative one is active at or below its place, the positive one at or above.
    motor : Motor
        The motor and its load.
    analog_mv : mapping of str to callable
        Analog input of the drive, such as analog-1 -> its voltage now [mV].
    """

    lower_stop: float | None = None
    upper_stop: float | None = None
    negative_switch: float | None = None
    positive_switch: float | None = None
    motor: Motor = field(default_factory=Motor)
    analog_mv: Mapping[str, Callable[[], float]] = field(default_factory=dict)


class MotorShaft:
    """Where the shaft should be, where it is, and what its counter reads.

    Parameters
    ----------
    mechanics : Mechanics
        Its stops and switches.
    now_s : float
        The present time; shaft and counter start at zero.
    """

    def __init__(self, mechanics: Mechanics, now_s: float) -> None:
        self.mechanics = mechanics
        self.zero = 0.0
        self.profile: Profile = make_rest_profile(now_s, 0.0)
        self.demand = self.actual = self.velocity = 0.0
        self.ticked_s = now_s
        self._jam: float | None = None
        self._uncoupled = False

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

    def uncouple(self) -> None:
        """Let the motor no longer turn the shaft, and feel nothing of it."""
        self.jam()
        self._uncoupled = True

    def free(self) -> None:
        """Take the blockage away."""
        self._jam = None
        self._uncoupled = False

    def current_ma(self, counts_per_turn: float, limit_ma: float) -> float:
        """Return the motor current under an output current limit [mA]."""
        if self._uncoupled:
            return 0.0
        lag_turns = (self.demand - self.actual) / counts_per_turn
        return self.mechanics.motor.current_ma(0.0 if self.stuck else self.velocity, lag_turns, limit_ma)

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

    def go(self, t_s: float, target: float, limits: Limits) -> None:
        """Start a profile to a target."""
        position, velocity = self.profile.at(t_s)
        self.profile = make_move_profile(t_s, position, velocity, target, limits)

    def brake(self, t_s: float, deceleration: float) -> None:
        """Come to rest."""
        position, velocity = self.profile.at(t_s)
        self.profile = make_brake_profile(t_s, position, velocity, deceleration)

    def hold(self, t_s: float) -> None:
        """Stand still where the shaft is: power was switched, and friction holds it."""
        actual = self.at(t_s)[1]
        self.profile = make_rest_profile(t_s, actual)
        self.tick(max(t_s, self.ticked_s))

    def count_from(self, t_s: float, counter: float) -> None:
        """Set the counter at the present position."""
        self.zero = self.position - counter
        self.profile = make_rest_profile(t_s, counter)
        self.tick(max(t_s, self.ticked_s))

    def shift_counter(self, t_s: float, counts: float) -> None:
        """Let the counter jump, on the way too: the shaft goes on as before."""
        self.profile = self.profile.shifted(counts)
        self.zero -= counts
        self.tick(max(t_s, self.ticked_s))
