"""Simulated drives for other programs: python-can's interfaces, slcan, and an outside CANopen client."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import canopen
import pytest

from labrig.cli.main import run_command
from tests.devices.served import INTERFACES, served_drives

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
VENDOR = b"\xfb\0\0\0"
CLIENT = Path(__file__).parent / "outside_client" / "client.js"
PACKAGES = Path(sys.prefix) / "outside-client" / "node_modules"


@pytest.mark.parametrize("interface", INTERFACES)
def test_a_canopen_client_drives_a_node_over_every_interface(interface: str) -> None:
    """Vendor, reset with boot-up, enabling and a move, by the Python package canopen over a real python-can bus."""
    with served_drives(interface) as served:
        network = canopen.Network()
        network.connect(**served.reached_by)
        node = canopen.RemoteNode(2, canopen.ObjectDictionary())
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 2.0
        assert node.sdo.upload(0x1018, 1) == VENDOR
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


def test_the_command_names_its_port_and_serves() -> None:
    """One line when ready; INT ends it with 130."""
    with _simulate("--interface", "slcan", "--nodes", "4") as serving:
        assert serving.stdout is not None
        ready = serving.stdout.readline().split()
        network = canopen.Network()
        network.connect(interface="slcan", channel=ready[-1], bitrate=1_000_000, sleep_after_open=0)
        node = canopen.RemoteNode(4, canopen.ObjectDictionary())
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 2.0
        assert node.sdo.upload(0x1018, 1) == VENDOR
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
