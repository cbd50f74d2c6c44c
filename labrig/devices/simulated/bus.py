"""A CAN bus inside the process that delivers each frame before `send` returns."""

from collections.abc import Callable

import can

from labrig.clock import Clock
from labrig.devices.bus import BusNetwork, CanLink

_BUS_OFF_ID, _CONTROLLER_ID = 0x040, 0x004
"""Ids of SocketCAN's error frames for bus off and for the state of the controller."""

_PASSIVE = bytes([0, 0x20, 0, 0, 0, 0, 0, 0])


class InProcessWire:
    """The medium that the endpoints of a bus share, and the faults on it."""

    def __init__(self) -> None:
        self.endpoints: list[InProcessBus] = []
        self._now_s = 0.0
        self._losses = self._copies = self._delays = 0
        self._delay_s = 0.0
        self._late: list[tuple[float, InProcessBus, can.Message]] = []
        self._dead = self._unplugged = False
        self.before_command: Callable[[], None] = lambda: None
        """Called before a frame of labrig's adapter is carried."""

    def lose(self, frames: int) -> None:
        """Lose the next frames."""
        self._losses += frames

    def duplicate(self, frames: int) -> None:
        """Deliver each of the next frames twice."""
        self._copies += frames

    def delay(self, frames: int, delay_s: float) -> None:
        """Delay the next frames, possibly behind later ones."""
        self._delays, self._delay_s = self._delays + frames, delay_s

    def enter_bus_off(self) -> None:
        """Block every frame from now on; the adapter reports it by an error frame."""
        self._dead = True
        self._tell_adapters(_BUS_OFF_ID, bytes(8))

    def enter_error_passive(self) -> None:
        """Let the adapter report error passive; frames still pass."""
        self._tell_adapters(_CONTROLLER_ID, _PASSIVE)

    def _tell_adapters(self, can_id: int, data: bytes) -> None:
        frame = can.Message(arbitration_id=can_id, is_error_frame=True, is_extended_id=False, data=data)
        for endpoint in tuple(self.endpoints):
            if endpoint.is_adapter:
                endpoint.take(frame)

    def unplug(self) -> None:
        """Unplug the adapter: sending fails, and it receives nothing."""
        self._unplugged = True

    def restore(self) -> None:
        """Restore the bus."""
        self._dead = self._unplugged = False
        self._losses = self._copies = self._delays = 0

    def carry(self, sender: "InProcessBus", message: can.Message) -> None:
        """Carry a frame from one endpoint to all others.

        Raises
        ------
        can.CanOperationError
            When the sender is an unplugged adapter.
        """
        if self._unplugged and sender.is_adapter:
            raise can.CanOperationError("the adapter has been unplugged")
        if sender.is_adapter:
            self.before_command()
        if self._dead:
            return
        if self._losses:
            self._losses -= 1
        elif self._delays:
            self._delays -= 1
            self._late.append((self._now_s + self._delay_s, sender, message))
        else:
            self._deliver(sender, message)
            if self._copies:
                self._copies -= 1
                self._deliver(sender, message)

    def tick(self, now_s: float) -> None:
        """Deliver the late frames that are due."""
        self._now_s = now_s
        if self._late:
            due = [held for held in self._late if held[0] <= now_s]
            self._late = [held for held in self._late if held[0] > now_s]
            for _, sender, message in due:
                if not self._dead:
                    self._deliver(sender, message)

    def _deliver(self, sender: "InProcessBus", message: can.Message) -> None:
        for endpoint in tuple(self.endpoints):
            if endpoint is not sender and not (self._unplugged and endpoint.is_adapter):
                endpoint.take(message)


class InProcessBus(can.BusABC):
    """One endpoint on an in-process wire: a python-can bus to send by, a callback to receive by.

    Parameters
    ----------
    wire : InProcessWire
        The wire.
    receive : callable
        Takes each frame of another endpoint, during its send.
    is_adapter : bool
        Whether this is the computer's adapter, which reports bus off and can be unplugged.
    """

    channel_info = "bus inside the process"

    def __init__(
        self, wire: InProcessWire, receive: Callable[[can.Message], None], *, is_adapter: bool = False
    ) -> None:
        super().__init__(channel="in-process")
        self.is_adapter = is_adapter
        self.take = receive
        self._wire = wire
        wire.endpoints.append(self)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - never waits
        """Deliver a frame to every other endpoint."""
        self._wire.carry(self, msg)

    def shutdown(self) -> None:
        """Leave the wire."""
        super().shutdown()
        if self in self._wire.endpoints:
            self._wire.endpoints.remove(self)


def attach(wire: InProcessWire, clock: Clock, answer_timeout_s: float) -> CanLink:
    """Return a link to an in-process wire; time of `clock` passes while it waits for a late answer."""
    network = BusNetwork(clock)

    def receive(message: can.Message) -> None:
        if message.is_error_frame:
            network.take_error_frame(message.arbitration_id, bytes(message.data))
        elif not message.is_remote_frame:
            network.notify(message.arbitration_id, message.data, 0.0)

    network.bus = InProcessBus(wire, receive, is_adapter=True)
    return CanLink(network, clock, answer_timeout_s, in_process=True)
