"""Conversion between mm or rad and the integers on the wire.

Positions are rounded to the nearest count (ties to even), so that they are off by at most half of one. Speeds and
accelerations are integers too, so that they come in steps: with integer rpm of lead / (60 * gear) mm/s; the achieved
one is reported.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class AxisScale:
    """Conversion of one axis to the counts and units of its drive.

    Parameters
    ----------
    counts_per_turn : float
        Counts a turn of the motor.
    gear_ratio : float
        Turns of the motor a turn of the screw or shaft.
    travel_per_turn : float
        Travel of the axis a turn of the screw [mm] or shaft (2 pi) [rad].
    reversed : bool
        Whether the axis goes backwards when the motor's counter goes up.
    speed_units, acceleration_units : float
        Units of the drive for one turn of the motor per second, and for one more each second; 60 for rpm and rpm/s.
    """

    counts_per_turn: float
    gear_ratio: float
    travel_per_turn: float
    reversed: bool = False
    speed_units: float = 60
    acceleration_units: float = 60

    @property
    def counts_per_unit(self) -> float:
        """Counts a mm or rad, without sign."""
        return self.counts_per_turn * self.gear_ratio / self.travel_per_turn

    @property
    def speed_units_per_speed(self) -> float:
        """Units of the drive a mm/s or rad/s."""
        return self.speed_units * self.gear_ratio / self.travel_per_turn

    @property
    def _sign(self) -> int:
        return -1 if self.reversed else 1

    def to_counts(self, position: float) -> int:
        """Return the count nearest to a position."""
        return self._sign * round(position * self.counts_per_unit)

    def to_position(self, counts: float) -> float:
        """Return the position [mm or rad] of a counter; exact to floating point."""
        return self._sign * counts / self.counts_per_unit

    def to_distance_counts(self, distance: float) -> int:
        """Return a distance in counts, at least one."""
        return max(1, round(distance * self.counts_per_unit))

    def to_speed_units(self, speed: float) -> int:
        """Return the integer nearest to a speed [mm/s or rad/s]; 1 is the least that a drive accepts."""
        return max(1, round(speed * self.speed_units_per_speed))

    def speed_units_below(self, speed: float) -> int:
        """Return the greatest integer that is no faster than a speed [mm/s or rad/s]; at least 1."""
        return max(1, math.floor(speed * self.speed_units_per_speed))

    def to_speed(self, speed_units: int) -> float:
        """Return the speed of the axis [mm/s or rad/s] at a speed of the drive."""
        return speed_units / self.speed_units_per_speed

    @property
    def acceleration_units_per_acceleration(self) -> float:
        """Units of the drive a mm/s^2 or rad/s^2."""
        return self.acceleration_units * self.gear_ratio / self.travel_per_turn

    def to_acceleration_units(self, acceleration: float) -> int:
        """Return the integer nearest to an acceleration [mm/s^2 or rad/s^2]; at least 1."""
        return max(1, round(acceleration * self.acceleration_units_per_acceleration))

    def to_acceleration(self, acceleration_units: int) -> float:
        """Return the acceleration of the axis [mm/s^2 or rad/s^2] at an acceleration of the drive."""
        return acceleration_units / self.acceleration_units_per_acceleration


TURN_RAD = 2 * math.pi
"""Travel of a rotating axis a turn [rad]."""
