"""Simulated drives for other programs: python-can's interfaces, slcan, and an outside CANopen client."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import can
import canopen
import pytest

from labrig.cli.main import run_command
from labrig.devices.simulated.slcan_adapter import SlcanAdapter, format_frame, parse_frame
from tests.devices.served import INTERFACES, served_drives

ROOT = Path(__file__).parents[2]
CLIENT = Path(__file__).parent / "outside_client" / "client.js"
PACKAGES = Path(sys.prefix) / "outside-client" / "node_modules"


@pytest.mark.parametrize("interface", INTERFACES)
def test_a_canopen_client_drives_a_node_over_every_interface(interface: str) -> None:
    """Name, reset with boot-up, enabling and a move, by the Python package canopen over a real python-can bus."""
    with served_drives(interface) as served:
        network = canopen.Network()
        network.connect(**served.reached_by)
        node = canopen.RemoteNode(2, canopen.ObjectDictionary())
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 2.0
        assert node.sdo.upload(0x1008, 0) == b"EPOS2"
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


@pytest.fixture(name="adapter")
def _adapter() -> Iterator[SlcanAdapter]:
    adapter = SlcanAdapter(1_000_000)
    yield adapter
    adapter.shutdown()


def _talk(adapter: SlcanAdapter, text: bytes) -> tuple[bytes, can.Message | None]:
    """Send bytes to an adapter as a program at its port does; return its answer and the frame that it sent."""
    port = os.open(adapter.path, os.O_RDWR | os.O_NOCTTY)
    os.set_blocking(port, False)
    try:
        os.write(port, text)
        message = adapter.recv(timeout=0.1)
        try:
            return os.read(port, 1000), message
        except BlockingIOError:
            return b"", message
    finally:
        os.close(port)


def test_the_adapter_acknowledges_commands(adapter: SlcanAdapter) -> None:
    """Commands get CR, frames z and CR, errors a bell; a closed channel accepts no frame."""
    assert _talk(adapter, b"t60180000000000000000\r") == (b"\a", None)
    assert _talk(adapter, b"\rV\rN\rS8\r?\r")[0] == b"\rV1013\rNA123\r\r\a"
    answer, message = _talk(adapter, b"O\rt6012ABCD\r")
    assert answer == b"\rz\r"
    assert message is not None
    assert (message.arbitration_id, bytes(message.data)) == (0x601, b"\xab\xcd")
    assert _talk(adapter, b"t6019\rtXYZ1AA\rS6\rF\r")[0] == b"\a\a\aF00\r"
    assert _talk(adapter, b"C\rC\r")[0] == b"\r\a"


def test_half_a_frame_is_not_sent(adapter: SlcanAdapter) -> None:
    """An unfinished line waits for its end."""
    assert _talk(adapter, b"S8\rO\r")[0] == b"\r\r"
    assert _talk(adapter, b"t6012AB") == (b"", None)
    answer, message = _talk(adapter, b"CD\r")
    assert (answer, message is not None) == (b"z\r", True)


def test_nothing_passes_at_a_wrong_bit_rate(adapter: SlcanAdapter) -> None:
    """The adapter accepts the frame, the bus does not, and the flags show it."""
    answer, message = _talk(adapter, b"S6\rO\rt6012ABCD\rF\r")
    assert (answer, message) == (b"\r\rz\rF20\r", None)


def test_frames_survive_the_serial_line() -> None:
    """Standard, extended and remote frames arrive unchanged."""
    for frame in (
        can.Message(arbitration_id=0x7FF, data=b"\1\2\3", is_extended_id=False),
        can.Message(arbitration_id=0x1FFFFFFF, data=bytes(8)),
        can.Message(arbitration_id=0x701, is_remote_frame=True, dlc=1, is_extended_id=False),
    ):
        parsed = parse_frame(format_frame(frame).decode().rstrip("\r"))
        assert parsed is not None
        assert parsed.equals(frame, timestamp_delta=None)


def test_pulling_the_adapter_ends_its_port() -> None:
    """An open port raises an error, as a real serial port does when its adapter is pulled."""
    adapter = SlcanAdapter(1_000_000)
    port = os.open(adapter.path, os.O_RDWR | os.O_NOCTTY)
    adapter.unplug()
    with pytest.raises(OSError, match=r".+"):
        os.write(port, b"V\r")
    os.close(port)
    adapter.shutdown()


def test_an_outside_client_drives_the_simulated_drive() -> None:
    """The npm package canopen enables and moves it, gets maxon's abort codes and its emergency."""
    node = shutil.which("node")
    if node is None or not (PACKAGES / "canopen").is_dir():
        pytest.skip("needs node and, in the virtual environment, npm's canopen: make .venv/outside-client")
    with served_drives("slcan", (1,)) as served:
        done = subprocess.run(
            [node, str(CLIENT), str(served.reached_by["channel"])],
            env={**os.environ, "NODE_PATH": str(PACKAGES)},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.stderr == ""
    assert json.loads(done.stdout) == {
        "name": "EPOS2",
        "vendor": 0xFB,
        "position": 20_000,
        "noSuchObject": 0x06020000,
        "tooLow": 0x06090032,
        "emergency": 0xFF09,
    }


def _simulate(*arguments: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "labrig", "devices", "simulate", *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_the_command_names_its_port_serves_and_leaves_a_journal(tmp_path: Path) -> None:
    """One line when ready; INT ends it with 130, and the journal holds what the drives did."""
    journal = tmp_path / "drives.jsonl"
    with _simulate("--interface", "slcan", "--nodes", "4", "--journal", str(journal)) as serving:
        assert serving.stdout is not None
        ready = serving.stdout.readline().split()
        network = canopen.Network()
        network.connect(interface="slcan", channel=ready[-1], bitrate=1_000_000, sleep_after_open=0)
        node = canopen.RemoteNode(4, canopen.ObjectDictionary())
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 2.0
        assert node.sdo.upload(0x1008, 0) == b"EPOS2"
        network.disconnect()
        serving.send_signal(signal.SIGINT)
        assert serving.wait(10) == 130
    first = json.loads(journal.read_text(encoding="utf-8").splitlines()[0])
    assert (first["node_id"], first["kind"]) == (4, "boot")


def test_an_existing_file_is_not_replaced_by_a_journal(tmp_path: Path) -> None:
    """Without --force the command exits with 2 before it serves, and the file is unchanged."""
    journal = tmp_path / "drives.jsonl"
    journal.write_text("mine")
    with _simulate("--interface", "slcan", "--journal", str(journal)) as serving:
        assert serving.wait(20) == 2
        assert serving.stderr is not None
        assert "drives.jsonl exists" in serving.stderr.read()
    assert journal.read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--interface", "virtual"), "nobody could reach"),
        (("--interface", "nonsense"), "knows no interface nonsense"),
        (("--interface", "slcan", "--bitrate", "12345"), "bit rate 12345"),
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
