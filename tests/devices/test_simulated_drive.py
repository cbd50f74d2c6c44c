"""The simulated drive as any CANopen client sees it: NMT, heartbeat, SDO, EMCY, abort codes and reactions to faults."""

import math
import struct
from collections.abc import Iterator

import can
import pytest

from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import count_bytes, find_default, read_own_eds
from labrig.devices.drives.epos2 import DRIVE
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.bus import InProcessBus
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.devices.simulated.shaft import Mechanics
from tests.devices import epos2_places as od
from tests.devices.rigs import OneDrive, instants, one_drive, simulated_rig

NODE = 5
OBJECTS = read_own_eds("epos2.eds").objects
TOO_LONG, TOO_SHORT, READ_ONLY = 0x06070012, 0x06070013, 0x06010002


class Bench:
    """One drive, a clock, and everything that was on the bus."""

    def __init__(self, one: OneDrive) -> None:
        self.clock, self.drive = one.clock, one.drive
        self.heard: list[can.Message] = []
        self.bus = InProcessBus(one.wire, self.heard.append)

    def send(self, can_id: int, data: bytes = b"") -> None:
        """Send a frame."""
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def nmt(self, command: int) -> None:
        """Send an NMT command."""
        self.send(0x000, bytes([command, NODE]))

    def frames(self, can_id: int) -> list[bytes]:
        """Return and forget what was heard under an id."""
        found = [bytes(message.data) for message in self.heard if message.arbitration_id == can_id]
        self.heard[:] = [message for message in self.heard if message.arbitration_id != can_id]
        return found

    def ask(self, command: int, place: Place, data: bytes = b"") -> bytes:
        """Send an SDO request, and return the answer."""
        self.send(0x600 + NODE, struct.pack("<BHB4s", command, *place, data))
        (answer,) = self.frames(0x580 + NODE)
        return answer

    def write(self, place: Place, value: int, wider: int = 0) -> int:
        """Write an object, in its width or a wider one; return 0 or the abort code."""
        data = OBJECTS[place].encode_raw(value) if place in OBJECTS else bytes([value])
        answer = self.ask(0x23 | (4 - len(data) - wider) << 2, place, data)
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0

    def read(self, place: Place) -> int:
        """Read an object, whose answer has its width."""
        answer, variable = self.ask(0x40, place), OBJECTS[place]
        assert 4 - (answer[0] >> 2 & 3) == count_bytes(variable)
        return int(variable.decode_raw(answer[4 : 4 + count_bytes(variable)]))


@pytest.fixture(name="bench")
def _bench() -> Iterator[Bench]:
    with one_drive(DRIVE.example(NODE), mechanics=Mechanics()) as one:
        yield Bench(one)


def test_the_heartbeat_carries_the_nmt_state(bench: Bench) -> None:
    """Pre-operational, operational and stopped are 127, 5 and 4, once per period."""
    bench.write(co.PRODUCER_HEARTBEAT, 100)
    for command, state in ((0x80, 127), (0x01, 5), (0x02, 4)):
        bench.nmt(command)
        bench.frames(0x705)
        bench.clock.sleep(0.5)
        assert bench.frames(0x705) == [bytes([state])] * 5


def test_a_missed_heartbeat_is_an_error_after_its_time_and_not_before(bench: Bench) -> None:
    """0x8130 comes 500 ms after the last heartbeat, and never before the first one."""
    bench.write(co.CONSUMER_HEARTBEAT, 127 << 16 | 500)
    bench.clock.sleep(2.0)
    for _ in range(10):
        bench.send(0x77F, b"\x05")
        bench.clock.sleep(0.4)
    assert bench.frames(0x085) == []
    bench.clock.sleep(0.2)
    assert bench.frames(0x085) == [b"\x30\x81\x01\0\0\0\0\0"]
    assert instants(bench.drive, "emergency")[-1] == pytest.approx(bench.clock.now_s() - 0.1)
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
        (od.FOLLOWING_ERROR_ACTUAL, 1, READ_ONLY),
    ],
)
def test_refusals_carry_maxons_codes(bench: Bench, place: Place, value: int, code: int) -> None:
    """Each invalid write is aborted with the code for its reason."""
    assert bench.write(place, value) == code


