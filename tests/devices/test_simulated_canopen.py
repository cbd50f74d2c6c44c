"""CANopen of the simulated drive, as any client sees it: NMT, heartbeat, SDO, PDO, EMCY, and abort codes."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import can
import pytest

from labrig.devices.clocks import SimulatedClock
from labrig.devices.drives import epos2 as od
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import count_bytes, find_default, read_own_eds
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
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
    emergency = bench.drive.journal.last("emergency")
    assert emergency is not None
    assert emergency.t_s == pytest.approx(bench.clock.now_s() - 0.1)
    bench.write(co.CONTROLWORD, 0x80)
    assert bench.frames(0x085) == [bytes(8)]


def test_a_remapped_pdo_comes_on_sync(bench: CanopenBench) -> None:
    """Position and following error in a PDO at each SYNC."""
    mapping = co.TPDO_MAPS[2]
    for entry, value in (
        (mapping[0], 0),
        (mapping[1], 0x60640020),
        (mapping[2], 0x20F40010),
        (mapping[0], 2),
        (co.TPDO_TYPES[2], 1),
        (co.TRANSMIT_PDO_COB_IDS[2], 0x385),
    ):
        assert bench.write(entry, value) == 0
    bench.nmt(0x01)
    bench.send(0x080)
    assert bench.frames(0x385) == [bytes(6)]


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


def test_mapping_has_rules(bench: CanopenBench) -> None:
    """Unmappable objects, wrong or excessive lengths, and mapping outside PRE-OPERATIONAL are refused."""
    mapping = co.TPDO_MAPS[0]
    assert bench.write(mapping[0], 0) == 0
    assert bench.write(mapping[1], 0x10180120) == 0x06040041
    assert bench.write(mapping[1], 0x60640010) == 0x06040041
    for place in (1, 2, 3):
        assert bench.write(mapping[place], 0x60640020) == 0
    assert bench.write(mapping[0], 3) == 0x06040042
    bench.nmt(0x01)
    assert bench.write(mapping[0], 2) == 0x0F00FFC0
    bench.write(co.UPPER_LIMIT, 10)
    assert bench.write(co.LOWER_LIMIT, 11) == 0x06090036


def test_a_changed_setting_clears_the_configuration_fingerprint(bench: CanopenBench) -> None:
    """A new parameter value sets 0x1020 to zero; an equal value or process data does not."""
    bench.write(od.CONFIGURATION[0], 7)
    bench.write(od.CONFIGURATION[1], 9)
    bench.write(co.TARGET_POSITION, 100)
    bench.write(co.PROFILE_ACCELERATION, 10000)
    assert (bench.read(od.CONFIGURATION[0]), bench.read(od.CONFIGURATION[1])) == (7, 9)
    bench.write(co.PROFILE_ACCELERATION, 10001)
    assert (bench.read(od.CONFIGURATION[0]), bench.read(od.CONFIGURATION[1])) == (0, 0)


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


def test_a_stopped_node_sends_no_emergency(bench: CanopenBench) -> None:
    """In NMT STOPPED there is no EMCY; the error is in the history."""
    bench.nmt(0x02)
    bench.drive.fail(0x2310)
    assert bench.frames(0x085) == []
    bench.nmt(0x80)
    assert bench.read(co.LAST_ERROR) == 0x2310


def test_a_download_that_does_not_say_its_length_is_understood(bench: CanopenBench) -> None:
    """Clients may not state the number of bytes."""
    bench.send(0x605, b"\x22\x98\x60\0\x23\0\0\0")
    assert bench.frames(0x585)[0][0] == 0x60
    assert bench.read(co.HOMING_METHOD) == 35


def test_the_wire_loses_repeats_and_delays_frames(bench: CanopenBench) -> None:
    """Bus faults: a lost, a repeated and an overtaken frame, and no frames at all."""
    ask = b"\x40\x41\x60\0\0\0\0\0"
    bench.wire.lose(1)
    bench.send(0x605, ask)
    assert bench.frames(0x585) == []
    bench.wire.duplicate(1)
    bench.send(0x605, ask)
    assert len(bench.frames(0x585)) == 2
    bench.wire.delay(1, 0.05)
    bench.send(0x605, ask)
    assert bench.frames(0x585) == []
    bench.clock.sleep(0.06)
    assert len(bench.frames(0x585)) == 1
    bench.wire.enter_bus_off()
    bench.send(0x605, ask)
    assert bench.frames(0x585) == []
    bench.wire.restore()
    bench.send(0x605, ask)
    assert len(bench.frames(0x585)) == 1


def test_a_booting_drive_is_silent_until_it_announces_itself() -> None:
    """A reset takes time; nothing is sent before the boot-up frame at its end."""
    clock, wire = SimulatedClock(), InProcessWire()
    heard: list[int] = []
    bus = InProcessBus(wire, lambda message: heard.append(message.arbitration_id))
    drive = epos2_node(wire, NODE, clock, boot_time_s=0.26)
    clock.on_advance(drive.tick)
    heard.clear()
    drive.restart()
    clock.sleep(0.25)
    assert heard == []
    clock.sleep(0.02)
    assert heard == [0x705]
    drive.unplug()
    bus.shutdown()


def test_an_emergency_goes_out_under_its_own_cob_id(bench: CanopenBench) -> None:
    """0x1014 can be written; with its highest bit set the drive sends no EMCY."""
    assert bench.read(co.EMERGENCY_ID) == 0x80 + NODE
    bench.write(co.EMERGENCY_ID, 0x90)
    bench.drive.fail(0x8110)
    assert bench.frames(0x090) == [b"\x10\x81\x11\0\0\0\0\0"]
    bench.write(co.EMERGENCY_ID, 0x80000090)
    bench.drive.fail(0x8111)
    assert bench.frames(0x090) + bench.frames(0x080 + NODE) == []


def test_a_masked_input_is_not_shown(bench: CanopenBench) -> None:
    """0x2071:01 shows the inputs of the mask 0x2071:02; by default position marker and drive enable are hidden."""
    bench.drive.press(0xFFFF)
    assert bench.read(od.INPUT_STATE) == 0xE387
    bench.write(od.INPUT_MASK, 0x0010)
    assert bench.read(od.INPUT_STATE) == 0x0010


def test_it_announces_itself_and_says_its_name_in_segments(bench: CanopenBench) -> None:
    """The first frame is the boot-up; the name 0x1008 is longer than four bytes."""
    assert bench.frames(0x705) == [b"\0"]
    bench.send(0x605, b"\x40\x08\x10\0\0\0\0\0")
    bench.send(0x605, b"\x60" + bytes(7))
    assert bench.frames(0x585)[1][1:6] == b"EPOS2"


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
