"""Simulated drives for other programs: python-can's interfaces, a serial line of slcan, outside CANopen clients."""

import json
import os
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import can
import canopen
import pytest

from labrig.cli.main import run_command
from labrig.devices.simulated.slcan import SlcanAdapter
from tests.devices.served import INTERFACES, served_drives

ROOT = Path(__file__).parents[2]
VENDOR = b"\xfb\0\0\0"
CLIENT = Path(__file__).parent / "outside_client" / "client.js"
PACKAGES = Path(sys.prefix) / "outside-client" / "node_modules"


def _connect(**reached_by: object) -> tuple[canopen.Network, canopen.RemoteNode]:
    """Return the bus of a foreign client, and node 2 on it, which has said who made it."""
    network, node = canopen.Network(), canopen.RemoteNode(2, canopen.ObjectDictionary())
    network.connect(**reached_by)
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 2.0
    assert node.sdo.upload(0x1018, 1) == VENDOR
    return network, node


@pytest.mark.slow
@pytest.mark.parametrize("interface", INTERFACES)
def test_a_canopen_client_drives_a_node_over_every_interface(interface: str) -> None:
    """Vendor, reset with boot-up, enabling and a move, by the Python package canopen over a real python-can bus."""
    with served_drives(interface) as served:
        network, node = _connect(**served.reached_by)
        node.nmt.send_command(0x81)
        node.nmt.wait_for_bootup(5)
        node.nmt.send_command(0x01)
        for word in (0x06, 0x0F):
            node.sdo.download(0x6040, 0, word.to_bytes(2, "little"))
        node.sdo.download(0x607A, 0, (300).to_bytes(4, "little"))
        node.sdo.download(0x6040, 0, (0x3F).to_bytes(2, "little"))
        while not int.from_bytes(node.sdo.upload(0x6041, 0), "little") & 0x0400:
            pass
        assert int.from_bytes(node.sdo.upload(0x6064, 0), "little") == 300
        network.disconnect()
        assert served.drives[2].shaft_counts == 300
        assert served.drives[1].shaft_counts == 0


@pytest.mark.slow
def test_an_outside_client_drives_the_simulated_drive() -> None:
    """The npm package canopen enables and moves it, gets maxon's abort codes and its emergency."""
    node = shutil.which("node")
    if node is None or not (PACKAGES / "canopen").is_dir():
        pytest.skip("needs node and, in the virtual environment, npm's canopen: make .venv/outside-client")
    with served_drives("slcan", (1,)) as served:
        done = subprocess.run(
            [node, str(CLIENT), str(served.reached_by["channel"])],
            env={**os.environ, "NODE_PATH": str(PACKAGES)}, capture_output=True, text=True, timeout=60,
            check=False,
        )  # fmt: skip
    assert done.stderr == ""
    assert json.loads(done.stdout) == {
        "vendor": 0xFB, "position": 20_000, "noSuchObject": 0x06020000, "tooLow": 0x06090032,
        "emergency": 0xFF09,
    }  # fmt: skip


@pytest.mark.slow
def test_the_command_names_its_port_and_serves() -> None:
    """One line when ready; INT ends it with 130."""
    command = [sys.executable, "-m", "labrig", "devices", "simulate", "--interface", "slcan", "--nodes", "2"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as serving:
        assert serving.stdout is not None
        channel = serving.stdout.readline().split()[-1]
        network, _ = _connect(interface="slcan", channel=channel, bitrate=1_000_000, sleep_after_open=0)
        network.disconnect()
        serving.send_signal(signal.SIGINT)
        assert serving.wait(10) == 130


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "--interface"),
        (("--interface", "virtual"), "nobody could reach"),
        (("--interface", "nonsense"), "knows no interface nonsense"),
        (("--interface", "slcan", "--nodes", "1,1"), "list of different node ids"),
        (("--interface", "slcan", "--nodes", "0"), "list of different node ids"),
    ],
)
def test_the_command_refuses_an_unreachable_bus(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    """Wrong input exits with 2 and a sentence."""
    assert run_command(["devices", "simulate", *arguments]) == 2
    assert words in capsys.readouterr().err


def _read(program: int, length: int) -> bytes:
    received = b""
    while len(received) < length:
        received += os.read(program, length - len(received))
    return received


def test_an_adapter_acknowledges_commands() -> None:
    """Commands get CR, frames z and CR, errors a bell; a closed channel takes no frame, and half a line waits."""
    with SlcanAdapter() as adapter:
        program = os.open(adapter.path, os.O_RDWR | os.O_NOCTTY)
        for text, answer, received in (
            (b"V\rC\r", b"V1013\r\a", None),
            (b"t60180000000000000000\r", b"\a", None),
            (b"\rN\rS8\r?\r", b"\rNA123\r\r\a", None),
            (b"O\rt6012ABCD\r", b"\rz\r", (0x601, b"\xab\xcd")),
            (b"t6019\rtXYZ1AA\rS6\rC\rC\r", b"\a\a\a\r\a", None),
            (b"O\rt6012AB", b"\r", None),
            (b"CD\r", b"z\r", (0x601, b"\xab\xcd")),
            (b"t7FF0\r", b"z\r", (0x7FF, b"")),
        ):
            os.write(program, text)
            message = adapter.recv(timeout=0.2)
            assert _read(program, len(answer)) == answer
            assert (message and (message.arbitration_id, bytes(message.data))) == received
        os.close(program)


def test_a_program_that_never_reads_loses_frames_and_delays_nobody() -> None:
    """The bus sends more than the line holds; what arrives is whole."""
    frame, sent = can.Message(arbitration_id=0x181, data=b"\1\2\3\4", is_extended_id=False), 4000
    with SlcanAdapter() as adapter:
        program = os.open(adapter.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        os.write(program, b"O\r")
        assert adapter.recv(timeout=0.05) is None
        lines = b""
        for _ in range(2):  # the second time, what is left of a line comes first
            for _ in range(sent // 2):
                adapter.send(frame)
            with suppress(BlockingIOError):
                while True:
                    lines += os.read(program, 65536)
        os.close(program)
    opened, *frames, rest = lines.split(b"\r")
    assert 0 < len(frames) < sent
    assert (opened, set(frames)) == (b"", {b"t181401020304"})
    assert b"t181401020304\r".startswith(rest)
