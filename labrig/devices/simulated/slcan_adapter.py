"""A simulated USB-CAN adapter that speaks slcan (Lawicel's ASCII protocol) on a serial line.

It acknowledges each command as the adapters do: a carriage return, `z` before it after a frame, or a bell for what it
refuses. Frames pass only while its channel is open and its bit rate is that of the bus.
"""

from collections import deque
from collections.abc import Callable
from typing import Protocol

import can

from labrig.posix import open_pseudo_terminal

_OK, _REFUSED = b"\r", b"\a"
_LONGEST_LINE = 64
_BITRATES = {
    "S0": 10_000,
    "S1": 20_000,
    "S2": 50_000,
    "S3": 100_000,
    "S4": 125_000,
    "S5": 250_000,
    "S6": 500_000,
    "S7": 800_000,
    "S8": 1_000_000,
}
_FRAME_SHAPES = {"t": (3, False), "T": (8, False), "r": (3, True), "R": (8, True)}
"""Command -> hexadecimal digits of the id, whether it is a remote frame."""

_ERROR_PASSIVE = 0x20


class SerialLine(Protocol):
    """The adapter's end of a serial line; no call fails, whatever the program at the other end does."""

    @property
    def path(self) -> str:
        """The name by which programs open the other end."""

    def read(self, timeout_s: float) -> bytes:
        """Return what was written at the other end; wait at most `timeout_s` for it."""

    def write(self, data: bytes) -> None:
        """Write for the other end to read; drop `data` if nobody reads and the line is full."""

    def close(self) -> None:
        """Remove the line, as if a USB plug was pulled."""


class SlcanAdapter(can.BusABC):
    """The bus side of the adapter: `recv` returns what clients send, and `send` sends to them.

    Parameters
    ----------
    bitrate : int
        Bit rate of its bus.
    line : SerialLine or None
        The line by which it is reached; None makes a pseudo-terminal.
    """

    channel_info = "simulated slcan adapter"

    def __init__(self, bitrate: int, line: SerialLine | None = None) -> None:
        super().__init__(channel="slcan")
        self._serial: SerialLine | None = line or open_pseudo_terminal()
        self.path = self._serial.path
        self._bus_bitrate = bitrate
        self._bitrate: int | None = None
        self._line = bytearray()
        self._received: deque[can.Message] = deque()
        self._is_open = self._listens_only = False
        self._flags = 0
        self._commands: dict[str, Callable[[str], bytes]] = {
            "S": self._set_bitrate,
            "s": lambda _line: _OK,
            "O": self._open,
            "L": self._open,
            "C": self._close,
            "V": lambda _line: b"V1013\r",
            "N": lambda _line: b"NA123\r",
            "F": self._tell_flags,
        }

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - never waits
        """Pass a frame of the bus to the client."""
        if self._serial is None or not self._on_bus or msg.is_error_frame:
            return
        self._serial.write(format_frame(msg))

    def take_frames(self) -> list[can.Message]:
        """Return the frames of one reading of the line, without waiting."""
        self._read_line(0.0)
        taken = list(self._received)
        self._received.clear()
        return taken

    def unplug(self) -> None:
        """Unplug the adapter: the serial port disappears."""
        if self._serial is not None:
            self._serial.close()
            self._serial = None

    def shutdown(self) -> None:
        """Close the line."""
        super().shutdown()
        self.unplug()

    @property
    def _on_bus(self) -> bool:
        return self._is_open and self._bitrate in {None, self._bus_bitrate}

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            self._read_line(1.0 if timeout is None else timeout)
        return (self._received.popleft() if self._received else None), False

    def _read_line(self, timeout_s: float) -> None:
        if self._serial is not None:
            for byte in self._serial.read(timeout_s):
                self._take_byte(byte)

    def _take_byte(self, byte: int) -> None:
        if byte != ord("\r"):
            # A line without an end is noise; only its tail is kept.
            self._line = (self._line + bytes([byte]))[-_LONGEST_LINE:]
            return
        line = self._line.decode("ascii", errors="replace")
        self._line.clear()
        answer = self._obey(line)
        if self._serial is not None:
            self._serial.write(answer)

    def _obey(self, line: str) -> bytes:
        if not line:
            return _OK
        if line[0] in _FRAME_SHAPES:
            return self._transmit(line)
        command = self._commands.get(line[0])
        return _REFUSED if command is None else command(line)

    def _transmit(self, line: str) -> bytes:
        message = parse_frame(line)
        if message is None or not self._is_open or self._listens_only:
            return _REFUSED
        if self._on_bus:
            self._received.append(message)
        else:
            self._flags |= _ERROR_PASSIVE
        return b"Z\r" if message.is_extended_id else b"z\r"

    def _set_bitrate(self, line: str) -> bytes:
        if self._is_open or line not in _BITRATES:
            return _REFUSED
        self._bitrate = _BITRATES[line]
        return _OK

    def _open(self, line: str) -> bytes:
        if self._is_open:
            return _REFUSED
        self._is_open, self._listens_only = True, line == "L"
        return _OK

    def _close(self, _line: str) -> bytes:
        was_open, self._is_open = self._is_open, False
        return _OK if was_open else _REFUSED

    def _tell_flags(self, _line: str) -> bytes:
        flags, self._flags = self._flags, 0
        return b"F%02X\r" % flags if self._is_open else _REFUSED


def format_frame(message: can.Message) -> bytes:
    """Return a frame as a line of slcan."""
    kind = "r" if message.is_remote_frame else "t"
    shape = (
        f"{kind.upper()}{message.arbitration_id:08X}"
        if message.is_extended_id
        else (f"{kind}{message.arbitration_id:03X}")
    )
    data = "" if message.is_remote_frame else bytes(message.data).hex().upper()
    return f"{shape}{message.dlc}{data}\r".encode("ascii")


def parse_frame(line: str) -> can.Message | None:
    """Return the frame that a line of slcan sends, or None when it is not one."""
    digits, remote = _FRAME_SHAPES[line[0]]
    try:
        can_id, length = int(line[1 : 1 + digits], 16), int(line[1 + digits])
        data = b"" if remote else bytes.fromhex(line[2 + digits :])
        if len(line) < 2 + digits or length > 8 or (not remote and len(data) != length):
            return None
        return can.Message(
            arbitration_id=can_id,
            is_extended_id=digits == 8,
            is_remote_frame=remote,
            dlc=length,
            data=data,
            check=True,
        )
    except (ValueError, IndexError):
        return None
