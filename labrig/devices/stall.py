"""Whether an axis is stalled, from its motor current and its following error.

What is decided here
--------------------
- An axis is stalled when its motor gives all the current that it may, and the axis lags nevertheless: the current is at
  `CURRENT_FRACTION` of the limit in force, and the following error at `LAG_FRACTION` of the one at which the drive
  itself would fail.
- One reading proves nothing: current peaks while an axis accelerates. A second one has to show both.
- A blocked axis lags by its speed times the time. It is looked at `READINGS_TO_FAULT` times until its drive would fail
  by its following error, but not more often than every `SHORTEST_PERIOD_S`: a faster axis is stopped by its drive
  first, which says following error (0x8611).
- The following error is asked for first, and the current only of an axis that lags.
- An axis for which nobody has named a current limit has no stall, only the drive's following error: its drive's own
  limit is often one that the motor never reaches, and looking costs time.
"""

import math
from contextlib import suppress

from labrig.devices.axis import Axis
from labrig.errors import STALLED, ForceGuardError, MachineError

CURRENT_FRACTION = 0.8
"""Of the current limit in force."""

LAG_FRACTION = 0.5
"""Of the following error at which the drive goes to fault."""

READINGS_TO_FAULT = 4
SHORTEST_PERIOD_S = 0.01
_EARLY_S = 1e-6


class StallWatch:
    """Watches one axis, and stops it quickly when it is stalled.

    Parameters
    ----------
    axis : Axis
        The axis.
    limit_ma : float
        Limit of its output current in force [mA].
    """

    def __init__(self, axis: Axis, limit_ma: float) -> None:
        self._axis = axis
        self._limit_ma = limit_ma
        self._max_lag = axis.description.max_following_error
        self._looked_s = -math.inf
        self._since_s: float | None = None

    @property
    def period_s(self) -> float:
        """How often the axis has to be looked at [s]."""
        speed = self._axis.speed
        return max(SHORTEST_PERIOD_S, self._max_lag / speed / READINGS_TO_FAULT) if speed else math.inf

    def look(self, now_s: float) -> None:
        """Look at the axis if it moves and it is time to. Raises `ForceGuardError`, `DriveError`, `BusError`."""
        period_s = self.period_s
        if math.isinf(period_s):
            self._since_s = None
        elif now_s - self._looked_s >= period_s - _EARLY_S:
            self._looked_s = now_s
            lag = self._axis.drive.reports.lag() or 0.0
            lags = abs(lag) >= LAG_FRACTION * self._max_lag / 2
            self.judge(now_s, lag, (self._axis.drive.reports.current_ma() or 0.0) if lags else 0.0)

    def judge(self, t_s: float, lag: float, current_ma: float) -> None:
        """Judge the following error [mm or rad] and the motor current [mA], read at `t_s` of rig time.

        Raises
        ------
        ForceGuardError
            When the axis is stalled; it has been stopped.
        """
        if abs(current_ma) < CURRENT_FRACTION * self._limit_ma:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = t_s
        elif abs(lag) >= LAG_FRACTION * self._max_lag:
            # A halt brakes as slowly as a move does: it would push on, and let the drive fail by its following error.
            with suppress(MachineError):
                self._axis.drive.stop(quick=True)
            raise ForceGuardError(
                f"the {self._axis.name} axis is stalled: {abs(current_ma):.0f} mA for {t_s - self._since_s:.2f} s, "
                f"{abs(lag):.2g} {self._axis.unit} behind",
                "find what holds the axis; its current limit is max_current_ma of the rig file or the protocol",
                fault=STALLED,
            )
