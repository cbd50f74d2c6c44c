"""What a clock is: rig time that can be read and waited for.

Rig time is in seconds, starts at zero when the rig is opened, and never goes back. Real clocks and the simulated one
live in `devices/`; nothing else in labrig reads the time or sleeps.
"""

from datetime import datetime
from typing import Protocol


class Clock(Protocol):
    """Rig time, and the calendar time that provenance needs."""

    def now_s(self) -> float:
        """Return the rig time [s]."""

    def sleep(self, duration_s: float) -> None:
        """Let `duration_s` seconds of rig time pass."""

    def utc(self) -> datetime:
        """Return the calendar time, aware, in UTC."""
