"""The clocks of a rig: the computer's, the same with simulated devices, and one as fast as the processor allows.

No other file of labrig reads the time or sleeps.
"""

import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime

MAX_STEP_S = 0.1
"""Longest simulated time that passes at once; the simulated world integrates over such steps."""

_TOLD_EVERY_S = 0.005
"""Longest time of a sleep after which simulated devices are told of it; an axis goes 0.1 mm at 20 mm/s."""

_MAX_STEP_US = round(MAX_STEP_S * 1e6)


if sys.platform.startswith("linux"):

    def _read_clock_s() -> float:
        """Return the computer's monotonic time [s], which goes on while the computer is suspended, as drives do."""
        return time.clock_gettime(time.CLOCK_BOOTTIME)
else:
    _read_clock_s = time.monotonic


class SystemClock:
    """Rig time is the computer's monotonic time since the clock was made."""

    def __init__(self) -> None:
        self._zero_s = _read_clock_s()

    def now_s(self) -> float:
        """Return the rig time [s]."""
        return _read_clock_s() - self._zero_s

    def sleep(self, duration_s: float) -> None:
        """Sleep for `duration_s` seconds."""
        time.sleep(max(0.0, duration_s))

    def utc(self) -> datetime:
        """Return the calendar time in UTC."""
        return datetime.now(UTC)


class SimulatedClock:
    """Rig time passes only during a sleep.

    It is counted in microseconds, so that rounding does not accumulate. Calendar time is not simulated: provenance
    says when the run was really made.
    """

    def __init__(self) -> None:
        self._now_us = 0
        self._listeners: list[Callable[[], None]] = []

    def now_s(self) -> float:
        """Return the simulated time [s]."""
        return self._now_us / 1e6

    def on_advance(self, listener: Callable[[], None]) -> None:
        """Call `listener` after each step of time, in the order in which listeners were added."""
        self._listeners.append(listener)

    def sleep(self, duration_s: float) -> None:
        """Let `duration_s`, in whole microseconds, pass in steps of at most `MAX_STEP_S`."""
        end_us = self._now_us + round(duration_s * 1e6)
        while self._now_us < end_us:
            self._now_us = min(self._now_us + _MAX_STEP_US, end_us)
            for listener in self._listeners:
                listener()

    def utc(self) -> datetime:
        """Return the calendar time in UTC."""
        return datetime.now(UTC)


class WatchedClock(SimulatedClock):
    """The computer's time, for a rehearsal: simulated devices are told of it in the thread that waits or commands."""

    def __init__(self) -> None:
        super().__init__()
        self._computer = SystemClock()

    def now_s(self) -> float:
        """Return the rig time [s]."""
        return self._computer.now_s()

    def tell(self) -> None:
        """Tell the listeners that time has passed."""
        for listener in self._listeners:
            listener()

    def sleep(self, duration_s: float) -> None:
        """Sleep for `duration_s` seconds, and tell the listeners before, meanwhile and at the end."""
        end_s = self.now_s() + duration_s
        self.tell()
        while (left_s := end_s - self.now_s()) > 0:
            self._computer.sleep(min(left_s, _TOLD_EVERY_S))
            self.tell()
