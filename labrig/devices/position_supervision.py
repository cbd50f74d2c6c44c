"""Where each axis has to be, and whether it is there.

What is decided here
--------------------
- Nothing here asks a drive: the positions that are read anyway are compared with the moves that labrig has started.
- An axis in motion follows its trapezoidal profile. When the drive took the move is known to lie between two instants,
  when it measured a position too, so that a computer that is late for any of them raises no alarm. Beyond that there is
  a margin of `TIME_MARGIN_S` for the drive's own cycle, and the following error at which the drive itself would fail.
- An axis in motion stays between its start and its target, plus its window. An axis at rest stays within two windows
  of its place: it arrives within one, and holds within another.
- A position that changes faster than the axis can go is no motion: the encoder, its cable or its zero is at fault. In
  motion the drive's own cycle counts here too: at its greatest speed an axis would have no margin otherwise.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives.drive import STILL_COUNTS
from labrig.devices.trapezoid import Limits, Profile, make_move_profile
from labrig.errors import POSITION_JUMPED, STRAYED, DriveStrayedError

TIME_MARGIN_S = 0.05
"""By so much a drive may be earlier or later than its profile [s]."""

_WINDOWS_AT_REST = 2
_LOOK_FOR_MASTER = "find out what moves it: another program on the bus, or a force on the axis"
_LOOK_AT_ENCODER = "check the encoder and its cable, and whether another program has homed the drive"


@dataclass(frozen=True)
class AtRest:
    """An axis that has to stay where it is; a position of None is that of the first reading."""

    position: float | None = None


@dataclass(frozen=True)
class InMotion:
    """An axis that has to follow a profile.

    Parameters
    ----------
    profile : Profile
        It begins when the drive had taken the move at the latest [mm or rad, s].
    ahead_s : float
        By how much earlier the drive may have begun [s].
    give : float
        Uncertainty of where a move began that replaced another [mm or rad].
    speed : float
        Highest speed of the move [mm/s or rad/s].
    """

    profile: Profile
    ahead_s: float
    give: float = 0.0
    speed: float = 0.0

    @cached_property
    def way(self) -> tuple[float, float]:
        """The lowest and the highest position on the way."""
        return self.profile.range_within(-math.inf, self.profile.end_s)


Expected = AtRest | InMotion
"""What an axis has to do."""


class PositionReading(NamedTuple):
    """A position [mm or rad], measured by the drive between two instants of rig time [s]."""

    from_s: float
    until_s: float
    position: float


def expect_move(
    description: AxisDescription,
    before: Expected | None,
    here: float,
    target: tuple[float, float],
    taken: tuple[float, float],
) -> InMotion:
    """Return what an axis has to do once its drive has taken a move.

    Parameters
    ----------
    description : AxisDescription
        The axis; complete.
    before : InMotion, AtRest or None
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
    if isinstance(before, InMotion) and taken[0] < before.profile.end_s + TIME_MARGIN_S:
        velocity, unsure_s = before.profile.at(begun_s)[1], ahead_s + TIME_MARGIN_S
        give = (abs(velocity) + acceleration * unsure_s) * unsure_s
    profile = make_move_profile(
        begun_s, here, velocity, target[0], Limits(target[1], acceleration, acceleration)
    )
    return InMotion(profile, ahead_s, give, target[1])


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
        self._window = max(axis.position_window, STILL_COUNTS / axis.scale().counts_per_unit)
        self._expected: Expected | None = None
        self._rest: float | None = None
        self._last: PositionReading | None = None

    def judge(self, expected: Expected | None, reading: PositionReading) -> DriveStrayedError | None:
        """Return the error if the axis is not where it has to be.

        Parameters
        ----------
        expected : Expected or None
            What it has to do; a new object whenever that changes. None: nobody can tell.
        reading : PositionReading
            Where it is.
        """
        if expected is not self._expected:
            self._expected = expected
            self._rest = expected.position if isinstance(expected, AtRest) else None
            if expected is None or expected == AtRest():  # its positions may count from another zero
                self._last = None
        if expected is None:
            return None
        if isinstance(expected, InMotion):
            margin_s, (low, high) = TIME_MARGIN_S, self._bounds_in_motion(expected, reading)
        else:
            self._rest = reading.position if self._rest is None else self._rest
            margin_s, slack = 0.0, _WINDOWS_AT_REST * self._window
            low, high = self._rest - slack, self._rest + slack
        last, self._last = self._last, reading
        error = self._find_jump(last, reading, margin_s)
        if error is None and not low <= reading.position <= high:
            return self._tell_strayed(expected, (low, high), reading.position)
        return error

    def _bounds_in_motion(self, expected: InMotion, reading: PositionReading) -> tuple[float, float]:
        low, high = _profile_range(expected, reading)
        lag, beyond = self._axis.max_following_error + expected.give, self._window + expected.give
        return max(low - lag, expected.way[0] - beyond), min(high + lag, expected.way[1] + beyond)

    def _find_jump(
        self, last: PositionReading | None, reading: PositionReading, margin_s: float
    ) -> DriveStrayedError | None:
        if last is None:
            return None
        longest_s, unit = reading.until_s - last.from_s + margin_s, self._axis.unit
        reach = self._axis.max_speed * longest_s + _WINDOWS_AT_REST * self._window
        if abs(reading.position - last.position) <= reach:
            return None
        return DriveStrayedError(
            f"the position of axis {self._name} jumped from {last.position:.4g} to {reading.position:.4g} {unit} "
            f"within {longest_s:.3f} s, faster than the axis can move ({self._axis.max_speed:.4g} {unit}/s)",
            _LOOK_AT_ENCODER,
            fault=POSITION_JUMPED,
        )

    def _tell_strayed(
        self, expected: Expected, bounds: tuple[float, float], position: float
    ) -> DriveStrayedError:
        unit = self._axis.unit
        if isinstance(expected, InMotion):
            way = f"on its way to {expected.profile.end_position:.4f} {unit}"
            should = f"should be between {bounds[0]:.4f} and {bounds[1]:.4f} {unit} {way}"
        else:
            should = f"should stand at {sum(bounds) / 2:.4f} {unit}"
        return DriveStrayedError(
            f"axis {self._name} {should}, and is at {position:.4f} {unit}", _LOOK_FOR_MASTER, fault=STRAYED
        )


def bound_lag(expected: InMotion, reading: PositionReading) -> float:
    """Return the largest following error that an axis in motion may have by a reading of its position [mm or rad]."""
    low, high = _profile_range(expected, reading)
    return max(high - reading.position, reading.position - low) + expected.give


def _profile_range(expected: InMotion, reading: PositionReading) -> tuple[float, float]:
    """Return between which positions the profile was when a position was measured, however late the computer was."""
    return expected.profile.range_within(
        reading.from_s - TIME_MARGIN_S, reading.until_s + expected.ahead_s + TIME_MARGIN_S
    )
