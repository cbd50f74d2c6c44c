"""Motion of the simulated drive: velocity profile, homing, limits, switches, following error, and stops."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from labrig.devices.clocks import SimulatedClock
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import read_own_eds
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.shaft import Mechanics
from tests.devices import epos2_places as od
from tests.devices.rigs import epos2_node

OBJECTS = read_own_eds("epos2.eds").objects
COUNTS_PER_RPM = 2000 / 60
MECHANICS = Mechanics(
    lower_stop=-10_300.0,
    upper_stop=10_300.0,
    negative_switch=-9_100.0,
    positive_switch=9_100.0,
)


class MotionBench:
    """A drive whose objects are written directly, and its clock."""

    def __init__(self, mechanics: Mechanics, encoder_pulses: int) -> None:
        self.clock = SimulatedClock()
        self.drive = epos2_node(
            InProcessWire(), 1, self.clock, encoder_pulses=encoder_pulses, mechanics=mechanics
        )
        self.clock.on_advance(self.drive.tick)
        for word in (0x06, 0x0F):
            self.write(co.CONTROLWORD, word)

    def write(self, place: Place, value: int) -> None:
        """Write an object as a client does."""
        self.drive.tick()
        self.drive.objects.write(place, OBJECTS[place].encode_raw(value))

    def read(self, place: Place) -> int:
        """Read an object as a client does."""
        self.drive.tick()
        return int(OBJECTS[place].decode_raw(self.drive.objects.read(place)))

    def word(self) -> int:
        """Read the statusword."""
        return self.read(co.STATUSWORD)

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


@contextmanager
def bench(mechanics: Mechanics = MECHANICS, encoder_pulses: int = 500) -> Iterator[MotionBench]:
    """Set up an enabled drive."""
    made = MotionBench(mechanics, encoder_pulses)
    yield made
    made.drive.unplug()


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
    with bench() as b:
        b.write(od.HOME_POSITION, 50)
        b.home(method)
        b.clock.sleep(60.0)
        assert b.word() & 0xB400 == 0x9400
        assert b.drive.shaft_counts == pytest.approx(home, abs=1e-6)
        assert b.read(co.POSITION_ACTUAL) == 50


def test_the_attained_bit_is_cleared_by_a_new_start_and_halt_aborts() -> None:
    """Bit 12 belongs to the present homing; Halt ends it, also after Halt is released."""
    with bench() as b:
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
    with bench(Mechanics()) as b:
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
    with bench(Mechanics(positive_switch=5_000.0)) as b:
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
    with bench(Mechanics()) as b:
        b.write(co.QUICK_STOP_DECELERATION, 40_000)
        b.write(co.FAULT_REACTION, option)
        b.go(100_000)
        b.clock.sleep(0.5)
        b.drive.fail(code)
        assert b.word() & 0x6F == (0x08 if rpm_per_s is None else 0x0F)
        b.clock.sleep(1.0)
        assert b.word() & 0x6F == 0x08
        assert b.drive.shaft.still_s == pytest.approx(0.5 + (0.0 if rpm_per_s is None else 1000 / rpm_per_s))


def test_an_emergency_stop_lasts_until_power_is_back() -> None:
    """A fault cannot be reset while the supply is cut."""
    with bench() as b:
        b.drive.cut_power_stage()
        b.write(co.CONTROLWORD, 0x80)
        assert b.word() & 0x4F == 0x08
        b.drive.restore_power_stage()
        b.write(co.CONTROLWORD, 0)
        b.write(co.CONTROLWORD, 0x80)
        assert b.word() & 0x4F == 0x40


def test_a_restarted_drive_counts_from_zero_where_its_shaft_stands() -> None:
    """Settings, counter and reference are lost; nothing moves."""
    with bench(Mechanics()) as b:
        b.go(5_000)
        b.clock.sleep(5.0)
        b.drive.restart()
        assert (b.drive.shaft_counts, b.read(co.POSITION_ACTUAL)) == (5_000, 0)
