"""The computer's heartbeat: the drives stop by themselves when it stops.

Each heartbeat is one frame, sent while rig time passes, and only while nothing is wrong. There is no timer, and no
thread but the one that supervises can send it: a labrig that hangs, is stopped or is killed sends none. (With
python-can's periodic sending the kernel would continue while the program is stopped.)

A long exchange with drives, such as opening a rig, sends the beats that are due between two answers, and none while a
drive does not answer. It may do so for `LONGEST_EXCHANGE_S` after somebody has supervised last: an exchange without end
is no supervision.
"""

import math
from datetime import datetime
from threading import get_ident

from labrig.clock import Clock
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.errors import HEARTBEAT_LOST, InterruptedRunError, MachineError, fault_of

Ended = InterruptedRunError | MachineError
"""Whatever ends what a rig does."""

_OPERATIONAL = b"\x05"
_EARLY_S = 1e-6
LONGEST_EXCHANGE_S = 3.0
"""Time after supervision for which an exchange with drives may send beats [s].

The longest one starts three axes at once: 19 SDO transactions and waits each, 1.9 s in all if an answer takes 20 ms.
"""

_RECENT_S = 5.0
"""A gap that ended longer ago explains nothing any more [s]."""


class HeartbeatClock:
    """A clock that sends heartbeats while it waits.

    Parameters
    ----------
    clock : Clock
        Rig time.
    link : CanLink
        Where the heartbeats go.
    heartbeat : HeartbeatDescription
        How often, and as which node.
    """

    def __init__(self, clock: Clock, link: CanLink, heartbeat: HeartbeatDescription) -> None:
        self._clock = clock
        self._link = link
        self._period_s = heartbeat.period_ms / 1000
        self._timeout_s = heartbeat.timeout_ms / 1000
        self._can_id = 0x700 + heartbeat.computer_node_id
        self._last_s = -math.inf
        self._gap_end_s, self._gap_s = -math.inf, 0.0
        self._is_silent = self._has_lost_drives = False
        self._supervised_s = clock.now_s()
        self._thread = get_ident()

    def now_s(self) -> float:
        """Return the rig time [s]."""
        return self._clock.now_s()

    def utc(self) -> datetime:
        """Return the calendar time in UTC."""
        return self._clock.utc()

    def sleep(self, duration_s: float) -> None:
        """Let rig time pass, and send heartbeats meanwhile, as `attend` does; the first one too."""
        steps = max(1, math.ceil(duration_s / self._period_s - _EARLY_S))
        for _ in range(steps):
            self._clock.sleep(duration_s / steps)
            self._send_if_supervised()

    def beat(self) -> None:
        """Send a heartbeat if one is due: nothing is wrong. Only a supervisor calls it. Raises `BusError`."""
        self.note_supervision()
        self._send_if_due(self._supervised_s)

    def attend(self) -> None:
        """Send a heartbeat if one is due, the first has been sent, no drive is lost, and somebody supervised of late.

        Raises `BusError`.
        """
        if self._last_s >= 0:
            self._send_if_supervised()

    def note_supervision(self) -> None:
        """Note that somebody supervises now: a long exchange with drives may follow."""
        self._supervised_s, self._has_lost_drives = self.now_s(), False

    def note_loss(self) -> None:
        """Note that a drive is lost: what stops it and the others does not keep it moving by beats."""
        self._has_lost_drives = True

    def _send_if_supervised(self) -> None:
        now_s = self.now_s()
        if not self._has_lost_drives and now_s - self._supervised_s <= LONGEST_EXCHANGE_S:
            self._send_if_due(now_s)

    def _send_if_due(self, now_s: float) -> None:
        if now_s - self._last_s < self._period_s - _EARLY_S or self._is_silent or not self._link.carries:
            return
        if get_ident() != self._thread:
            return
        if (gap_s := self._since_beat_s(now_s)) > self._timeout_s:
            self._gap_end_s, self._gap_s = now_s, gap_s
        self._last_s = now_s
        self._link.send(self._can_id, _OPERATIONAL)

    def explain(self, error: Ended) -> Ended:
        """Blame what a gap in labrig's own heartbeat has caused on what held labrig up, not on wiring or drives.

        A program that is stopped, a computer that is suspended, and a labrig that waits for a disk show in it: a gap
        now or just before, at which the drives stop.
        """
        fault, now_s = fault_of(error), self.now_s()
        gap_s = max(self._since_beat_s(now_s), self._gap_s if now_s - self._gap_end_s <= _RECENT_S else 0.0)
        if fault is None or fault.code != HEARTBEAT_LOST.code or gap_s <= self._timeout_s:
            return error
        return error.reword(
            f"labrig itself stood still for {gap_s:.1f} s, so the drives stopped by themselves: {error.message}",
            "find out what held labrig up: Ctrl+Z, a debugger, a suspended computer (systemd-inhibit keeps it awake), "
            "a disk that hangs; then start again",
        )

    def _since_beat_s(self, now_s: float) -> float:
        """Return for how long no heartbeat was sent [s]; 0 before the first one."""
        return 0.0 if self._last_s < 0 else now_s - self._last_s

    def silence(self) -> None:
        """Send no more heartbeats, so that every drive stops by itself: the last resort if stopping may have failed."""
        self._is_silent = True
