"""Homing of an EPOS2: which methods there are, which way each goes, what one of them needs, and when it is allowed.

An axis is homed by a search only on a bare instrument, the linear module first, so that nothing turns or comes out
before the instrument is known to be clear of the frame. With a needle mounted only what cannot bend or lose it is
allowed: needle and bevel get their zeros where they stand (the tip flush with the sheath), and the linear module may
search backwards, away from the gel. With a needle in tissue nothing is homed at all.

The signs are maxon's: -1 and -3 go in the POSITIVE direction until the current threshold, -2 and -4 in the
negative one. `canopen` has them the other way round, which would drive an axis the wrong way.
"""

from collections.abc import Collection
from dataclasses import dataclass

from labrig.errors import SafetyStopError

HOMING_HERE = 35
"""Method that makes the position here the home position; nothing moves."""

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


@dataclass(frozen=True)
class Homing:
    """One homing, in the units of the drive.

    Parameters
    ----------
    method : int
        A key of `HOMING_DIRECTIONS`.
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


HOME_ORDER = ("linear", "insertion", "rotation")
"""In which order axes are homed."""

ZEROS = {
    "insertion": "the needle's tip, or the end of the bare screw's carriage, flush with the end of the sheath",
    "rotation": "the bevel, or its mark on the chuck, at roll zero",
    "linear": "the sheath's end just before the gel's place",
}
"""What the zero of each axis is."""


def require_homing_allowed(
    axis: str, method: int, direction: int, *, needle_mounted: bool, referenced: Collection[str]
) -> None:
    """Refuse a homing that could bend a needle or run the instrument into something.

    Parameters
    ----------
    axis : str
        insertion, rotation or linear.
    method : int
        A key of `HOMING_DIRECTIONS`.
    direction : int
        Which way the axis goes in its search: -1 back, +1 forwards.
    needle_mounted : bool
        Whether a needle is in the clamp.
    referenced : collection of str
        Axes that have their reference.

    Raises
    ------
    SafetyStopError
        Says what to do instead.
    """
    if method == HOMING_HERE:
        return
    if needle_mounted and axis != "linear":
        raise SafetyStopError(
            f"axis {axis} is not homed by method {method} with a needle mounted: the search could bend it",
            f"take the needle out, or set the zero where it stands: labrig devices home --axis {axis} --method 35",
        )
    if needle_mounted and direction > 0:
        raise SafetyStopError(
            f"axis {axis} is not homed by method {method} with a needle mounted: it would search towards the gel",
            "take the needle out, or give the axis a method that searches backwards",
        )
    if axis != "linear" and "linear" not in referenced:
        raise SafetyStopError(
            f"axis {axis} is not homed by method {method} before the linear module: it might stand in the frame",
            "first: labrig devices home --axis linear",
        )
