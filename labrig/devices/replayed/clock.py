"""The clock of a replay: passes as the record does."""

from collections.abc import Callable
from datetime import datetime


class ReplayedClock:
    """Rig time that passes when somebody sleeps, and that is taken to the time of each recorded CAN frame.

    It counts microseconds, as the simulated clock and can.log do, so that a simulated record gives the very times.

    Parameters
    ----------
    started : datetime
        Calendar time of the session.
    """

    def __init__(self, started: datetime) -> None:
        self.now_us = 0
        self._started = started
        self._arrive: Callable[[int], None] = lambda _until_us: None

    def on_sleep(self, arrive: Callable[[int], None]) -> None:
        """Let `arrive` bring what the record has until a time [us], before that time is reached."""
        self._arrive = arrive

    def now_s(self) -> float:
        """Return the rig time [s]."""
        return self.now_us / 1e6

    def sleep(self, duration_s: float) -> None:
        """Let rig time pass, with what arrived meanwhile."""
        end_us = self.now_us + round(duration_s * 1e6)
        self.pass_until(end_us)

    def pass_until(self, end_us: int) -> None:
        """Let time pass until `end_us`; a time that has passed already changes nothing."""
        self._arrive(end_us)
        self.reach(end_us)

    def reach(self, time_us: int) -> None:
        """Go on to a time; never back."""
        self.now_us = max(self.now_us, time_us)

    def suspended_s(self) -> float:
        """Return 0: a record does not hold it."""
        return 0.0

    def utc(self) -> datetime:
        """Return the calendar time at which the session was started."""
        return self._started
