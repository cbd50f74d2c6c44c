"""Between mm or rad outside and quadcounts and rpm on the wire.

A quadcount is a quarter of an encoder line: 4 * pulses per turn of the encoder shaft, which is the motor's.
Positions are rounded to the nearest quadcount (ties to even), so that they are off by at most half of one.
Speeds are integer rpm on the wire (0x6081), so that they come in steps of lead / (60 * gear) mm/s; the
achieved one is reported.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class AxisScale:
    """What one axis makes of its encoder.

    Parameters
    ----------
    encoder_pulses_per_turn : int
        Lines of the encoder a turn of the motor.
    gear_ratio : float
        Turns of the motor a turn of the screw or shaft.
    travel_per_turn : float
        Travel of the axis a turn of the screw [mm] or shaft (2 pi) [rad].
    reversed : bool
        Whether the axis goes backwards when the motor's counter goes up.
    """

    encoder_pulses_per_turn: int
    gear_ratio: float
    travel_per_turn: float
    reversed: bool = False

    @property
    def quadcounts_per_unit(self) -> float:
        """Quadcounts a mm or rad, without sign."""
        return 4 * self.encoder_pulses_per_turn * self.gear_ratio / self.travel_per_turn

    @property
    def rpm_per_speed(self) -> float:
        """Motor rpm a mm/s or rad/s."""
        return 60 * self.gear_ratio / self.travel_per_turn

    @property
    def _sign(self) -> int:
        return -1 if self.reversed else 1

    def to_quadcounts(self, position: float) -> int:
        """Return the quadcount nearest to a position."""
        return self._sign * round(position * self.quadcounts_per_unit)

    def to_position(self, quadcounts: float) -> float:
        """Return the position [mm or rad] of a counter; exact to floating point."""
        return self._sign * quadcounts / self.quadcounts_per_unit

    def to_distance_quadcounts(self, distance: float) -> int:
        """Return a distance in quadcounts, at least one."""
        return max(1, round(distance * self.quadcounts_per_unit))

    def to_rpm(self, speed: float) -> int:
        """Return the integer rpm nearest to a speed [mm/s or rad/s]; 1 is the least that 0x6081 takes."""
        return max(1, round(speed * self.rpm_per_speed))

    def to_speed(self, rpm: int) -> float:
        """Return the speed of the axis [mm/s or rad/s] at a motor speed."""
        return rpm / self.rpm_per_speed

    def to_rpm_per_s(self, acceleration: float) -> int:
        """Return the integer rpm/s nearest to an acceleration [mm/s^2 or rad/s^2]; at least 1."""
        return self.to_rpm(acceleration)


TURN_RAD = 2 * math.pi
"""Travel of a rotating axis a turn [rad]."""
