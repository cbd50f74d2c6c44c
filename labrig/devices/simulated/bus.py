"""A CAN bus inside the process that delivers each frame before `send` returns."""

from collections.abc import Callable

import can
import canopen

from labrig.devices.bus import CanLink


class InProcessWire:
    """What the endpoints of one bus share."""

    def __init__(self) -> None:
        self.endpoints: list[InProcessBus] = []


class InProcessBus(can.BusABC):
    """One endpoint on an in-process wire: a python-can bus to send by, a callback to receive by.

    Parameters
    ----------
    wire : InProcessWire
        The wire.
    receive : callable
        Takes each frame that another endpoint sends, while that one is sending.
    """

    channel_info = "bus inside the process"

    def __init__(self, wire: InProcessWire, receive: Callable[[can.Message], None]) -> None:
        super().__init__(channel="in-process")
        self._wire = wire
        self._receive = receive
        wire.endpoints.append(self)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - never waits
        """Deliver a frame to every other endpoint."""
        for endpoint in tuple(self._wire.endpoints):
            if endpoint is not self:
                endpoint._receive(msg)  # noqa: SLF001 - an endpoint of the same wire

    def shutdown(self) -> None:
        """Leave the wire."""
        super().shutdown()
        if self in self._wire.endpoints:
            self._wire.endpoints.remove(self)


def attach(wire: InProcessWire) -> CanLink:
    """Return a link to an in-process wire."""
    network = canopen.Network()

    def receive(message: can.Message) -> None:
        if not (message.is_error_frame or message.is_remote_frame):
            network.notify(message.arbitration_id, message.data, 0.0)

    network.bus = InProcessBus(wire, receive)
    return CanLink(network, response_timeout_s=0.0)
