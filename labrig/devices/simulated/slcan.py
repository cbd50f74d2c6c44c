"""A simulated USB-CAN adapter that speaks slcan (Lawicel's ASCII protocol) on a serial line.

A program opens the line as it opens a real adapter. Each command is acknowledged with a carriage return, `z` before it
after a frame, or a bell for what is refused. Data frames pass while the channel is open, at whatever bit rate. A
program that does not read loses frames, as with an adapter whose buffer overflows; the bus is not delayed.
"""

import os
import re
import tty
from collections import deque
from selectors import EVENT_READ, DefaultSelector

import can

_FRAME = re.compile(rb"t([0-7][0-9A-Fa-f]{2})([0-8])((?:[0-9A-Fa-f]{2})*)")
_BIT_RATE = re.compile(rb"S[0-8]")

_OK, _REFUSED = b"\r", b"\a"
_LONGEST_LINE = 64
_CHUNK_BYTES = 4096


class SlcanAdapter(can.BusABC):
    """The bus of the adapter: `recv` returns what the program sends, and `send` sends to it."""

    channel_info = "simulated slcan adapter"

    def __init__(self) -> None:
        super().__init__(channel="slcan")
        self._is_open = False
        self._line = self._unsent = b""
        self._received: deque[can.Message] = deque()
        # Its other end is kept open too: the line stays when a program closes it.
        self._end, self._other = os.openpty()
        tty.setraw(self._other)
        os.set_blocking(self._end, False)
        self.path = os.ttyname(self._other)
        self._waiting = DefaultSelector()
        self._waiting.register(self._end, EVENT_READ)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - never waits
        """Pass a frame of the bus to the program."""
        if self._is_open:
            self._write(format_frame(msg))

    def shutdown(self) -> None:
        """Close the line for good, as an adapter does that is unplugged."""
        super().shutdown()
        if self._end >= 0:
            self._waiting.close()
            os.close(self._end)
            os.close(self._other)
            self._end = -1

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received and self._end >= 0 and self._waiting.select(timeout):
            *lines, rest = (self._line + os.read(self._end, _CHUNK_BYTES)).split(b"\r")
            self._line = rest[-_LONGEST_LINE:]  # a line without an end is noise
            for line in lines:
                self._take(line)
        return (self._received.popleft() if self._received else None), False

    def _take(self, line: bytes) -> None:
        frame = parse_frame(line)
        if frame is None or not self._is_open:
            self._write(self._obey(line))
            return
        self._write(b"z\r")
        self._received.append(frame)

    def _obey(self, line: bytes) -> bytes:
        """Do what a line asks for that is no frame, and return the answer."""
        if line in {b"O", b"C"} and self._is_open == (line == b"C"):
            self._is_open = line == b"O"
        elif line and (self._is_open or not _BIT_RATE.fullmatch(line)):
            return {b"V": b"V1013\r", b"N": b"NA123\r"}.get(line, _REFUSED)
        return _OK

    def _write(self, data: bytes) -> None:
        """Write `data`; if the end of what was written before is still waiting, drop it."""
        self._unsent = self._write_some(self._unsent)
        if not self._unsent:
            left = self._write_some(data)
            self._unsent = b"" if left == data else left

    def _write_some(self, data: bytes) -> bytes:
        """Write what the line takes, and return the rest."""
        try:
            return data[os.write(self._end, data) :] if data else data
        except OSError:  # nobody reads, or the line has gone
            return data


def format_frame(message: can.Message) -> bytes:
    """Return a data frame with an id of 11 bits, as all of CANopen are, as a line of slcan."""
    return f"t{message.arbitration_id:03X}{message.dlc}{message.data.hex().upper()}\r".encode("ascii")


def parse_frame(line: bytes) -> can.Message | None:
    """Return the data frame that a line of slcan sends, or None when it is not one."""
    found = _FRAME.fullmatch(line)
    if found is None or len(found[3]) != 2 * int(found[2]):
        return None
    data = bytes.fromhex(found[3].decode())
    return can.Message(arbitration_id=int(found[1], 16), is_extended_id=False, data=data)
