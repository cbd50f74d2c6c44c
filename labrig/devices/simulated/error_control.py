"""Error control of a simulated drive (CiA 301): its own heartbeat, and the loss of its master's."""

import math
from collections.abc import Callable

from labrig.devices import canopen_objects as co
from labrig.devices.simulated.dictionary import ObjectDictionary


class ErrorControl:
    """Producer and consumer heartbeat, node guarding and life guarding of one node.

    Parameters
    ----------
    objects : ObjectDictionary
        Holds the times.
    answer : callable
        Sends the byte of a heartbeat or a guarding answer; its argument is added to the NMT state.
    lost : callable
        Called with the instant at which the master was lost.
    """

    def __init__(
        self, objects: ObjectDictionary, answer: Callable[[int], None], lost: Callable[[float], None]
    ) -> None:
        self._objects = objects
        self._answer = answer
        self._lost = lost
        self._next_beat_s = math.inf
        self._heard_s: dict[int, float] = {}
        self._consumed: dict[int, float] = {}
        self._guarded_s: float | None = None
        self._toggle = 0
        self.mute = False
        self.configure(0.0)

    def configure(self, now_s: float) -> None:
        """Read the times from the object dictionary again; monitoring starts with the next heartbeat."""
        values = self._objects.values
        watched = (values[co.CONSUMER_HEARTBEAT], values[co.CONSUMER_HEARTBEAT_2])
        self._consumed = {value >> 16 & 0x7F: (value & 0xFFFF) / 1000 for value in watched if value & 0xFFFF}
        self._heard_s = {node: t for node, t in self._heard_s.items() if node in self._consumed}
        self._next_beat_s = now_s if values[co.PRODUCER_HEARTBEAT] else math.inf

    def start(self, now_s: float) -> None:
        """Start again, as after a boot-up."""
        self._heard_s.clear()
        self._guarded_s, self._toggle = None, 0
        self.configure(now_s)

    def hear(self, node_id: int, now_s: float) -> None:
        """Receive the heartbeat of another node."""
        if node_id in self._consumed:
            self._heard_s[node_id] = now_s

    def guard(self, now_s: float) -> None:
        """Answer a guarding request, unless this node sends heartbeats."""
        if self._objects.values[co.PRODUCER_HEARTBEAT]:
            return
        self._guarded_s = now_s
        self._answer(self._toggle)
        self._toggle ^= 0x80

    def tick(self, now_s: float) -> None:
        """Send the heartbeats that are due, and report a master that has been silent for too long."""
        while self._next_beat_s <= now_s:
            period_s = self._objects.values[co.PRODUCER_HEARTBEAT] / 1000
            self._next_beat_s = round(self._next_beat_s + period_s, 6)
            if not self.mute:
                self._answer(0)
        for node, heard_s in tuple(self._heard_s.items()):
            deadline_s = heard_s + self._consumed[node]
            if now_s > deadline_s:
                del self._heard_s[node]
                self._lost(deadline_s)
        if self._guarded_s is not None:
            self._tick_guarding(now_s, self._guarded_s)

    def _tick_guarding(self, now_s: float, guarded_s: float) -> None:
        values = self._objects.values
        life_s = values[co.GUARD_TIME] * values[co.LIFE_TIME_FACTOR] / 1000
        if life_s and now_s > guarded_s + life_s:
            self._guarded_s = None
            self._lost(guarded_s + life_s)
