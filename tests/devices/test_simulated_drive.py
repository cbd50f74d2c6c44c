"""The simulated drive as any CANopen client sees it: NMT, heartbeat, SDO, EMCY, abort codes, motion and homing."""

from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest

from labrig.devices.clocks import SimulatedClock
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import count_bytes, find_default, read_own_eds
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.shaft import Mechanics
from tests.devices import epos2_places as od
from tests.devices.rigs import epos2_node, ready_rig

NODE = 5
OBJECTS = read_own_eds("epos2.eds").objects
TOO_LONG, TOO_SHORT, READ_ONLY = 0x06070012, 0x06070013, 0x06010002
COUNTS_PER_RPM = 2000 / 60
MECHANICS = Mechanics(
    lower_stop=-10_300.0,
    upper_stop=10_300.0,
    negative_switch=-9_100.0,
    positive_switch=9_100.0,
)


class Bench:
    """One drive, a clock, and everything that was on the bus."""

    def __init__(self, mechanics: Mechanics) -> None:
        self.clock, wire = SimulatedClock(), InProcessWire()
        self.heard: list[can.Message] = []
        self.bus = InProcessBus(wire, self.heard.append)
        self.drive = epos2_node(wire, NODE, self.clock, mechanics=mechanics)
        self.clock.on_advance(self.drive.tick)

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

    def word(self) -> int:
        """Read the statusword."""
        return self.read(co.STATUSWORD)

    def enable(self) -> None:
        """Switch power on."""
        for word in (0x06, 0x0F):
            self.write(co.CONTROLWORD, word)

    def go(self, target: int) -> None:
        """Start a move."""
        self.write(co.TARGET_POSITION, target)
        self.write(co.CONTROLWORD, 0x3F)
        self.write(co.CONTROLWORD, 0x0F)

    def home(self, method: int) -> None:
        """Start homing."""
        self.write(co.MODE, 6)
        self.write(co.HOMING_METHOD, method)
        self.write(co.CONTROLWORD, 0x0F)
        self.write(co.CONTROLWORD, 0x1F)


@pytest.fixture(name="bench")
def _bench() -> Bench:
    return Bench(Mechanics())


@contextmanager
def enabled(mechanics: Mechanics = MECHANICS) -> Iterator[Bench]:
    """Set up an enabled drive."""
    made = Bench(mechanics)
    made.enable()
    yield made


def test_the_heartbeat_carries_the_nmt_state(bench: Bench) -> None:
    """Pre-operational, operational and stopped are 127, 5 and 4, once per period."""
    bench.frames(0x705)
    bench.write(co.PRODUCER_HEARTBEAT, 100)
    for command, state in ((0x80, 127), (0x01, 5), (0x02, 4)):
        bench.nmt(command)
        bench.frames(0x705)
        for _ in range(50):
            bench.clock.sleep(0.01)
        assert bench.frames(0x705) == [bytes([state])] * 5


def test_a_missed_heartbeat_is_an_error_after_its_time_and_not_before(bench: Bench) -> None:
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
def test_refusals_carry_maxons_codes(bench: Bench, place: Place, value: int, code: int) -> None:
    """Each invalid write is aborted with the code for its reason."""
    assert bench.write(place, value) == code


def test_error_history_is_newest_first_and_can_be_cleared(bench: Bench) -> None:
    """Writing zero to the count of 0x1003 empties it."""
    for code in (0x2310, 0x3210):
        bench.drive.fail(code)
    assert [bench.read(entry) for entry in co.ERROR_HISTORY[:3]] == [0x3210, 0x2310, 0]
    assert bench.read(co.ERROR_COUNT) == 2
    bench.write(co.ERROR_COUNT, 0)
    assert bench.read(co.LAST_ERROR) == 0


def test_bus_errors_need_reset_communication_before_they_can_be_reset(bench: Bench) -> None:
    """After CAN passive a fault reset does nothing until NMT reset communication."""
    bench.drive.fail(0x8120)
    bench.write(co.CONTROLWORD, 0x80)
    assert bench.read(co.STATUSWORD) & 0x4F == 0x08
    bench.write(co.CONTROLWORD, 0)
    bench.nmt(0x82)
    bench.write(co.CONTROLWORD, 0x80)
    assert bench.read(co.STATUSWORD) & 0x4F == 0x40


def test_a_download_that_does_not_say_its_length_is_understood(bench: Bench) -> None:
    """Clients may not state the number of bytes."""
    bench.send(0x605, b"\x22\x98\x60\0\x23\0\0\0")
    assert bench.frames(0x585)[0][0] == 0x60
    assert bench.read(co.HOMING_METHOD) == 35


def test_every_number_has_its_width_and_default(bench: Bench) -> None:
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


@pytest.mark.parametrize("command", [0xC0, 0x21, 0x00])
def test_block_transfer_and_segmented_downloads_are_refused(bench: Bench, command: int) -> None:
    """No object that can be written is longer than four bytes."""
    bench.send(0x605, bytes([command, 0, 0, 0, 0, 0, 0, 0]))
    assert bench.frames(0x585)[0][4:] == (0x05040001).to_bytes(4, "little")


