"""A CAN bus inside the process that delivers each frame before `send` returns."""

from collections.abc import Callable

import can

from labrig.clock import Clock
from labrig.devices.bus import BusNetwork, CanLink

_BUS_OFF_ID = 0x040
"""Id of SocketCAN's error frame for bus off."""


class InProcessWire:
    """The medium that the endpoints of a bus share, and the faults on it.

    Attributes
    ----------
    before_command : callable
        Called before a frame of labrig's adapter is carried.
    catchers : list of callable
        Each is told (sender, frame), and returns whether it keeps the frame from being delivered; a test may deliver it
        later, or twice.
    """

    def __init__(self) -> None:
        self.endpoints: list[InProcessBus] = []
        self.before_command: Callable[[], None] = lambda: None
        self.catchers: list[Callable[[InProcessBus, can.Message], bool]] = []
        self._dead = self._unplugged = False

    def enter_bus_off(self) -> None:
        """Block every frame from now on; the adapter reports it by an error frame."""
        self._dead = True
        self.report(_BUS_OFF_ID, bytes(8))

    def report(self, can_id: int, data: bytes) -> None:
        """Let labrig's adapter report a state of the bus by an error frame."""
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
        self.catchers.clear()

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
        if not any(catches(sender, message) for catches in tuple(self.catchers)):
            self.deliver(sender, message)

    def deliver(self, sender: "InProcessBus", message: can.Message) -> None:
        """Deliver a frame now, unless the bus is off."""
        for endpoint in () if self._dead else tuple(self.endpoints):
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
