"""The simulated drive as an outside CANopen client sees it: wire, object dictionary, faults."""

from collections.abc import Iterator

import can
import canopen
import pytest
from canopen.sdo.exceptions import SdoAbortedError

from labrig.devices import canopen_objects as co
from labrig.devices.clocks import SimulatedClock
from labrig.devices.epos2 import objects as od
from labrig.devices.epos2.simulated_drive import SimulatedDrive
from labrig.devices.simulated.bus import InProcessBus, InProcessWire, attach
from tests.devices.rigs import ANSWER_TIMEOUT_S


@pytest.fixture(name="wire")
def _wire() -> InProcessWire:
    return InProcessWire()


@pytest.fixture(name="heard")
def _heard(wire: InProcessWire) -> Iterator[list[can.Message]]:
    heard: list[can.Message] = []
    bus = InProcessBus(wire, heard.append)
    yield heard
    bus.shutdown()


@pytest.fixture(name="node")
def _node(wire: InProcessWire, heard: list[can.Message]) -> Iterator[canopen.RemoteNode]:
    clock = SimulatedClock()
    drive = SimulatedDrive(wire, 5, clock)
    link = attach(wire, clock, ANSWER_TIMEOUT_S)
    node = canopen.RemoteNode(5, canopen.ObjectDictionary())
    link.network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 0.0
    yield node
    link.close()
    drive.unplug()


def test_it_announces_itself(node: canopen.RemoteNode, heard: list[can.Message]) -> None:
    """The first frame after power-on is the boot-up frame."""
    assert (heard[0].arbitration_id, bytes(heard[0].data)) == (0x705, b"\0")


def test_identity_is_that_of_an_epos2(node: canopen.RemoteNode) -> None:
    """Device type, vendor and hardware version are those of an EPOS2 24/5; the name comes in segments."""
    assert node.sdo.upload(0x1000, 0) == (0x00020192).to_bytes(4, "little")
    assert node.sdo.upload(0x1018, 1) == (0xFB).to_bytes(4, "little")
    assert node.sdo.upload(0x2003, 2) == (0x6220).to_bytes(2, "little")
    assert node.sdo.upload(0x1008, 0) == b"EPOS2"


@pytest.mark.parametrize(
    ("index", "subindex", "data", "code"),
    [
        (0x4000, 0, b"\0", 0x06020000),
        (0x607D, 9, b"\0", 0x06090011),
        (0x6041, 0, b"\0\0", 0x06010002),
        (0x6081, 0, b"\0\0", 0x06070013),
        (0x6081, 0, bytes(4), 0x06090032),
        (0x6081, 0, (25_001).to_bytes(4, "little"), 0x06090031),
    ],
)
def test_refusals_carry_the_codes_that_maxon_lists(
    node: canopen.RemoteNode, index: int, subindex: int, data: bytes, code: int
) -> None:
    """No object, no subindex, read only, too short, too low, too high."""
    with pytest.raises(SdoAbortedError) as refusal:
        node.sdo.download(index, subindex, data)
    assert refusal.value.code == code


def test_every_number_reads_back_its_default(node: canopen.RemoteNode) -> None:
    """Each entry of the table has its width and its value after power-on."""
    own_id = {od.NODE_ID, co.EMERGENCY_ID, co.SDO_REQUEST_ID, co.SDO_RESPONSE_ID}
    own_id |= {*co.RECEIVE_PDO_COB_IDS, *co.TRANSMIT_PDO_COB_IDS}
    changing = {co.STATUSWORD, co.SERIAL_NUMBER, *own_id}
    for entry in od.NUMBERS:
        data = node.sdo.upload(entry.index, entry.subindex)
        assert len(data) == entry.size
        assert entry in changing or entry.unpack(data) == entry.default
    assert node.sdo.upload(0x1800, 1) == (0x40000185).to_bytes(4, "little")


def test_an_unknown_command_is_refused(wire: InProcessWire, heard: list[can.Message]) -> None:
    """Block transfer, which the server lacks, is answered by an abort."""
    drive = SimulatedDrive(wire, 5, SimulatedClock())
    for request in (bytes([0xC0, 0, 0, 0, 0, 0, 0, 0]), bytes([0x70, 0, 0, 0, 0, 0, 0, 0])):
        heard.clear()
        probe = InProcessBus(wire, lambda _message: None)
        probe.send(can.Message(arbitration_id=0x605, data=request, is_extended_id=False))
        probe.shutdown()
        answer = next(message for message in heard if message.arbitration_id == 0x585)
        assert answer.data[0] == 0x80
        assert int.from_bytes(answer.data[4:], "little") == 0x05040001
    drive.unplug()


def test_a_stopped_node_answers_no_sdo_and_starts_again(node: canopen.RemoteNode) -> None:
    """NMT STOPPED has no SDO; NMT start restores it, with the remote bit."""
    node.nmt.send_command(0x02)
    with pytest.raises(canopen.SdoCommunicationError):
        node.sdo.upload(0x6041, 0)
    node.nmt.send_command(0x01)
    assert int.from_bytes(node.sdo.upload(0x6041, 0), "little") & 0x0200


def test_a_reset_forgets_settings_and_boots_again(node: canopen.RemoteNode, heard: list[can.Message]) -> None:
    """NMT reset node restores the power-on values and announces the node."""
    node.sdo.download(0x6081, 0, (77).to_bytes(4, "little"))
    heard.clear()
    node.nmt.send_command(0x81)
    assert int.from_bytes(node.sdo.upload(0x6081, 0), "little") == 1000
    assert 0x705 in {message.arbitration_id for message in heard}