@pytest.mark.parametrize(
    ("method", "home"),
    [
        (-1, 10_000.0),
        (-2, -10_000.0),
        (-3, 10_300.0),
        (-4, -10_300.0),
        (1, -8_000.0),
        (2, 8_000.0),
        (17, -9_100.0),
        (18, 9_100.0),
        (35, 0.0),
    ],
)
def test_homing_ends_where_the_method_says(method: int, home: float) -> None:
    """Signs are maxon's: -1 and -3 go forward, -2 and -4 backward, then to the next index."""
    with enabled() as b:
        b.write(od.HOME_POSITION, 50)
        b.home(method)
        b.clock.sleep(60.0)
        assert b.word() & 0xB400 == 0x9400
        assert b.drive.shaft_counts == pytest.approx(home, abs=1e-6)
        assert b.read(co.POSITION_ACTUAL) == 50


def test_the_attained_bit_is_cleared_by_a_new_start_and_halt_aborts() -> None:
    """Bit 12 belongs to the present homing; Halt ends it, also after Halt is released."""
    with enabled() as b:
        b.home(35)
        assert b.word() & 0x1000
        b.home(-4)
        assert not b.word() & 0x1000
        b.clock.sleep(1.0)
        b.write(co.CONTROLWORD, 0x11F)
        b.clock.sleep(2.0)
        before = b.drive.shaft_counts
        b.write(co.CONTROLWORD, 0x0F)
        b.clock.sleep(2.0)
        assert b.drive.shaft_counts == before
        assert not b.word() & 0x1000
        last = b.drive.find_last("homing")
        assert last is not None
        assert last.text == "stopped"


def test_a_blocked_shaft_becomes_a_following_error() -> None:
    """0x8611 as soon as the shaft lags by more than 0x6065."""
    with enabled(Mechanics()) as b:
        b.go(100_000)
        b.clock.sleep(0.5)
        b.drive.shaft.jam()
        before = b.drive.shaft_counts
        b.clock.sleep(1.0)
        assert b.word() & 0x6F == 0x08
        assert b.read(co.LAST_ERROR) == 0x8611
        assert b.drive.shaft_counts == before
        emergency = b.drive.find_last("emergency")
        assert emergency is not None
        assert emergency.t_s == pytest.approx(0.5 + 2000 / (1000 * COUNTS_PER_RPM), abs=1e-4)


def test_limit_switches_do_nothing_until_their_mask_says_so() -> None:
    """By default the axis passes the switch; with its bit in 0x2071:04 it stops with 0xFF07."""
    with enabled(Mechanics(positive_switch=5_000.0)) as b:
        b.go(10_000)
        b.clock.sleep(2.0)
        assert b.word() & 0x0400
        assert b.read(od.INPUT_STATE) == 2
        b.go(0)
        b.clock.sleep(2.0)
        b.write(od.LIMIT_EXECUTION_MASK, 3)
        b.go(10_000)
        b.clock.sleep(2.0)
        assert b.read(co.LAST_ERROR) == 0xFF07


@pytest.mark.parametrize(
    ("code", "option", "rpm_per_s"),
    [
        *((code, 2, None) for code in (0x2310, 0x3220, 0xFF01)),
        (0x8611, 0, None),
        *(
            (code, option, rpm)
            for code in (0x8130, 0x8611, 0xFF09)
            for option, rpm in ((1, 10_000), (2, 40_000))
        ),
    ],
)
def test_an_error_takes_power_at_once_or_brakes_first(code: int, option: int, rpm_per_s: int | None) -> None:
    """By itself, or as 0x605E says. 0: at once; 1: with the profile deceleration; 2: with that of the quick stop."""
    with enabled(Mechanics()) as b:
        b.write(co.QUICK_STOP_DECELERATION, 40_000)
        b.write(co.FAULT_REACTION, option)
        b.go(100_000)
        b.clock.sleep(0.5)
        b.drive.fail(code)
        assert b.word() & 0x6F == (0x08 if rpm_per_s is None else 0x0F)
        b.clock.sleep(1.0)
        assert b.word() & 0x6F == 0x08
        assert b.drive.shaft.still_s == pytest.approx(0.5 + (0.0 if rpm_per_s is None else 1000 / rpm_per_s))


def test_a_restarted_drive_counts_from_zero_where_its_shaft_stands() -> None:
    """Settings, counter and reference are lost; nothing moves."""
    with enabled(Mechanics()) as b:
        b.go(5_000)
        b.clock.sleep(5.0)
        b.drive.restart()
        assert (b.drive.shaft_counts, b.read(co.POSITION_ACTUAL)) == (5_000, 0)


def test_a_blocked_drive_shows_its_current_and_an_uncoupled_one_none() -> None:
    """What holds the shaft is felt; a motor that has lost its shaft only lags."""
    with ready_rig() as opened:
        for name in ("insertion", "linear"):
            opened.rig.axis(name).start_move(20.0, 5.0)
        opened.rig.wait(0.5)
        opened.drives["insertion"].shaft.jam()
        opened.drives["linear"].shaft.uncouple()
        opened.hardware.clock.sleep(0.05)
        currents = [opened.drives[name]._read_current_ma() for name in ("insertion", "linear")]
        assert currents[0] > 1000
        assert currents[1] == 0.0
