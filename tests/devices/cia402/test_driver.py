"""The CiA 402 driver against a simulated drive, over the bus."""

from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest

from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Homing
from labrig.devices.drives.generic import DRIVE
from labrig.devices.drives.objects import Place
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.homing import HOMING_HERE
from labrig.errors import (
    DriveError,
    DriveFaultError,
    DriveRefusedError,
    InputError,
)
from tests.devices.cia402.eds_text import eds_text, entry
from tests.devices.cia402.sections import (
    HEARTBEAT,
    ProfileDriveOnABus,
    drive_on_a_bus,
    other_make,
    section_of,
)

GUARDS = (0x6007, 0x603F, 0x605A, 0x605B, 0x605C, 0x605E, 0x6065, 0x6066, 0x607D, 0x607F, 0x6084, 0x6086)
OPTIONAL = (0x1003, 0x1A02, 0x1802, 0x6061, 0x6099, 0x609A, 0x60A8, 0x60A9, 0x60AA, 0x60C5, 0x60FD, 0x6502)


@pytest.fixture(name="bare")
def _bare() -> Iterator[ProfileDriveOnABus]:
    with drive_on_a_bus(DRIVE.example(1)) as bare:
        yield bare


@pytest.fixture(name="ready")
def _ready(bare: ProfileDriveOnABus) -> ProfileDriveOnABus:
    bare.get_ready()
    return bare


def _values(on_a_bus: ProfileDriveOnABus, *places: Place) -> tuple[int, ...]:
    return tuple(map(on_a_bus.node.objects.value, places))


def _hear_and_lose(on_a_bus: ProfileDriveOnABus) -> None:
    """Let the drive hear one beat of the computer, and then none."""
    on_a_bus.link.send(0x700 + HEARTBEAT.computer_node_id, b"\x05")
    on_a_bus.wait(1.0)


def test_safety_settings_are_written_and_read_back(bare: ProfileDriveOnABus) -> None:
    """Heartbeats, option codes, following error, decelerations; a drive set to ignore silence is changed."""
    objects = bare.node.objects
    objects.values |= {co.ABORT_CONNECTION: 0, co.QUICK_STOP_OPTION: 5, co.FAULT_REACTION: 0}
    bare.driver.identify()
    bare.driver.configure(HEARTBEAT, None)
    assert _values(bare, co.ABORT_CONNECTION, co.QUICK_STOP_OPTION, co.FAULT_REACTION) == (1, 6, 2)
    assert _values(bare, co.CONSUMER_HEARTBEAT, co.PRODUCER_HEARTBEAT) == (127 << 16 | 500, 100)
    assert _values(bare, co.MAX_FOLLOWING_ERROR, co.FOLLOWING_ERROR_TIMEOUT) == (2000, 0)
    assert _values(bare, co.PROFILE_DECELERATION, co.QUICK_STOP_DECELERATION) == (3000, 12_000)
    described = bare.driver.describe()
    settings = described["drive_settings"]
    assert isinstance(settings, dict)
    assert settings["0x6007:00"] == 1
    assert {"0x6067:00", "0x605D:00", "0x607C:00"}.isdisjoint(settings)


@pytest.mark.parametrize(("option", "faulted"), [(1, True), (3, False)])
def test_a_silent_computer_stops_the_axis(option: int, faulted: bool, tmp_path: Path) -> None:
    """By a fault or a quick stop, as the section says, with an emergency."""
    with drive_on_a_bus(section_of(tmp_path, abort_connection_option=option)) as one:
        one.get_ready()
        one.driver.start_move(50.0, 1.0)
        _hear_and_lose(one)
        before = one.node.shaft_counts
        one.wait(0.5)
        assert one.node.shaft_counts == before != 0
        assert bool(one.driver.faults()) is faulted
        with pytest.raises(DriveFaultError, match="error 0x8130, life guarding or heartbeat"):
            one.driver.check()


def test_a_reset_of_the_communication_restores_heartbeats(ready: ProfileDriveOnABus) -> None:
    """An EPOS4 needs a communication reset first, which clears both heartbeats."""
    _hear_and_lose(ready)
    assert ready.driver.faults()[0].code == 0x8130
    ready.driver.reset_fault()
    assert ready.driver.faults() == ()
    assert _values(ready, co.CONSUMER_HEARTBEAT, co.PRODUCER_HEARTBEAT) == (127 << 16 | 500, 100)
    ready.driver.enable()
    _hear_and_lose(ready)
    assert ready.driver.faults()


def test_a_quick_stop_may_end_without_power(tmp_path: Path) -> None:
    """With 0x605A = 2 the drive switches off; it can be enabled again."""
    with drive_on_a_bus(section_of(tmp_path, quick_stop_option=2)) as one:
        one.get_ready()
        one.driver.start_move(50.0, 5.0)
        one.wait(0.5)
        one.driver.stop(quick=True)
        one.driver.settle(2.0)
        assert decode_state(one.driver.statusword()) is DriveState.SWITCH_ON_DISABLED
        one.driver.enable()
        one.driver.start_move(0.0, 5.0)


