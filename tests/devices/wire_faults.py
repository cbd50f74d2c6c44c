"""What can happen to the next frames on the wire of a simulated rig, and when the computer has beaten on it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise

import can

from labrig.clock import Clock
from labrig.devices.clocks import SimulatedClock
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from tests.devices.rigs import OpenedRig, instants

FOR_GOOD = 10**9
ERROR_PASSIVE = (0x004, bytes([0, 0x20, 0, 0, 0, 0, 0, 0]))
"""Error frame by which SocketCAN tells that its controller is error passive."""


def catch_next(
    wire: InProcessWire,
    frames: int = 1,
    then: Callable[[InProcessBus, can.Message], object] = lambda _sender, _frame: None,
    of: Callable[[can.Message], bool] = lambda _frame: True,
) -> None:
    """Keep the next frames from being delivered, and do something else with them; by default they are lost."""
    left = frames

    def catch(sender: InProcessBus, frame: can.Message) -> bool:
        nonlocal left
        if left == 0 or not of(frame):
            return False
        left -= 1
        then(sender, frame)
        return True

    wire.catchers.append(catch)


def duplicate_next(wire: InProcessWire) -> None:
    """Deliver the next frame twice."""

    def deliver_twice(sender: InProcessBus, frame: can.Message) -> None:
        for _ in range(2):
            wire.deliver(sender, frame)

    catch_next(wire, 1, deliver_twice)


def delay_next(wire: InProcessWire, clock: Clock, frames: int, delay_s: float) -> None:
    """Deliver the next frames late, possibly behind later ones."""
    late: list[tuple[float, InProcessBus, can.Message]] = []

    def deliver_due() -> None:
        while late and late[0][0] <= clock.now_s():
            wire.deliver(*late.pop(0)[1:])

    catch_next(wire, frames, lambda sender, frame: late.append((clock.now_s() + delay_s, sender, frame)))
    assert isinstance(clock, SimulatedClock)
    clock.on_advance(deliver_due)


def ignore_next(wire: InProcessWire, drive: SimulatedCia402Drive, requests: int = 1) -> None:
    """Let a drive miss the next SDO requests."""
    catch_next(wire, requests, of=lambda frame: frame.arbitration_id == 0x600 + drive.node_id)


def abort_next(wire: InProcessWire, drive: SimulatedCia402Drive, code: int, index: int | None = None) -> None:
    """Let a drive refuse the next SDO request, or the next one for an object, with an abort code."""

    def is_it(frame: can.Message) -> bool:
        is_asked = index in {None, int.from_bytes(frame.data[1:3], "little")}
        return is_asked and frame.arbitration_id == 0x600 + drive.node_id

    def refuse(_sender: InProcessBus, frame: can.Message) -> None:
        drive.send(0x580 + drive.node_id, b"\x80" + frame.data[1:4] + code.to_bytes(4, "little"))

    catch_next(wire, 1, refuse, is_it)


def stop_heartbeat(wire: InProcessWire, drive: SimulatedCia402Drive) -> None:
    """Stop the heartbeat of a drive; everything else continues."""
    catch_next(wire, FOR_GOOD, of=lambda frame: frame.arbitration_id == 0x700 + drive.node_id)


def deafen(drive: SimulatedCia402Drive) -> None:
    """Let a drive receive nothing."""
    drive.line.take = lambda _frame: None


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


def send_as_other(opened: OpenedRig, *frames: tuple[int, bytes]) -> None:
    """Send frames as another program on the bus does."""
    master = InProcessBus(opened.hardware.wire, lambda _message: None)
    for can_id, data in frames:
        master.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
    master.shutdown()


def require_no_fault(opened: OpenedRig) -> None:
    """Require that no drive has reported an error."""
    assert not any(instants(drive, "emergency") for drive in opened.drives.values())
