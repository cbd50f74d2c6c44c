"""Simulated slcan adapters on one bus, reached over TCP from this computer alone.

Programs open `socket://127.0.0.1:PORT`, a serial port of pySerial, so that python-can's slcan works unchanged. Each
connection is an adapter of its own on the same bus: programs see each other's frames. A connection that is not read
loses frames, as an adapter does whose buffer overflows; it delays neither the bus nor another connection.
"""

import socket
from collections import deque
from contextlib import suppress
from selectors import EVENT_READ, DefaultSelector

import can

from labrig.devices.simulated.local_ports import LOCAL_HOST
from labrig.devices.simulated.slcan_adapter import SlcanAdapter
from labrig.errors import BusError

_CHUNK_BYTES = 4096
"""Read from a connection at a time: one that sends without a pause leaves time for the others."""

_UNSENT_BYTES = 16384
"""Buffer of a connection, as small as an adapter's: a slow program does not receive frames of seconds ago."""

_MOST_ADAPTERS = 8
"""Most connections at a time; a further one is closed at once."""


class SlcanServer(can.BusABC):
    """The bus of the adapters: `recv` returns what their programs send, and `send` sends to all of them.

    Parameters
    ----------
    port : int
        TCP port to listen on.
    bitrate : int
        Bit rate of the bus [bit/s].

    Raises
    ------
    BusError
        When the port is in use or may not be used.
    """

    channel_info = "simulated slcan adapters over TCP"

    def __init__(self, port: int, bitrate: int) -> None:
        super().__init__(channel="slcan")
        self.path = f"socket://{LOCAL_HOST}:{port}"
        self._bitrate = bitrate
        self._adapters: dict[_TcpLine, SlcanAdapter] = {}
        self._waiting = DefaultSelector()
        self._received: deque[can.Message] = deque()
        self._is_unplugged = False
        try:
            self._listener = socket.create_server((LOCAL_HOST, port))
        except OSError as error:
            super().shutdown()
            raise BusError(
                f"port {port} of {LOCAL_HOST} cannot be used for the CAN bus: {error.strerror}",
                "end the program that uses it, perhaps another labrig devices simulate; or write another port in "
                "can.channel",
            ) from error
        self._listener.setblocking(False)  # noqa: FBT003 - the signature of the standard library
        self._waiting.register(self._listener, EVENT_READ)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - never waits
        """Pass a frame of the bus to every program."""
        for adapter in self._adapters.values():
            adapter.send(msg)

    def unplug(self) -> None:
        """Unplug every adapter for good: connections end, and new ones are closed at once."""
        self._is_unplugged = True
        for line in tuple(self._adapters):
            self._remove(line)

    def shutdown(self) -> None:
        """Close the connections and the port."""
        super().shutdown()
        self.unplug()
        self._waiting.close()
        self._listener.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            self._take_what_arrives(1.0 if timeout is None else timeout)
        return (self._received.popleft() if self._received else None), False

    def _take_what_arrives(self, timeout_s: float) -> None:
        for ready, _ in self._waiting.select(max(0.0, timeout_s)):
            if ready.data is None:
                self._accept()
            else:
                self._take_frames(ready.data)

    def _accept(self) -> None:
        with suppress(OSError):  # the program has gone again
            connection, _ = self._listener.accept()
            if self._is_unplugged or len(self._adapters) >= _MOST_ADAPTERS:
                connection.close()
                return
            line = _TcpLine(connection, self.path)
            self._adapters[line] = SlcanAdapter(self._bitrate, line)
            self._waiting.register(connection, EVENT_READ, line)

    def _take_frames(self, line: "_TcpLine") -> None:
        adapter = self._adapters[line]
        for frame in adapter.take_frames():
            self._received.append(frame)
            for other in self._adapters.values():
                if other is not adapter:
                    other.send(frame)
        if line.has_ended:
            self._remove(line)

    def _remove(self, line: "_TcpLine") -> None:
        self._waiting.unregister(line.socket)
        self._adapters.pop(line).shutdown()


class _TcpLine:
    """The adapter's end of a TCP connection."""

    def __init__(self, connection: socket.socket, path: str) -> None:
        connection.setblocking(False)  # noqa: FBT003 - the signature of the standard library
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT_BYTES)
        self.socket = connection
        self.path = path
        self.has_ended = False
        self._unsent = b""

    def read(self, timeout_s: float) -> bytes:  # noqa: ARG002 - the server waits for all lines at once
        """Return what has arrived."""
        try:
            data = self.socket.recv(_CHUNK_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        self.has_ended = not data
        return data

    def write(self, data: bytes) -> None:
        """Send `data`; if the end of what was sent before is still waiting, drop it."""
        if self._unsent:
            self._unsent = self._send(self._unsent)
        if not self._unsent:
            self._unsent = self._send(data)
            if self._unsent == data:  # no part of it was sent
                self._unsent = b""

    def _send(self, data: bytes) -> bytes:
        """Send what the connection takes and return the rest."""
        try:
            return data[self.socket.send(data) :]
        except OSError:
            return data

    def close(self) -> None:
        """End the connection."""
        self.socket.close()
