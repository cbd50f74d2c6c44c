"""The clocks of a rig: the computer's, the same with simulated devices, and one as fast as the processor allows.

No other file of labrig reads the time or sleeps.
"""

import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime

MAX_STEP_S = 0.1
"""Longest simulated time that passes at once; the simulated world integrates over such steps."""

_READINGS = 3
"""Readings of the two clocks when rig time begins, of which one is not held up."""

_TOLD_EVERY_S = 0.005
"""Longest time of a sleep after which simulated devices are told of it; an axis goes 0.1 mm at 20 mm/s."""

_MAX_STEP_US = round(MAX_STEP_S * 1e6)


class SystemClock:
    """Rig time is the computer's monotonic time since the clock was made."""

    def __init__(self) -> None:
        self._zero_s = time.monotonic()
        self._suspended_zero_s = max(_read_suspended_s() for _ in range(_READINGS))

    def now_s(self) -> float:
        """Return the rig time [s]."""
        return time.monotonic() - self._zero_s

    def sleep(self, duration_s: float) -> None:
        """Sleep for `duration_s` seconds."""
        time.sleep(max(0.0, duration_s))

    def suspended_s(self) -> float:
        """Return for how long the computer has been suspended since [s]; 0 outside Linux, which alone can tell."""
        return _read_suspended_s() - self._suspended_zero_s

    def utc(self) -> datetime:
        """Return the calendar time in UTC."""
        return datetime.now(UTC)


def _read_suspended_s() -> float:
    """Return for how long the computer has been suspended since it was started [s]: CLOCK_MONOTONIC stands then.

    It is read last, so that a program that is held up between the two finds less, and no suspension that was none.
    """
    if not sys.platform.startswith("linux"):
        return 0.0
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)


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

    def suspended_s(self) -> float:
        """Return 0: simulated time stands still with the computer."""
        return 0.0

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

    def suspended_s(self) -> float:
        """Return for how long the computer has been suspended since [s]."""
        return self._computer.suspended_s()

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