@pytest.mark.parametrize("command", [0xC0, 0x21, 0x00])
def test_block_transfer_and_segmented_downloads_are_refused(bench: Bench, command: int) -> None:
    """No object that can be written is longer than four bytes; one whose length is not said is taken."""
    assert bench.ask(command, Place(0))[4:] == (0x05040001).to_bytes(4, "little")
    assert bench.ask(0x22, co.HOMING_METHOD, b"\x23")[0] == 0x60


def test_every_number_has_its_width_and_default(bench: Bench) -> None:
    """Writes of another width, and to what can only be read, are refused by the code that says why."""
    own = {co.STATUSWORD, co.SERIAL_NUMBER}
    for place, variable in OBJECTS.items():
        assert bench.read(place) == find_default(variable) + NODE * variable.relative or place in own, place
        for wider, code in ((1, TOO_LONG), (-1, TOO_SHORT)):
            if variable.access_type == "rw" and 0 < count_bytes(variable) + wider <= 4:
                assert bench.write(place, 0, wider) == code
        if variable.access_type == "ro":
            assert bench.write(place, 0) == READ_ONLY


def test_a_stopped_node_answers_nothing_and_a_reset_one_forgets(bench: Bench) -> None:
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


REACTIONS = [
    *((code, 2, math.inf) for code in (0x2310, 0x3220, 0xFF01)),
    (0x8611, 0, math.inf),
    *((code, option, rpm) for code in (0x8130, 0xFF09) for option, rpm in ((1, 10_000), (2, 40_000))),
]


@pytest.mark.parametrize(("code", "option", "rpm_per_s"), REACTIONS)
def test_an_error_takes_power_at_once_or_brakes_first(
    bench: Bench, code: int, option: int, rpm_per_s: float
) -> None:
    """By itself, or as 0x605E says. 0: at once; 1: with the profile deceleration; 2: with that of the quick stop."""
    settings = {co.QUICK_STOP_DECELERATION: 40_000, co.FAULT_REACTION: option, co.TARGET_POSITION: 100_000}
    for place, value in (*settings.items(), *((co.CONTROLWORD, word) for word in (0x06, 0x0F, 0x3F))):
        bench.write(place, value)
    bench.clock.sleep(0.5)
    bench.drive.fail(code)
    assert bench.read(co.STATUSWORD) & 0x6F == (0x08 if math.isinf(rpm_per_s) else 0x0F)
    bench.clock.sleep(1.0)
    assert bench.read(co.STATUSWORD) & 0x6F == 0x08
    assert bench.read(co.LAST_ERROR) == code
    assert bench.drive.shaft.still_s == pytest.approx(0.5 + 1000 / rpm_per_s)


def test_a_scripted_fault_waits_for_its_time_and_for_the_axis() -> None:
    """It occurs after `at_s` and only while the axis moves; the drive's journal has the instant."""
    timed = "{fault: emergency, axis: linear, code: 0x2310, at_s: 1.5}"
    rig = simulated_rig(f"faults=[{{fault: boot-up, axis: insertion, at_s: 1, once: moving}}, {timed}]")
    assert rig.world is not None
    hardware = SimulatedHardware(rig, rig.world, seed=1)
    hardware.clock.sleep(2.0)
    assert instants(hardware.drives["linear"], "emergency") == [pytest.approx(1.5)]
    assert len(hardware.faults.waiting) == 1
    drive = hardware.drives["insertion"]
    drive.objects.put(co.TARGET_POSITION, 100_000)
    for word in (0x06, 0x0F, 0x3F):
        drive.objects.put(co.CONTROLWORD, word)
    hardware.clock.sleep(0.1)
    assert instants(drive, "boot")[-1] == drive.shaft.still_s == 2.1
    hardware.close()
