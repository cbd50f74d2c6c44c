"""Simulated USB-CAN adapters that speak slcan (Lawicel's ASCII protocol), reached over TCP from this computer alone.

Programs open `socket://127.0.0.1:PORT`, a serial port of pySerial, so that python-can's slcan works unchanged. Each
connection is an adapter of its own on the same bus: programs see each other's frames. An adapter acknowledges each
command with a carriage return, `z` before it after a frame, or a bell for what it refuses. Frames pass only while its
channel is open and its bit rate is that of the bus. A connection that is not read loses frames, as an adapter does
whose buffer overflows; it delays neither the bus nor another connection.
"""

import socket
from collections import deque
from contextlib import suppress
from selectors import EVENT_READ, DefaultSelector

import can

from labrig.errors import BusError

_HOST = "127.0.0.1"
_BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""Those of the commands S0 to S8 [bit/s]."""

_OK, _REFUSED = b"\r", b"\a"
_LONGEST_LINE = 64
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
        TCP port to listen on; 0 takes one that is free, and `path` names it.
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
        self._bitrate = bitrate
        self._adapters: list[_Adapter] = []
        self._waiting = DefaultSelector()
        self._received: deque[can.Message] = deque()
        self._is_unplugged = False
        try:
            self._listener = socket.create_server((_HOST, port))
        except OSError as error:
            super().shutdown()
            raise BusError(
                f"port {port} of {_HOST} cannot be used for the CAN bus: {error.strerror}",
                "end the program that uses it, perhaps another labrig devices simulate; or give another --port",
            ) from error
        self.path = f"socket://{_HOST}:{self._listener.getsockname()[1]}"
        self._listener.setblocking(False)  # noqa: FBT003 - the signature of the standard library
        self._waiting.register(self._listener, EVENT_READ)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - never waits
        """Pass a frame of the bus to every program."""
        for adapter in self._adapters:
            adapter.send(msg)

    def unplug(self) -> None:
        """Unplug every adapter for good: connections end, and new ones are closed at once."""
        self._is_unplugged = True
        for adapter in self._adapters:
            self._waiting.unregister(adapter.connection)
            with suppress(OSError):  # the program has gone
                adapter.connection.shutdown(socket.SHUT_RDWR)

    def shutdown(self) -> None:
        """Close the connections and the port."""
        super().shutdown()
        for adapter in self._adapters:
            adapter.connection.close()
        self._waiting.close()
        self._listener.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            for ready, _ in self._waiting.select(1.0 if timeout is None else max(0.0, timeout)):
                if ready.data is None:
                    self._accept()
                else:
                    self._take_frames(ready.data)
        return (self._received.popleft() if self._received else None), False

    def _accept(self) -> None:
        with suppress(OSError):  # the program has gone again
            connection, _ = self._listener.accept()
            if self._is_unplugged or len(self._adapters) >= _MOST_ADAPTERS:
                connection.close()
                return
            adapter = _Adapter(connection, self._bitrate)
            self._adapters.append(adapter)
            self._waiting.register(connection, EVENT_READ, adapter)

    def _take_frames(self, adapter: "_Adapter") -> None:
        for frame in adapter.take_frames():
            self._received.append(frame)
            for other in self._adapters:
                if other is not adapter:
                    other.send(frame)
        if adapter.has_ended:
            self._adapters.remove(adapter)
            self._waiting.unregister(adapter.connection)
            adapter.connection.close()


class _Adapter:
    """One connection: what its program asks for, and what it is sent."""

    def __init__(self, connection: socket.socket, bus_bitrate: int) -> None:
        connection.setblocking(False)  # noqa: FBT003 - the signature of the standard library
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT_BYTES)
        self.connection = connection
        self.has_ended = False
        self._bus_bitrate = bus_bitrate
        self._bitrate = bus_bitrate
        self._is_open = False
        self._line = b""
        self._unsent = b""

    def take_frames(self) -> list[can.Message]:
        """Obey what has arrived, and return the frames among it that reach the bus."""
        try:
            data = self.connection.recv(_CHUNK_BYTES)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        self.has_ended = not data
        *lines, rest = (self._line + data).split(b"\r")
        self._line = rest[-_LONGEST_LINE:]  # a line without an end is noise
        frames = []
        for line in lines:
            frame = parse_frame(line)
            if frame is None or not self._is_open:
                self._write(self._obey(line))
                continue
            self._write(b"z\r")
            if self._bitrate == self._bus_bitrate:
                frames.append(frame)
        return frames

    def _obey(self, line: bytes) -> bytes:
        """Do what a line asks for that is no frame, and return the answer."""
        command, rest = line[:1], line[1:]
        if command == b"S" and rest.isdigit() and int(rest) < len(_BITRATES) and not self._is_open:
            self._bitrate = _BITRATES[int(rest)]
        elif line in {b"O", b"C"} and self._is_open == (line == b"C"):
            self._is_open = line == b"O"
        elif line:
            return {b"V": b"V1013\r", b"N": b"NA123\r"}.get(line, _REFUSED)
        return _OK

    def send(self, message: can.Message) -> None:
        """Pass a frame of the bus to the program."""
        if self._is_open and self._bitrate == self._bus_bitrate:
            self._write(format_frame(message))

    def _write(self, data: bytes) -> None:
        """Send `data`; if the end of what was sent before is still waiting, drop it."""
        self._unsent = self._send(self._unsent)
        if not self._unsent:
            left = self._send(data)
            self._unsent = b"" if left == data else left

    def _send(self, data: bytes) -> bytes:
        """Send what the connection takes and return the rest."""
        try:
            return data[self.connection.send(data) :]
        except OSError:
            return data


def format_frame(message: can.Message) -> bytes:
    """Return a frame with an id of 11 bits, as all of CANopen are, as a line of slcan."""
    kind, data = ("r", "") if message.is_remote_frame else ("t", bytes(message.data).hex().upper())
    return f"{kind}{message.arbitration_id:03X}{message.dlc}{data}\r".encode("ascii")


def parse_frame(line: bytes) -> can.Message | None:
    """Return the frame that a line of slcan sends, or None when it is not one."""
    remote = line[:1] == b"r"
    try:
        can_id, length, data = int(line[1:4], 16), int(line[4:5]), bytes.fromhex(line[5:].decode("ascii"))
        if line[:1] not in {b"t", b"r"} or len(data) != (0 if remote else length):
            return None
        return can.Message(
            arbitration_id=can_id,
            is_extended_id=False,
            is_remote_frame=remote,
            dlc=length,
            data=data,
            check=True,
        )
    except ValueError:
        return None