def test_a_drive_with_only_the_required_objects_moves(tmp_path: Path) -> None:
    """Without any optional object it homes, moves and stops."""
    section = section_of(tmp_path, eds_text(without=(*GUARDS, *OPTIONAL)), objects={})
    with drive_on_a_bus(section) as one:
        one.get_ready()
        one.home(Homing(HOMING_HERE))
        one.driver.set_limits((-1.0, 1.0))
        one.driver.start_move(2.0, 5.0)
        one.wait(2.0)
        assert one.driver.read().target_reached
        assert one.node.shaft_counts == 4000
        assert (one.driver.current_ma(), one.driver.current_limit_ma()) == (None, None)
        with pytest.raises(DriveError, match=r"no current limit that labrig can set.*") as refusal:
            one.driver.configure(HEARTBEAT, 500)
        assert "--current-ma 0" in refusal.value.hint
        one.node.fail(0x2310)
        assert one.driver.faults()[0].code == 0


def test_widths_are_those_of_the_eds_file(tmp_path: Path) -> None:
    """A 16-bit deceleration is written in two bytes; a larger value is refused before it is sent."""
    narrow = entry("6085", "H", default=100, low=1, name="quick stop deceleration")
    section = section_of(tmp_path, eds_text(narrow))
    with drive_on_a_bus(section) as one:
        one.get_ready()
        assert _values(one, co.QUICK_STOP_DECELERATION) == (12_000,)
        one.link.network.take_frames()
        with pytest.raises(
            DriveError, match=r"does not take quick stop deceleration \(0x6085:00\) = 70000, only 1"
        ):
            one.driver.download(co.QUICK_STOP_DECELERATION, 70_000)
        assert one.link.network.take_frames() == []
    with drive_on_a_bus(section, DRIVE.example(1)) as other:
        other.driver.identify()
        with pytest.raises(DriveRefusedError, match="0x6085:00"):
            other.driver.configure(HEARTBEAT, None)


ANOTHER: dict[str, tuple[Place, int, str]] = {
    "product": (co.PRODUCT_CODE, 0x62200000, r"product 0x62200000; .* is for vendor .* product 0x61500000"),
    "vendor": (co.VENDOR_ID, 0x2F, r"has vendor 0x0000002F, product"),
    "profile": (co.DEVICE_TYPE, 401, r"device type 0x00000191 \(0x1000:00\), expected a CiA 402 drive"),
    "modes": (co.SUPPORTED_MODES, 0x24, r"lacks profile position or homing mode \(0x6502:00 is 0x00000024\)"),
    "velocity": (
        co.VELOCITY_UNIT,
        0xFDB44700,
        r"velocity_unit 0.001 rpm \(0x60A9:00\), the rig file says 1 rpm",
    ),
    "acceleration": (co.ACCELERATION_UNIT, 0xFEC00300, "acceleration_unit 0.01 rpm/s"),
    "encoder": (Place(0x3000, 5), 4096, r"counts_per_turn 4096 \(0x3000:05\), the rig file says 2000"),
}


@pytest.mark.parametrize(("place", "value", "words"), ANOTHER.values(), ids=ANOTHER)
def test_another_drive_is_refused(bare: ProfileDriveOnABus, place: Place, value: int, words: str) -> None:
    """The error has index, value, expected value and remedy; nothing is written."""
    bare.node.objects.set_fixed(place, value)
    with pytest.raises(DriveError, match=words) as refusal:
        bare.driver.identify()
    assert refusal.value.hint
    sent = [data for _, can_id, data, way in bare.link.network.take_frames() if way == "T" and can_id > 0x600]
    assert all(data[0] == 0x40 for data in sent)


UNITS = [
    ("rpm", 0.001, "rpm/s", 0.1),
    ("turns/s", 0.0001, "turns/s^2", 0.01),
    ("counts/s", 1.0, "counts/s^2", 10.0),
]


@pytest.mark.parametrize(("velocity", "factor", "acceleration", "its_factor"), UNITS)
def test_stated_units_make_the_same_motion(
    velocity: str, factor: float, acceleration: str, its_factor: float, tmp_path: Path
) -> None:
    """2 mm at 0.5 mm/s take the same time in any units of the drive."""
    units = {"velocity_unit": velocity, "velocity_factor": factor}
    units |= {"acceleration_unit": acceleration, "acceleration_factor": its_factor}
    with drive_on_a_bus(section_of(tmp_path, eds_text(without=[0x60AA]), acceleration=0.5, **units)) as one:
        one.get_ready()
        began_s = one.clock.now_s()
        rounded = one.driver.round_move(2.0, 0.5)
        assert rounded.position == 2.0
        assert rounded.speed == pytest.approx(0.5, rel=1e-3)
        one.driver.start_move(2.0, 0.5)
        while one.driver.read().position < 1.0:
            one.clock.sleep(0.001)
        # Half of the way and half of the time that speeding up takes.
        assert one.clock.now_s() - began_s == pytest.approx(1.0 / 0.5 + 0.5 * 0.5 / 0.5, abs=0.02)


