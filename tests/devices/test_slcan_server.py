"""Simulated slcan adapters over TCP: several programs on one bus, and what they cannot do to it."""

import select
import socket
from collections.abc import Iterator
from contextlib import suppress

import can
import pytest

from labrig.devices.simulated.serving import ServedDrives
from labrig.devices.simulated.slcan_server import SlcanServer, format_frame, parse_frame
from labrig.errors import BusError

FRAME = can.Message(arbitration_id=0x181, data=b"\1\2\3\4\5\6\7\10", is_extended_id=False)
LINE = b"t18180102030405060708\r"
_LONG_S = 10.0


@pytest.fixture(name="server")
def _server() -> Iterator[SlcanServer]:
    with SlcanServer(0, 1_000_000) as server:
        yield server


def _connect(server: SlcanServer, receive_bytes: int = 65536, opening: bytes = b"S8\rO\r") -> socket.socket:
    """Return a program that is connected and has opened its adapter."""
    program = socket.socket()
    program.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    program.settimeout(_LONG_S)
    program.connect(("127.0.0.1", int(server.path.rpartition(":")[2])))
    program.sendall(opening)
    while not select.select([program], [], [], 0)[0]:
        assert server.recv(timeout=0.05) is None
    assert _read(program, 2) == (b"\r\r" if opening.startswith(b"S") else b"V1")
    return program


def _read(program: socket.socket, length: int) -> bytes:
    received = b""
    while len(received) < length:
        received += program.recv(length - len(received))
    return received


def _talk(
    server: SlcanServer, program: socket.socket, text: bytes, length: int
) -> tuple[bytes, can.Message | None]:
    """Send bytes to an adapter; return its answer of a length and the frame that reached the bus."""
    program.sendall(text)
    message = server.recv(timeout=0.2)
    return _read(program, length), message


def test_an_adapter_acknowledges_commands(server: SlcanServer) -> None:
    """Commands get CR, frames z and CR, errors a bell; a closed channel accepts no frame."""
    with _connect(server, opening=b"V\rC\r") as program:
        assert _read(program, 5) == b"013\r\a"
        assert _talk(server, program, b"t60180000000000000000\r", 1) == (b"\a", None)
        assert _talk(server, program, b"\rN\rS8\r?\r", 9)[0] == b"\rNA123\r\r\a"
        answer, message = _talk(server, program, b"O\rt6012ABCD\r", 3)
        assert answer == b"\rz\r"
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x601, b"\xab\xcd")
        assert _talk(server, program, b"t6019\rtXYZ1AA\rS6\rC\rC\r", 5)[0] == b"\a\a\a\r\a"


def test_half_a_frame_is_not_sent(server: SlcanServer) -> None:
    """An unfinished line waits for its end."""
    with _connect(server) as program:
        assert _talk(server, program, b"t6012AB", 0) == (b"", None)
        answer, message = _talk(server, program, b"CD\r", 2)
        assert (answer, message is not None) == (b"z\r", True)


def test_nothing_passes_at_a_wrong_bit_rate(server: SlcanServer) -> None:
    """The adapter accepts the frame, the bus does not."""
    with _connect(server, opening=b"S6\rO\r") as program:
        assert _talk(server, program, b"t6012ABCD\r", 2) == (b"z\r", None)
        server.send(FRAME)
        assert _talk(server, program, b"V\r", 6) == (b"V1013\r", None)


def test_frames_survive_the_line() -> None:
    """Data and remote frames arrive unchanged."""
    for frame in (
        can.Message(arbitration_id=0x7FF, data=b"\1\2\3", is_extended_id=False),
        can.Message(arbitration_id=0x701, is_remote_frame=True, dlc=1, is_extended_id=False),
    ):
        parsed = parse_frame(format_frame(frame).rstrip(b"\r"))
        assert parsed is not None
        assert parsed.equals(frame, timestamp_delta=None)


def test_programs_on_one_bus_receive_each_others_frames(server: SlcanServer) -> None:
    """A frame of one reaches the drives and the other one; a frame of a drive reaches both."""
    with _connect(server) as first, _connect(server) as second:
        first.sendall(b"t6012ABCD\r")
        message = server.recv(timeout=_LONG_S)
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x601, b"\xab\xcd")
        assert _read(first, 2) == b"z\r"
        assert _read(second, 10) == b"t6012ABCD\r"
        server.send(FRAME)
        assert _read(first, 22) == _read(second, 22) == LINE


def test_a_program_that_never_reads_loses_frames_and_delays_nobody(server: SlcanServer) -> None:
    """The bus sends more than its connection holds, and another program still receives every frame, whole."""
    sent = 20_000
    with _connect(server, receive_bytes=4096) as deaf, _connect(server) as program:
        for _ in range(sent):
            server.send(FRAME)
            assert _read(program, 22) == LINE
        deaf.setblocking(False)
        lines = b""
        with suppress(BlockingIOError):
            while True:
                lines += deaf.recv(65536)
        assert 0 < lines.count(b"\r") < sent
        assert set(lines.split(b"\r")[:-1]) == {LINE[:-1]}


def test_a_program_that_sends_without_a_pause_does_not_stop_the_drives(server: SlcanServer) -> None:
    """A round of serving ends although more frames wait, and the drives do what is due."""
    rounds = iter(range(3))
    with _connect(server) as flood:
        flood.setblocking(False)
        frame = b"t77F105\r"

        def flood_again() -> None:
            with suppress(BlockingIOError):
                while True:
                    flood.send(frame * 1000)

        def until() -> bool:
            flood_again()
            return next(rounds, None) is None

        ServedDrives(server, ()).serve(until)
        assert server.recv(timeout=0) is not None


def test_a_program_that_goes_leaves_the_bus_to_the_others(server: SlcanServer) -> None:
    """Its connection is closed, without an error."""
    with _connect(server) as stays:
        _connect(server).close()
        assert server.recv(timeout=0.1) is None
        server.send(FRAME)
        assert _read(stays, 22) == LINE


def test_a_port_in_use_is_named() -> None:
    """The error says which port, what may use it and where another one is written."""
    with (
        SlcanServer(0, 1_000_000) as first,
        pytest.raises(BusError, match=r"port \d+ of 127\.0\.0\.1 cannot be used") as refusal,
    ):
        SlcanServer(int(first.path.rpartition(":")[2]), 1_000_000)
    assert "another labrig devices simulate" in refusal.value.hint


def test_unplugging_ends_every_connection(server: SlcanServer) -> None:
    """A program reads the end, and a new connection ends at once."""
    port = int(server.path.rpartition(":")[2])
    with _connect(server) as program:
        server.unplug()
        assert program.recv(1) == b""
    with socket.create_connection(("127.0.0.1", port)) as late:
        late.settimeout(_LONG_S)
        assert server.recv(timeout=0.5) is None
        assert late.recv(1) == b""


def test_no_other_computer_reaches_the_bus(server: SlcanServer) -> None:
    """It listens on the loopback address alone."""
    assert server.path.startswith("socket://127.0.0.1:")
    assert server._listener.getsockname()[0] == "127.0.0.1"
