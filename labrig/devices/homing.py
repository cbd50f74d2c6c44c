"""Homing: when it is allowed, and in which order.

An axis searches for home only with a bare instrument, the linear module first, so that nothing turns or comes out
before the instrument is clear of the frame. With a needle mounted, only what cannot bend or lose it is allowed: needle
and bevel get their zeros in place (the tip flush with the sheath), and the linear module may search backwards, away
from the gel. With a needle in tissue nothing is homed.
"""

from collections.abc import Collection

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives.drive import HOMING_HERE
from labrig.errors import LimitError, SafetyStopError

HOME_ORDER = ("linear", "insertion", "rotation")
"""In which order axes are homed."""

ZEROS = {
    "insertion": "the needle's tip, or the end of the bare screw's carriage, flush with the end of the sheath",
    "rotation": "the bevel, or its mark on the chuck, at roll 0",
    "linear": "the sheath's end just before the gel's place",
}
"""Where the zero of each axis is."""


def require_homing_allowed(
    axis: AxisDescription,
    name: str,
    method: int,
    *,
    needle_mounted: bool,
    referenced: Collection[str],
    limit_ma: int | None,
) -> None:
    """Refuse a homing that could bend a needle, run the instrument into something, or never end.

    Parameters
    ----------
    axis : AxisDescription
        Its section of the rig file.
    name : str
        insertion, rotation or linear.
    method : int
        How its drive searches; `HOMING_HERE` moves nothing.
    needle_mounted : bool
        Whether a needle is in the clamp.
    referenced : collection of str
        Axes that have their reference.
    limit_ma : int or None
        Limit of the output current [mA]; None keeps the drive's own.

    Raises
    ------
    SafetyStopError
        Says what to do instead.
    LimitError
        When the limit keeps the axis from feeling its stop.
    """
    if method == HOMING_HERE:
        return
    why, hint, is_other = "", "", name != "linear"
    if needle_mounted and is_other:
        why = "with a needle mounted: the search could bend it"
        hint = f"take the needle out, or set the zero where it stands: labrig devices home --axis {name} --method 35"
    elif needle_mounted and axis.homing_direction(method) > 0:
        why = "with a needle mounted: it would search towards the gel"
        hint = "take the needle out, or give the axis a method that searches backwards"
    elif is_other and "linear" not in referenced:
        why = "before the linear module: it might stand in the frame"
        hint = "first: labrig devices home --axis linear"
    if why:
        raise SafetyStopError(f"axis {name} is not homed by method {method} {why}", hint)
    threshold_ma = axis.homing_current_ma(method)
    if threshold_ma is not None and limit_ma is not None and threshold_ma >= limit_ma:
        raise LimitError(
            f"axis {name} would never feel its stop: it is felt at {threshold_ma} mA, and no drive exceeds "
            f"{limit_ma} mA (the lower one of --current-ma and max_current_ma of the rig file)",
            f"--current-ma {threshold_ma + threshold_ma // 2}, or a lower homing.current_threshold_ma",
        )