def test_homing_at_a_switch_ends_with_the_counter_at_home(ready: ProfileDriveOnABus) -> None:
    """Method 17 goes back to the negative switch; the section's object holds the home position."""
    homing = Homing(17, position=-3.0, speed=5.0, timeout_s=20.0)
    ready.home(homing)
    assert ready.node.shaft_counts == -8000
    assert ready.driver.position() == -3.0
    assert ready.driver.is_referenced()


def test_a_home_position_of_the_other_sign_is_noticed(ready: ProfileDriveOnABus) -> None:
    """A drive that sets its counter to the negated value is refused."""
    homing = ready.driver.home(Homing(17, position=-3.0, speed=5.0, timeout_s=20.0))
    next(homing)
    ready.node.objects.values[Place(0x30B0)] *= -1
    ready.wait(10.0)
    with pytest.raises(DriveError, match="opposite sign for the home position"):
        deque(homing)
    assert ready.driver.decode(ready.driver.statusword()) is DriveState.OPERATION_ENABLED


def test_a_home_position_without_an_object_is_refused(tmp_path: Path) -> None:
    """Before anything is written; so is a distance off the switch."""
    with drive_on_a_bus(section_of(tmp_path, objects={})) as one:
        one.get_ready()
        for homing in (Homing(HOMING_HERE, position=1.0), Homing(17, offset=1.0)):
            with pytest.raises(DriveError, match="has no home position but zero"):
                one.home(homing)


def test_an_unreported_reference_ends_with_closing(tmp_path: Path) -> None:
    """After reopening, the drive counts as not referenced."""
    with drive_on_a_bus(other_make(tmp_path)) as one:
        one.get_ready()
        assert not one.driver.is_referenced()
        one.home(Homing(HOMING_HERE))
        assert one.driver.is_referenced()
        one.node.restart()
        assert not one.driver.is_referenced()


def test_standard_currents_are_thousandths_of_the_rated_one(tmp_path: Path) -> None:
    """0x6078 and 0x6073 with 0x6075; closing restores the drive's own limit."""
    with drive_on_a_bus(other_make(tmp_path)) as one:
        one.get_ready()
        one.driver.start_move(-2.0, 1.0)
        one.wait(0.5)
        assert (one.driver.current_ma(), one.driver.current_limit_ma()) == (-60.0, 10_000)
        one.wait(3.0)
        one.driver.configure(HEARTBEAT, 1234)
        assert one.driver.current_limit_ma() == 1230
        one.driver.close()
        assert one.driver.current_limit_ma() == 10_000


@pytest.mark.parametrize(
    ("code", "words"),
    [(0x8611, "following error"), (0x5441, r"unknown to labrig \(hardware"), (0xFF01, "unknown to labrig")],
)
def test_an_error_is_described_by_its_code_or_class(ready: ProfileDriveOnABus, code: int, words: str) -> None:
    """The code comes from 0x603F; each has a remedy."""
    ready.node.fail(code)
    ready.wait(0.5)
    (fault,) = ready.driver.faults()
    assert fault.code == code
    with pytest.raises(DriveFaultError, match=words):
        ready.driver.raise_if_faulted()
    assert fault.hint


def test_a_fault_whose_cause_persists_is_not_reset(ready: ProfileDriveOnABus) -> None:
    """The supply of the power stage must be back first."""
    ready.node.cut_power_stage()
    with pytest.raises(DriveFaultError, match="its cause is still there"):
        ready.driver.reset_fault()
    ready.node.mend()
    ready.driver.reset_fault()
    ready.driver.enable()


def test_a_drive_without_its_eds_file_can_be_stopped(tmp_path: Path) -> None:
    """`labrig devices stop` needs no file; moving the axis names the missing one."""
    section = DRIVE.example(1).model_copy(update={"eds": "none.eds"}).placed_in(tmp_path)
    with drive_on_a_bus(section, DRIVE.example(1)) as one:
        other = type(one.driver)(one.link, DRIVE.example(1), "rotation", one.clock)
        other.configure(HEARTBEAT, None)
        other.enable()
        other.start_move(50.0, 5.0)
        one.driver.stop(quick=True)
        one.driver.settle(2.0)
        assert not one.node.is_moving
        with pytest.raises(InputError, match=r"none\.eds does not exist"):
            one.driver.identify()
