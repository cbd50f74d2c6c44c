"""A simulated slcan adapter on a serial line, and what a program cannot do to it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import can
import pytest

from labrig.devices.simulated.slcan import SlcanAdapter, format_frame, parse_frame

FRAME = can.Message(arbitration_id=0x181, data=b"\1\2\3\4\5\6\7\10", is_extended_id=False)
LINE = b"t18180102030405060708\r"


@pytest.fixture(name="adapter")
def _adapter() -> Iterator[SlcanAdapter]:
    with SlcanAdapter() as adapter:
        yield adapter


@contextmanager
def _open(adapter: SlcanAdapter, opening: bytes = b"S8\rO\r") -> Iterator[int]:
    """Open the line as a program does, and the channel of its adapter."""
    program = os.open(adapter.path, os.O_RDWR | os.O_NOCTTY)
    os.write(program, opening)
    assert adapter.recv(timeout=0.05) is None
    assert _read(program, 2) == (b"\r\r" if opening.startswith(b"S") else b"V1")
    yield program
    os.close(program)


def _read(program: int, length: int) -> bytes:
    received = b""
    while len(received) < length:
        received += os.read(program, length - len(received))
    return received


def _talk(adapter: SlcanAdapter, program: int, text: bytes, length: int) -> tuple[bytes, can.Message | None]:
    """Send bytes to an adapter; return its answer of a length and the frame that reached the bus."""
    os.write(program, text)
    message = adapter.recv(timeout=0.2)
    return _read(program, length), message


def test_an_adapter_acknowledges_commands(adapter: SlcanAdapter) -> None:
    """Commands get CR, frames z and CR, errors a bell; a closed channel takes no frame, and half a line waits."""
    with _open(adapter, opening=b"V\rC\r") as program:
        assert _read(program, 5) == b"013\r\a"
        assert _talk(adapter, program, b"t60180000000000000000\r", 1) == (b"\a", None)
        assert _talk(adapter, program, b"\rN\rS8\r?\r", 9)[0] == b"\rNA123\r\r\a"
        answer, message = _talk(adapter, program, b"O\rt6012ABCD\r", 3)
        assert answer == b"\rz\r"
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x601, b"\xab\xcd")
        assert _talk(adapter, program, b"t6019\rtXYZ1AA\rS6\rC\rC\r", 5)[0] == b"\a\a\a\r\a"
        assert _talk(adapter, program, b"O\rt6012AB", 1) == (b"\r", None)
        answer, message = _talk(adapter, program, b"CD\r", 2)
        assert (answer, message is not None) == (b"z\r", True)


def test_a_frame_survives_the_line() -> None:
    """It arrives unchanged, whatever its length."""
    for data in (b"", b"\1\2\3"):
        frame = can.Message(arbitration_id=0x7FF, data=data, is_extended_id=False)
        parsed = parse_frame(format_frame(frame).rstrip(b"\r"))
        assert parsed is not None
        assert parsed.equals(frame, timestamp_delta=None)


def test_a_program_that_never_reads_loses_frames_and_delays_nobody(adapter: SlcanAdapter) -> None:
    """The bus sends more than the line holds; what arrives is whole."""
    sent = 2000
    with _open(adapter) as program:
        for _ in range(sent):
            adapter.send(FRAME)
        os.set_blocking(program, False)
        lines = b""
        with suppress(BlockingIOError):
            while True:
                lines += os.read(program, 65536)
        assert 0 < lines.count(b"\r") < sent
        assert set(lines.split(b"\r")[:-1]) == {LINE[:-1]}
