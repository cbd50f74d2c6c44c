"""The serving side of CANopen's SDO protocol (CiA 301): expedited, and segmented reading of longer values."""

import struct
from collections.abc import Callable

_HEAD = struct.Struct("<BHB")
_ABORT = struct.Struct("<BHBI")

TOGGLE = 0x05030000
COMMAND_UNKNOWN = 0x05040001
READ_ONLY = 0x06010002
NO_OBJECT = 0x06020000
LENGTH = 0x06070010
NO_SUBINDEX = 0x06090011
TOO_HIGH = 0x06090031
TOO_LOW = 0x06090032


class SdoAbortError(Exception):
    """A transfer that the server refuses, with the code that the client is told."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


class SdoServer:
    """Answers requests of one client.

    Parameters
    ----------
    read : callable
        (index, subindex) -> bytes; raises `SdoAbortError`.
    write : callable
        (index, subindex, bytes) -> None; raises `SdoAbortError`.
    """

    def __init__(self, read: Callable[[int, int], bytes], write: Callable[[int, int, bytes], None]) -> None:
        self._read = read
        self._write = write
        self._rest = b""
        self._toggle = 0

    def answer(self, request: bytes) -> bytes | None:
        """Return the response to a request of eight bytes; None where the client wants none."""
        command, index, subindex = _HEAD.unpack_from(request)
        try:
            match command >> 5:
                case 2:
                    return self._upload(index, subindex)
                case 1:
                    return self._download(command, index, subindex, request)
                case 3:
                    return self._upload_segment(command)
                case 4:
                    return None
            raise SdoAbortError(COMMAND_UNKNOWN)
        except SdoAbortError as refusal:
            return _ABORT.pack(0x80, index, subindex, refusal.code)

    def _upload(self, index: int, subindex: int) -> bytes:
        data = self._read(index, subindex)
        if len(data) <= 4:
            return _HEAD.pack(0x43 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")
        self._rest, self._toggle = data, 0
        return _HEAD.pack(0x41, index, subindex) + struct.pack("<I", len(data))

    def _upload_segment(self, command: int) -> bytes:
        if command & 0x10 != self._toggle:
            raise SdoAbortError(TOGGLE)
        segment, self._rest = self._rest[:7], self._rest[7:]
        answer = self._toggle | (7 - len(segment)) << 1 | (not self._rest)
        self._toggle ^= 0x10
        return bytes([answer]) + segment.ljust(7, b"\0")

    def _download(self, command: int, index: int, subindex: int, request: bytes) -> bytes:
        if not command & 0x02:
            # No object of an EPOS2 that labrig knows and may write is longer than four bytes.
            raise SdoAbortError(COMMAND_UNKNOWN)
        size = 4 - (command >> 2 & 0x3) if command & 0x01 else 4
        self._write(index, subindex, bytes(request[4 : 4 + size]))
        return _HEAD.pack(0x60, index, subindex) + b"\0\0\0\0"
