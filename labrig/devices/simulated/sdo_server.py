"""The serving side of CANopen's SDO protocol (CiA 301): reads, and writes of at most four bytes; no block transfer."""

import struct
from collections.abc import Callable

from labrig.devices.drives.objects import Place

_HEAD = struct.Struct("<BHB")
_ABORT = struct.Struct("<BHBI")

TOGGLE = 0x05030000
COMMAND_UNKNOWN = 0x05040001
WRITE_ONLY = 0x06010001
READ_ONLY = 0x06010002
NO_OBJECT = 0x06020000
NOT_MAPPABLE = 0x06040041
PDO_LENGTH = 0x06040042
TOO_LONG = 0x06070012
TOO_SHORT = 0x06070013
NO_SUBINDEX = 0x06090011
OUT_OF_RANGE = 0x06090030
TOO_HIGH = 0x06090031
TOO_LOW = 0x06090032
MAXIMUM_BELOW_MINIMUM = 0x06090036
WRONG_STATE = 0x08000022
NMT_STATE = 0x0F00FFC0


class SdoAbortError(Exception):
    """A transfer that the server refuses, with its abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


class SdoServer:
    """Answers requests of one client.

    Parameters
    ----------
    read : callable
        Place -> bytes; raises `SdoAbortError`.
    write : callable
        (Place, bytes) -> None; raises `SdoAbortError`.
    """

    def __init__(self, read: Callable[[Place], bytes], write: Callable[[Place, bytes], None]) -> None:
        self._read = read
        self._write = write
        self._place = Place(0)
        self._rest: bytes | None = None
        self._toggle = 0

    def answer(self, request: bytes) -> bytes | None:
        """Return the response to a request; None if the client expects none."""
        if len(request) != 8:
            return None
        command, index, subindex = _HEAD.unpack_from(request)
        if command >> 5 != 3:
            self._place, self._rest = Place(index, subindex), None
        try:
            return self._dispatch(command, request)
        except SdoAbortError as refusal:
            self._rest = None
            return _ABORT.pack(0x80, *self._place, refusal.code)

    def _dispatch(self, command: int, request: bytes) -> bytes | None:
        match command >> 5:
            case 1:
                return self._download(command, request)
            case 2:
                return self._upload()
            case 3:
                return self._upload_segment(command)
            case 4:
                return None
        raise SdoAbortError(COMMAND_UNKNOWN)

    def _upload(self) -> bytes:
        data = self._read(self._place)
        if len(data) <= 4:
            return _HEAD.pack(0x43 | (4 - len(data)) << 2, *self._place) + data.ljust(4, b"\0")
        self._rest, self._toggle = data, 0
        return _HEAD.pack(0x41, *self._place) + struct.pack("<I", len(data))

    def _upload_segment(self, command: int) -> bytes:
        if self._rest is None:
            raise SdoAbortError(COMMAND_UNKNOWN)
        if command & 0x10 != self._toggle:
            raise SdoAbortError(TOGGLE)
        segment, rest = self._rest[:7], self._rest[7:]
        answer = self._toggle | (7 - len(segment)) << 1 | (not rest)
        self._toggle ^= 0x10
        self._rest = rest or None
        return bytes([answer]) + segment.ljust(7, b"\0")

    def _download(self, command: int, request: bytes) -> bytes:
        if not command & 0x02:
            raise SdoAbortError(COMMAND_UNKNOWN)
        size = 4 - (command >> 2 & 0x3) if command & 0x01 else min(4, len(self._read(self._place)))
        self._write(self._place, bytes(request[4 : 4 + size]))
        return _HEAD.pack(0x60, *self._place) + b"\0\0\0\0"
