"""Listens for the beats of the computer on a simulated bus."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise

import can

from labrig.devices.simulated.bus import InProcessBus
from tests.devices.rigs import OpenedRig, instants


@dataclass
class Heard:
    """The beats on a bus [s]."""

    times_s: list[float] = field(default_factory=list)

    @property
    def longest_gap_s(self) -> float:
        """The longest time between two beats [s]."""
        return max(later - earlier for earlier, later in pairwise(self.times_s))


@contextmanager
def listening(opened: OpenedRig) -> Iterator[Heard]:
    """Listen on the wire for the beats of the computer."""
    heard, clock = Heard(), opened.hardware.clock

    def hear(message: can.Message) -> None:
        if message.arbitration_id == 0x77F:
            heard.times_s.append(clock.now_s())

    tap = InProcessBus(opened.hardware.wire, hear)
    yield heard
    tap.shutdown()


def require_no_fault(opened: OpenedRig) -> None:
    """Require that no drive has reported an error."""
    assert not any(instants(drive, "emergency") for drive in opened.drives.values())
