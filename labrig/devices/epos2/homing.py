"""Homing methods of an EPOS2: which there are, and which way each goes.

The signs are maxon's: -1 and -3 go in the POSITIVE direction until the current threshold, -2 and -4 in the
negative one. `canopen` has them the other way round, which would drive an axis the wrong way.
"""

from labrig.devices.homing import HOMING_HERE

HOMING_DIRECTIONS = {
    1: -1,  # negative limit switch and index
    2: +1,  # positive limit switch and index
    17: -1,  # negative limit switch
    18: +1,  # positive limit switch
    -1: +1,  # current threshold, positive speed, and index
    -2: -1,  # current threshold, negative speed, and index
    -3: +1,  # current threshold, positive speed
    -4: -1,  # current threshold, negative speed
    HOMING_HERE: 0,
}
"""Method -> sign of the motor's speed in its search."""

BY_CURRENT = frozenset({-1, -2, -3, -4})
"""Methods that run into a stop."""
