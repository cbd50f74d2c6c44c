"""Where each axis has to be, and whether it is there.

What is decided here
--------------------
- Nothing here asks a drive: the positions that are read anyway are compared with the moves that labrig has started.
- An axis in motion follows its trapezoidal profile. When the drive took the move is known to lie between two instants,
  when it measured a position too, so that a computer that is late for any of them raises no alarm. Beyond that there is
  a margin of `TIME_MARGIN_S` for the drive's own cycle, and the following error at which the drive itself would fail.
- An axis has to follow a profile; that of one at rest stands still. It stays between start and end of the profile, but
  for two windows: it arrives within one, and holds within another.
- A position that changes faster than the axis can go is no motion: the encoder, its cable or its zero is at fault. In
  motion the drive's own cycle counts here too: at its greatest speed an axis would have no margin otherwise.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives.drive import STILL_COUNTS
from labrig.devices.trapezoid import Limits, Profile, make_move_profile, make_rest_profile
from labrig.errors import POSITION_JUMPED, DriveStrayedError

TIME_MARGIN_S = 0.05
"""By so much a drive may be earlier or later than its profile [s]."""

_WINDOWS = 2
_LOOK_FOR_MASTER = "find out what moves it: another program on the bus, or a force on the axis"
_LOOK_AT_ENCODER = "check the encoder and its cable, and whether another program has homed the drive"


class PositionReading(NamedTuple):
    """A position [mm or rad], measured by the drive between two instants of rig time [s]."""

    from_s: float
    until_s: float
    position: float


@dataclass(frozen=True)
class Expected:
    """What an axis has to do: follow a profile.

    Parameters
    ----------
    profile : Profile
        It begins when the drive had taken the move at the latest [mm or rad, s].
    ahead_s : float
        By how much earlier the drive may have begun [s].
    give : float
        Uncertainty of where a move began that replaced another [mm or rad].
    speed : float
        Highest speed of the move [mm/s or rad/s]; 0 at rest.
    """

    profile: Profile
    ahead_s: float = 0.0
    give: float = 0.0
    speed: float = 0.0

    @cached_property
    def way(self) -> tuple[float, float]:
        """The lowest and the highest position on the way."""
        return self.profile.range_within(-math.inf, self.profile.end_s)


def expect_rest(position: float) -> Expected:
    """Return what an axis has to do that stands at a position [mm or rad]."""
    return Expected(make_rest_profile(0.0, position))


AT_REST = expect_rest(math.nan)
"""The axis has to stand where it is; its first reading tells where that is."""


def expect_move(
    description: AxisDescription,
    before: Expected | None,
    here: float,
    target: tuple[float, float],
    taken: tuple[float, float],
) -> Expected:
    """Return what an axis has to do once its drive has taken a move.

    Parameters
    ----------
    description : AxisDescription
        The axis; complete.
    before : Expected or None
        What it had to do until then; a move still under way is replaced.
    here : float
        Where it was, read at the first of the two instants `taken` or after it [mm or rad].
    target : tuple of float
        Target and speed as the drive rounds them [mm or rad, per s].
    taken : tuple of float
        Instants between which the drive took the move [s].
    """
    scale = description.scale()
    acceleration = scale.to_acceleration(scale.to_acceleration_units(description.acceleration))
    begun_s, ahead_s, velocity, give = taken[1], taken[1] - taken[0], 0.0, 0.0
    if before is not None and before.speed and taken[0] < before.profile.end_s + TIME_MARGIN_S:
        velocity, unsure_s = before.profile.at(begun_s)[1], ahead_s + TIME_MARGIN_S
        give = (abs(velocity) + acceleration * unsure_s) * unsure_s
    limits = Limits(target[1], acceleration, acceleration)
    return Expected(make_move_profile(begun_s, here, velocity, target[0], limits), ahead_s, give, target[1])


class PositionWatch:
    """Judges the readings of one axis, whose section is complete.

    Parameters
    ----------
    name : str
        The axis.
    axis : AxisDescription
        Its section of the rig file.
    """

    def __init__(self, name: str, axis: AxisDescription) -> None:
        self._name = name
        self._axis = axis
        self._slack = _WINDOWS * max(axis.position_window, STILL_COUNTS / axis.scale().counts_per_unit)

    def judge(
        self, expected: Expected, last: PositionReading | None, reading: PositionReading
    ) -> DriveStrayedError | None:
        """Return the error of a reading if the axis is not where it has to be, or cannot have got there."""
        unit, position = self._axis.unit, reading.position
        if last is not None:
            longest_s = reading.until_s - last.from_s + (TIME_MARGIN_S if expected.speed else 0.0)
            if abs(position - last.position) > self._axis.max_speed * longest_s + self._slack:
                return DriveStrayedError(
                    f"the position of axis {self._name} jumped from {last.position:.4g} to {position:.4g} {unit} "
                    f"within {longest_s:.3f} s, faster than the axis can move ({self._axis.max_speed:.4g} {unit}/s)",
                    _LOOK_AT_ENCODER,
                    fault=POSITION_JUMPED,
                    axis=self._name,
                )
        low, high = expected.profile.range_within(
            reading.from_s - TIME_MARGIN_S, reading.until_s + expected.ahead_s + TIME_MARGIN_S
        )  # however late the computer was
        lag = self._axis.max_following_error + expected.give
        beyond = self._slack + expected.give
        low, high = max(low - lag, expected.way[0] - beyond), min(high + lag, expected.way[1] + beyond)
        if low <= position <= high:
            return None
        end = f"{expected.profile.end_position:.4f} {unit}"
        should = f"be between {low:.4f} and {high:.4f} {unit} on its way to" if expected.speed else "stand at"
        message = f"axis {self._name} should {should} {end}, and is at {position:.4f} {unit}"
        return DriveStrayedError(message, _LOOK_FOR_MASTER, axis=self._name)
