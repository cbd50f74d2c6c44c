"""CANopen of the simulated drive, as any client sees it: NMT, heartbeat, SDO, PDO, EMCY, and abort codes."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import can
import pytest

from labrig.devices.clocks import SimulatedClock
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import count_bytes, find_default, read_own_eds
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from tests.devices import epos2_places as od
from tests.devices.rigs import epos2_node

NODE = 5
OBJECTS = read_own_eds("epos2.eds").objects
TOO_LONG, TOO_SHORT, READ_ONLY = 0x06070012, 0x06070013, 0x06010002


@dataclass
class CanopenBench:
    """One drive, a clock, and everything that was on the bus."""

    clock: SimulatedClock
    wire: InProcessWire
    drive: SimulatedCia402Drive
    bus: InProcessBus
    heard: list[can.Message] = field(default_factory=list)

    def send(self, can_id: int, data: bytes = b"", *, remote: bool = False) -> None:
        """Send a frame."""
        frame = can.Message(
            arbitration_id=can_id,
            data=None if remote else data,
            is_remote_frame=remote,
            is_extended_id=False,
            dlc=len(data),
        )
        self.bus.send(frame)

    def nmt(self, command: int) -> None:
        """Send an NMT command."""
        self.send(0x000, bytes([command, NODE]))

    def frames(self, can_id: int) -> list[bytes]:
        """Return and forget what was heard under an id."""
        found = [bytes(message.data) for message in self.heard if message.arbitration_id == can_id]
        self.heard[:] = [message for message in self.heard if message.arbitration_id != can_id]
        return found

    def write(self, place: Place, value: int) -> int:
        """Write an object; return 0 or the abort code."""
        data = OBJECTS[place].encode_raw(value) if place in OBJECTS else bytes([value])
        head = bytes([0x23 | (4 - len(data)) << 2]) + place.index.to_bytes(2, "little")
        self.send(0x600 + NODE, head + bytes([place.subindex]) + data.ljust(4, b"\0"))
        (answer,) = self.frames(0x580 + NODE)
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0

    def read(self, place: Place) -> int:
        """Read an object."""
        head = b"\x40" + place.index.to_bytes(2, "little") + bytes([place.subindex])
        self.send(0x600 + NODE, head + bytes(4))
        (answer,) = self.frames(0x580 + NODE)
        assert answer[0] != 0x80
        variable = OBJECTS[place]
        return int(variable.decode_raw(answer[4 : 4 + count_bytes(variable)]))


@pytest.fixture(name="bench")
def _bench() -> Iterator[CanopenBench]:
    clock, wire = SimulatedClock(), InProcessWire()
    heard: list[can.Message] = []
    bus = InProcessBus(wire, heard.append)
    drive = epos2_node(wire, NODE, clock)
    clock.on_advance(drive.tick)
    yield CanopenBench(clock, wire, drive, bus, heard)
    drive.unplug()
    bus.shutdown()


def test_the_heartbeat_carries_the_nmt_state(bench: CanopenBench) -> None:
    """Pre-operational, operational and stopped are 127, 5 and 4, once per period."""
    bench.frames(0x705)
    bench.write(co.PRODUCER_HEARTBEAT, 100)
    for command, state in ((0x80, 127), (0x01, 5), (0x02, 4)):
        bench.nmt(command)
        bench.frames(0x705)
        for _ in range(50):
            bench.clock.sleep(0.01)
        assert bench.frames(0x705) == [bytes([state])] * 5


def test_a_missed_heartbeat_is_an_error_after_its_time_and_not_before(bench: CanopenBench) -> None:
    """0x8130 comes 500 ms after the last heartbeat, and never before the first one."""
    bench.write(co.CONSUMER_HEARTBEAT, 127 << 16 | 500)
    bench.clock.sleep(2.0)
    assert bench.frames(0x085) == []
    for _ in range(10):
        bench.send(0x77F, b"\x05")
        bench.clock.sleep(0.4)
    assert bench.frames(0x085) == []
    bench.clock.sleep(0.2)
    assert bench.frames(0x085) == [b"\x30\x81\x11\0\0\0\0\0"]
    emergency = bench.drive.find_last("emergency")
    assert emergency is not None
    assert emergency.t_s == pytest.approx(bench.clock.now_s() - 0.1)
    bench.write(co.CONTROLWORD, 0x80)
    assert bench.frames(0x085) == [bytes(8)]


@pytest.mark.parametrize(
    ("place", "value", "code"),
    [
        (co.TPDO_MAPS[0][1], 0x60640020, 0x08000022),  # the map is in use
        (Place(0x4000), 0, 0x06020000),
        (Place(0x607D, 9), 0, 0x06090011),
        (co.PROFILE_VELOCITY, 0, 0x06090032),
        (co.HOMING_METHOD, 3, 0x06090030),
        (co.MODE, 0, 0x06090030),
        (co.LOWER_LIMIT, 2**31 - 1, 0),
        (co.MAX_PROFILE_VELOCITY, 25_001, 0x06090031),
        (co.ERROR_COUNT, 1, 0x06090031),
        (od.FOLLOWING_ERROR_ACTUAL, 1, 0x06010002),
    ],
)
def test_refusals_carry_maxons_codes(bench: CanopenBench, place: Place, value: int, code: int) -> None:
    """Each invalid write is aborted with the code for its reason."""
    assert bench.write(place, value) == code


def test_error_history_is_newest_first_and_can_be_cleared(bench: CanopenBench) -> None:
    """Writing zero to the count of 0x1003 empties it."""
    for code in (0x2310, 0x3210):
        bench.drive.fail(code)
    assert [bench.read(entry) for entry in co.ERROR_HISTORY[:3]] == [0x3210, 0x2310, 0]
    assert bench.read(co.ERROR_COUNT) == 2
    bench.write(co.ERROR_COUNT, 0)
    assert bench.read(co.LAST_ERROR) == 0


def test_bus_errors_need_reset_communication_before_they_can_be_reset(bench: CanopenBench) -> None:
    """After CAN passive a fault reset does nothing until NMT reset communication."""
    bench.drive.fail(0x8120)
    bench.write(co.CONTROLWORD, 0x80)
    assert bench.read(co.STATUSWORD) & 0x4F == 0x08
    bench.write(co.CONTROLWORD, 0)
    bench.nmt(0x82)
    bench.write(co.CONTROLWORD, 0x80)
    assert bench.read(co.STATUSWORD) & 0x4F == 0x40


def test_a_download_that_does_not_say_its_length_is_understood(bench: CanopenBench) -> None:
    """Clients may not state the number of bytes."""
    bench.send(0x605, b"\x22\x98\x60\0\x23\0\0\0")
    assert bench.frames(0x585)[0][0] == 0x60
    assert bench.read(co.HOMING_METHOD) == 35


def test_every_number_has_its_width_and_default(bench: CanopenBench) -> None:
    """Writes of another width, and to what can only be read, are refused by the code that says why."""
    of_type = {
        co.PRODUCT_CODE,
        co.REVISION,
        co.SERIAL_NUMBER,
        co.VENDOR_ID,
        Place(0x6410, 1),
        Place(0x6410, 2),
    }
    for place, variable in OBJECTS.items():
        head = bytes([*place.index.to_bytes(2, "little"), place.subindex])
        bench.send(0x605, b"\x40" + head + bytes(4))
        (answer,) = bench.frames(0x585)
        assert 4 - (answer[0] >> 2 & 3) == count_bytes(variable)
        if place not in of_type | {co.STATUSWORD}:
            assert bench.read(place) == find_default(variable) + NODE * variable.relative, place
        for wrong, code in ((1, TOO_LONG), (-1, TOO_SHORT)):
            size = count_bytes(variable) + wrong
            if variable.access_type == "rw" and 0 < size <= 4:
                bench.send(0x605, bytes([0x23 | (4 - size) << 2]) + head + bytes(4))
                assert bench.frames(0x585)[0][4:] == code.to_bytes(4, "little")
        if variable.access_type == "ro":
            assert bench.write(place, 0) == READ_ONLY


def test_a_stopped_node_answers_nothing_and_a_reset_one_forgets(bench: CanopenBench) -> None:
    """NMT STOPPED has no SDO; start restores it, with the remote bit; reset node restores the values of power on."""
    bench.write(co.PROFILE_VELOCITY, 77)
    bench.nmt(0x02)
    bench.send(0x605, b"\x40\x41\x60\0\0\0\0\0")
    assert bench.frames(0x585) == []
    bench.nmt(0x01)
    assert bench.read(co.STATUSWORD) & 0x0200
    bench.nmt(0x82)
    assert bench.read(co.PROFILE_VELOCITY) == 77
    bench.nmt(0x81)
    assert bench.read(co.PROFILE_VELOCITY) == 1000


@pytest.mark.parametrize("command", [0xC0, 0x21, 0x00])
def test_block_transfer_and_segmented_downloads_are_refused(bench: CanopenBench, command: int) -> None:
    """No object that can be written is longer than four bytes."""
    bench.send(0x605, bytes([command, 0, 0, 0, 0, 0, 0, 0]))
    assert bench.frames(0x585)[0][4:] == (0x05040001).to_bytes(4, "little")
