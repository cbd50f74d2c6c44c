"""Whether an axis is stalled, from its motor current and its following error: a pure function of (state, reading).

What is decided here
--------------------
- An axis is stalled when its motor gives all the current that it may, and the axis lags nevertheless: the current is at
  `CURRENT_FRACTION` of the limit in force, and the following error at `LAG_FRACTION` of the one at which the drive
  itself would fail.
- One reading proves nothing: current peaks while an axis accelerates. A second one has to show both.
- A blocked axis lags by its speed times the time. It is looked at `READINGS_TO_FAULT` times until its drive would fail
  by its following error, but not more often than every `SHORTEST_PERIOD_S`: a faster axis is stopped by its drive
  first, which says following error (0x8611).
- An axis for which nobody has named a current limit has no stall, only the drive's following error: its drive's own
  limit is often one that the motor never reaches, and looking costs time.
"""

import math
from dataclasses import dataclass

from labrig.errors import STALLED, ForceGuardError

CURRENT_FRACTION = 0.8
"""Of the current limit in force."""

LAG_FRACTION = 0.5
"""Of the following error at which the drive goes to fault."""

READINGS_TO_FAULT = 4
SHORTEST_PERIOD_S = 0.01


@dataclass(frozen=True)
class StallBounds:
    """When an axis counts as stalled.

    Parameters
    ----------
    axis, unit : str
        The axis, mm or rad.
    max_following_error : float
        Following error at which its drive goes to fault [mm or rad].
    limit_ma : float
        Limit of the output current in force [mA].
    """

    axis: str
    unit: str
    max_following_error: float
    limit_ma: float

    def is_suspect(self, lag: float) -> bool:
        """Tell whether a following error [mm or rad] is worth a look at the current."""
        return abs(lag) >= LAG_FRACTION * self.max_following_error / 2

    def period_s(self, speed: float) -> float:
        """Return how often an axis in motion at this speed [mm/s or rad/s] has to be looked at [s]."""
        if not speed:
            return math.inf
        return max(SHORTEST_PERIOD_S, self.max_following_error / speed / READINGS_TO_FAULT)


@dataclass(frozen=True)
class LoadReading:
    """Following error [mm or rad] and motor current [mA] of an axis in motion, read at `t_s` of rig time."""

    t_s: float
    lag: float
    current_ma: float


def supervise_stall(
    bounds: StallBounds, since_s: float | None, reading: LoadReading
) -> tuple[float | None, ForceGuardError | None]:
    """Judge a reading of an axis in motion.

    Parameters
    ----------
    bounds : StallBounds
        The axis.
    since_s : float or None
        Since when its current has been at the limit [s]; None if it was not at the last reading.
    reading : LoadReading
        Following error and current.

    Returns
    -------
    float or None, ForceGuardError or None
        What is remembered for the next reading, and the error if the axis is stalled.
    """
    if abs(reading.current_ma) < CURRENT_FRACTION * bounds.limit_ma:
        return None, None
    if since_s is None:
        return reading.t_s, None
    if abs(reading.lag) < LAG_FRACTION * bounds.max_following_error:
        return since_s, None
    return since_s, ForceGuardError(
        f"the {bounds.axis} axis is stalled: {abs(reading.current_ma):.0f} mA for "
        f"{reading.t_s - since_s:.2f} s, {abs(reading.lag):.2g} {bounds.unit} behind",
        "find what holds the axis; its current limit is max_current_ma of the rig file or the protocol",
        fault=STALLED,
    )
