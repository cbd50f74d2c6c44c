"""Homing of an EPOS2: which methods there are, which way each goes, and what one of them needs.

The signs are maxon's: -1 and -3 go in the POSITIVE direction until the current threshold, -2 and -4 in the
negative one. `canopen` has them the other way round, which would drive an axis the wrong way.
"""

from dataclasses import dataclass

HERE = 35
"""Method that makes the position here the home position; nothing moves."""

DIRECTIONS = {
    1: -1,  # negative limit switch and index
    2: +1,  # positive limit switch and index
    17: -1,  # negative limit switch
    18: +1,  # positive limit switch
    -1: +1,  # current threshold, positive speed, and index
    -2: -1,  # current threshold, negative speed, and index
    -3: +1,  # current threshold, positive speed
    -4: -1,  # current threshold, negative speed
    HERE: 0,
}
"""Method -> sign of the motor's speed in its search."""

BY_CURRENT = frozenset({-1, -2, -3, -4})
"""Methods that run into a stop."""


@dataclass(frozen=True)
class Homing:
    """One homing, in the units of the drive.

    Parameters
    ----------
    method : int
        A key of `DIRECTIONS`.
    offset, position : int
        How far to move off the switch or stop [quadcounts], and the position that this point gets.
    switch_rpm, index_rpm, rpm_per_s : int
        Speed of the search, of the search for the index, and acceleration.
    current_threshold_ma : int
        Current at which a stop is believed to have been reached.
    timeout_s : float
        When it is given up.
    """

    method: int
    offset: int = 0
    position: int = 0
    switch_rpm: int = 100
    index_rpm: int = 10
    rpm_per_s: int = 1000
    current_threshold_ma: int = 500
    timeout_s: float = 1.0
