"""Simulated slcan adapters over TCP: several programs on one bus, and what they cannot do to it."""

import select
import socket
from collections.abc import Iterator
from contextlib import suppress

import can
import pytest

from labrig.devices.simulated.serving import Gateway
from labrig.devices.simulated.slcan_server import SlcanServer
from labrig.errors import BusError
from tests.rehearsing import free_port

FRAME = can.Message(arbitration_id=0x181, data=b"\1\2\3\4\5\6\7\10", is_extended_id=False)
LINE = b"t18180102030405060708\r"
_LONG_S = 10.0


@pytest.fixture(name="server")
def _server() -> Iterator[SlcanServer]:
    with SlcanServer(free_port(), 1_000_000) as server:
        yield server


def _connect(server: SlcanServer, receive_bytes: int = 65536) -> socket.socket:
    """Return a program that is connected and has opened its adapter."""
    program = socket.socket()
    program.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    program.settimeout(_LONG_S)
    program.connect(("127.0.0.1", int(server.path.rpartition(":")[2])))
    program.sendall(b"S8\rO\r")
    while not select.select([program], [], [], 0)[0]:
        assert server.recv(timeout=0.05) is None
    assert _read(program, 2) == b"\r\r"
    return program


def _read(program: socket.socket, length: int) -> bytes:
    received = b""
    while len(received) < length:
        received += program.recv(length - len(received))
    return received


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
    """A round of the gateway ends although more frames wait, and the drives do what is due."""
    rounds = iter(range(3))
    gateway = Gateway(server)
    with _connect(server) as flood:
        flood.setblocking(False)
        frame = b"t77F105\r"

        def flood_again() -> None:
            with suppress(BlockingIOError):
                while True:
                    flood.send(frame * 1000)

        flood_again()
        gateway.serve((), lambda: next(rounds, None) is None, flood_again)
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
        SlcanServer(free_port(), 1_000_000) as first,
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
