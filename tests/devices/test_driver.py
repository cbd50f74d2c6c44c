"""The CiA 402 driver against simulated drives, over the bus: what the conformance suite does not ask of every drive."""

import math
from collections import deque
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives import objects as co
from labrig.devices.drives.cia402 import still_time_s
from labrig.devices.drives.drive import HERE, STILL_COUNTS, Homing
from labrig.devices.drives.generic import DRIVE
from labrig.devices.drives.objects import Place
from labrig.devices.drives.states import ENABLE, HALT, NEW_SETPOINT, DriveState, decode_state
from labrig.devices.input_channel import InputChannel
from labrig.errors import DriveError, DriveFaultError, InputError
from tests.devices import epos2_places as od
from tests.devices.eds_text import eds_text, entry, other_make, section_of
from tests.devices.rigs import HEARTBEAT, OneDrive, one_drive

GUARDS = (0x6007, 0x603F, 0x605A, 0x605B, 0x605C, 0x605E, 0x6065, 0x6066, 0x607D, 0x607F, 0x6084, 0x6086)
OPTIONAL = (0x1003, 0x1A02, 0x1802, 0x6061, 0x6099, 0x609A, 0x60A8, 0x60A9, 0x60AA, 0x60C5, 0x60FD, 0x6502)
EPOS4 = DRIVE.example(1)


@pytest.fixture(name="epos2")
def _epos2() -> Iterator[OneDrive]:
    with one_drive() as one:
        yield one


@pytest.fixture(name="ready")
def _ready(epos2: OneDrive) -> OneDrive:
    epos2.get_ready()
    return epos2


@pytest.fixture(name="ready4")
def _ready4() -> Iterator[OneDrive]:
    with one_drive(EPOS4) as one:
        one.get_ready()
        yield one


def _state(one: OneDrive) -> DriveState:
    return decode_state(one.driver.upload(co.STATUSWORD))


def _fault(one: OneDrive) -> DriveFaultError:
    fault = one.driver.fault()
    assert fault is not None
    return fault


@pytest.mark.parametrize(
    ("code", "revision", "model"),
    [(0x61200000, 0x21010000, "EPOS2 Module 36/2"), (0x64200000, 0x21260000, "EPOS2 70/10")],
)
def test_a_known_type_of_an_epos2_is_accepted(code: int, revision: int, model: str) -> None:
    """The last digit of the hardware version, its revision, does not matter."""
    with one_drive(fixed={co.PRODUCT_CODE: code, co.REVISION: revision}) as one:
        found = one.driver.identify().document()
    assert found == {"model": model, "product_code": code, "revision_number": revision, "serial_number": 1001}


def test_an_unknown_type_is_accepted_by_the_version_in_the_rig_file() -> None:
    """Refused at first, with the key that accepts it; with that key it is driven, and no other drive is."""
    words = "is no EPOS2 that labrig knows: .*, product code 0x65520000"
    with one_drive(fixed={co.PRODUCT_CODE: 0x65520000}) as one:
        with pytest.raises(DriveError, match=words) as refusal:
            one.driver.read_identity()
        assert "EPOS2 70/10 (0x64200000)" in str(refusal.value.hint)
        assert "enter its hardware_version" in str(refusal.value.hint)
        assert one.reopen(hardware_version=0x6552).identify().model == "EPOS2 of hardware version 0x6552"
        with pytest.raises(DriveError, match=words):
            one.reopen(hardware_version=0x6562).read_identity()


@pytest.mark.parametrize(
    ("section", "place", "value", "words"),
    [
        (EPOS4, co.PRODUCT_CODE, 0x62200000, "is no EPOS4 Module 50/5 .* product code 0x62200000"),
        (EPOS4, co.VENDOR_ID, 0x2F, "profile 402, vendor 0x2F"),
        (EPOS4, co.DEVICE_TYPE, 401, "profile 401, vendor"),
        (EPOS4, co.VELOCITY_UNIT, 0xFDB44700, r"velocity_unit 0.001 rpm .*, the rig file says rpm"),
        (EPOS4, co.ACCELERATION_UNIT, 0xFEC00300, "acceleration_unit 0.01 rpm/s"),
        (EPOS4, Place(0x3000, 5), 4096, r"counts_per_turn 4096 \(0x3000:05\), the rig file says 2000"),
        (None, od.ENCODER_PULSES, 512, r"per_turn 2048 \(0x2210:01\), the rig file says 2000"),
        (None, co.REVISION, 0x20330000, "revision number 0x20330000"),
        (None, co.REVISION, 0x22000000, "revision number 0x22000000"),
    ],
)
def test_another_drive_is_refused(
    section: AxisDescription | None, place: Place, value: int, words: str
) -> None:
    """The error has value, expected value and remedy; nothing is written. An EPOS2 may be neither older nor newer."""
    with one_drive(section, fixed={place: value}) as one:
        with pytest.raises(DriveError, match=words) as refusal:
            one.driver.identify()
        assert refusal.value.hint
        frames = one.link.network.take_frames()
        assert {data[0] for _, can_id, data, way in frames if way == "T" and can_id > 0x600} == {0x40}


def test_a_moving_axis_is_stopped_before_it_is_configured(ready: OneDrive) -> None:
    """A crashed program has left it moving; its target becomes its position, and Halt is set, before it has power."""
    ready.driver.start_move(25.0, 1.0)
    ready.clock.sleep(2.0)
    ready.driver.configure(HEARTBEAT, None)
    stopped_at = ready.drive.shaft_counts
    ready.clock.sleep(1.0)
    assert ready.drive.shaft_counts == stopped_at < 20_000
    ready.driver.stop()  # Halt has the enable bits set, so it is sent only to an enabled drive
    assert _state(ready) is DriveState.SWITCH_ON_DISABLED
    ready.driver.enable()
    assert ready.values(co.TARGET_POSITION) == (round(stopped_at),)
    assert ready.driver.upload(co.CONTROLWORD) & HALT


def test_the_fingerprint_is_as_before_whatever_labrig_writes(epos2: OneDrive) -> None:
    """It is the drive's record of its configuration; another one than in the rig file is refused."""
    epos2.drive.objects.values |= dict(zip(od.CONFIGURATION, (1, 2), strict=True))
    driver = epos2.reopen(configuration_fingerprint=(1, 2))
    driver.identify()
    driver.configure(HEARTBEAT, 500)
    driver.enable()
    driver.start_move(0.0025, 77 / 120)
    driver.close()
    assert epos2.values(*od.CONFIGURATION) == (1, 2)
    with pytest.raises(DriveError, match="parameters have been changed"):
        epos2.reopen(configuration_fingerprint=(1, 3)).identify()


def test_a_drive_with_only_the_required_objects_moves(tmp_path: Path) -> None:
    """Without any optional object it homes, moves and stops; what it would need an object for is refused."""
    with one_drive(section_of(tmp_path, eds_text(without=(*GUARDS, *OPTIONAL)), objects={})) as one:
        one.get_ready()
        for homing in (Homing(position=1.0), Homing(method=17, offset=1.0)):
            with pytest.raises(InputError, match="no object of the drive is known"):
                one.home(homing)
        one.home(HERE)
        one.driver.set_limits((-1.0, 1.0))
        one.driver.start_move(2.0, 5.0)
        one.clock.sleep(2.0)
        assert one.driver.read().target_reached
        assert one.drive.shaft_counts == 4000
        assert (one.driver.reports.current_ma(), one.driver.reports.current_limit_ma()) == (None, None)
        with pytest.raises(DriveError, match="no current limit that labrig can set") as refusal:
            one.driver.configure(HEARTBEAT, 500)
        assert "--current-ma 0" in refusal.value.hint
        one.drive.fail(0x2310)
        assert _fault(one).code == 0


def test_widths_are_those_of_the_eds_file(tmp_path: Path) -> None:
    """A 16-bit deceleration is written in two bytes; a larger value is refused before it is sent."""
    section = section_of(tmp_path, eds_text(entry("6085", "H", default=100, low=1, name="quick_stop")))
    with one_drive(section) as one:
        one.get_ready()
        assert one.values(co.QUICK_STOP_DECELERATION) == (12_000,)
        one.link.network.take_frames()
        with pytest.raises(DriveError, match=r"does not take quick_stop \(0x6085:00\) = 70000, only 1"):
            one.driver.download(co.QUICK_STOP_DECELERATION, 70_000)
        assert one.link.network.take_frames() == []


def test_a_stale_acknowledge_is_no_success(ready: OneDrive) -> None:
    """A set-point bit left high by another program would hide the next move; the driver notices."""
    ready.driver.download(co.CONTROLWORD, ENABLE | NEW_SETPOINT)
    with pytest.raises(DriveError, match="get ready for a set-point"):
        ready.driver.start_move(0.25, 1.0)


@pytest.mark.parametrize("rpm", [1, -1])
def test_a_creep_is_no_standstill_which_is_noticed_in_time(rpm: int, ready: OneDrive) -> None:
    """500 pulses a turn: 1 rpm, the slowest speed, is 1.7 counts in 50 ms; within 0.2 s standstill is certain."""
    before_s = ready.clock.now_s()
    ready.settle(0.5)
    assert 0.15 <= ready.clock.now_s() - before_s <= 0.2
    ready.driver.start_move(1.0 * rpm, 1 / 120)
    ready.clock.sleep(1.0)
    with pytest.raises(DriveError, match="still moves"):
        ready.settle(2.0)


@given(pulses=st.integers(188, 65_535), phase=st.floats(0, 1))
def test_a_creep_moves_farther_than_a_servo_at_rest(pulses: int, phase: float) -> None:
    """In the waiting time, 1 rpm turns any encoder by more than the dither, at any start."""
    turned = 4 * pulses / 60 * still_time_s(4 * pulses / 60)
    assert math.floor(phase + turned) - math.floor(phase) > STILL_COUNTS
    assert still_time_s(4 * pulses / 60) <= still_time_s(None)


@pytest.mark.parametrize("answers", [[0x0140], [0x0140, 0x0121]], ids=["stuck", "to and fro"])
def test_a_drive_that_obeys_no_command_is_told(epos2: OneDrive, answers: list[int]) -> None:
    """It stays where it is, or comes back there again and again: a second, and no longer, is waited for it."""
    words = cycle(answers)
    epos2.drive.objects._live = {**epos2.drive.objects._live, co.STATUSWORD: lambda: next(words)}
    with pytest.raises(DriveError, match=r"stayed in .* for 1 s on the way to ENABLED"):
        epos2.driver.enable()
    assert epos2.clock.now_s() == pytest.approx(1.0, abs=0.05)


def test_a_drive_without_its_eds_file_can_be_stopped(tmp_path: Path) -> None:
    """`labrig devices stop` needs no file; moving the axis names the missing one."""
    with one_drive(EPOS4, EPOS4.model_copy(update={"eds": "none.eds"}).placed_in(tmp_path)) as one:
        other = type(one.driver)(one.link, EPOS4, "rotation", one.clock)
        other.configure(HEARTBEAT, None)
        other.enable()
        other.start_move(50.0, 5.0)
        one.driver.stop(quick=True)
        one.settle(2.0)
        assert not one.drive.is_moving
        with pytest.raises(InputError, match=r"cannot read .*none\.eds"):
            one.driver.identify()


@pytest.mark.parametrize(
    ("velocity", "acceleration"),
    [("0.001 rpm", "0.1 rpm/s"), ("0.0001 turns/s", "0.01 turns/s^2"), ("counts/s", "10 counts/s^2")],
)
def test_stated_units_make_the_same_motion(velocity: str, acceleration: str, tmp_path: Path) -> None:
    """2 mm at 0.5 mm/s take the same time in any units of the drive."""
    text = eds_text(without=[0x60A9, 0x60AA])
    units = {"velocity_unit": velocity, "acceleration_unit": acceleration}
    with one_drive(section_of(tmp_path, text, acceleration=0.5, **units)) as one:
        one.get_ready()
        began_s = one.clock.now_s()
        rounded = one.driver.round_move(2.0, 0.5)
        assert (rounded.position, rounded.speed) == (2.0, pytest.approx(0.5, rel=1e-3))
        one.driver.start_move(2.0, 0.5)
        while one.driver.read().position < 1.0:
            one.clock.sleep(0.005)
        # Half of the way and half of the time that speeding up takes.
        assert one.clock.now_s() - began_s == pytest.approx(1.0 / 0.5 + 0.5 * 0.5 / 0.5, abs=0.02)


@pytest.mark.parametrize(("bit", "name"), [(0, "negative-limit"), (8, "general-H"), (15, "general-A")])
def test_an_input_has_the_name_of_its_function(epos2: OneDrive, bit: int, name: str) -> None:
    """The general inputs count backwards: maxon's EposCmd gives A the number 15 and H the number 8."""
    channels = {"wired": InputChannel(source=name), "other": InputChannel(source="general-B")}
    epos2.drive.set_input(name, 1.0)
    assert epos2.values(od.INPUT_STATE) == (1 << bit,)
    assert epos2.reopen(inputs=channels).reports.read_inputs() == {"wired": True, "other": False}


def test_a_drive_of_another_make_has_currents_and_no_reported_reference(tmp_path: Path) -> None:
    """0x6078 and 0x6073 are thousandths of 0x6075; a reference that it does not report ends when it restarts."""
    with one_drive(other_make(tmp_path)) as one:
        one.get_ready()
        assert not one.driver.is_referenced()
        one.home(HERE)
        assert one.driver.is_referenced()
        one.driver.start_move(-2.0, 1.0)
        one.clock.sleep(0.5)
        assert (one.driver.reports.current_ma(), one.driver.reports.current_limit_ma()) == (-60.0, 10_000)
        one.clock.sleep(3.0)
        one.driver.configure(HEARTBEAT, 1234)
        assert one.driver.reports.current_limit_ma() == 1230
        one.driver.close()
        assert one.driver.reports.current_limit_ma() == 10_000
        one.drive.restart()
        assert not one.driver.is_referenced()


def test_a_home_position_of_the_other_sign_is_noticed(ready4: OneDrive) -> None:
    """A drive that sets its counter to the negated value is refused."""
    homing = ready4.driver.home(Homing(method=17, position=-3.0, speed=5.0, timeout_s=20.0))
    next(homing)
    ready4.drive.objects.values[Place(0x30B0)] *= -1
    ready4.clock.sleep(10.0)
    with pytest.raises(DriveError, match="opposite sign for the home position"):
        deque(homing)
    assert _state(ready4) is DriveState.OPERATION_ENABLED


def test_a_homing_that_takes_too_long_is_given_up(ready: OneDrive) -> None:
    """The attained bit of an earlier homing does not count."""
    ready.home(HERE)
    with pytest.raises(DriveError, match="did not find home in time"):
        ready.home(Homing(method=-3, timeout_s=0.05))


def _hear_and_lose(one: OneDrive) -> None:
    """Let the drive hear one beat of the computer, and then none."""
    one.link.send(0x700 + HEARTBEAT.computer_node_id, b"\x05")
    one.clock.sleep(1.0)


def test_a_reset_of_the_communication_restores_heartbeats(ready4: OneDrive) -> None:
    """An EPOS4 needs a communication reset first, which clears both heartbeats."""
    _hear_and_lose(ready4)
    assert _fault(ready4).code == 0x8130
    ready4.driver.reset_fault()
    assert ready4.driver.fault() is None
    assert ready4.values(co.CONSUMER_HEARTBEAT, co.PRODUCER_HEARTBEAT) == (127 << 16 | 500, 100)
    ready4.driver.enable()
    _hear_and_lose(ready4)
    assert ready4.driver.fault()


@pytest.mark.parametrize(
    ("code", "words"),
    [(0x8611, "following error"), (0x5441, r"unknown to labrig \(hardware"), (0xFF01, "unknown to labrig")],
)
def test_an_error_is_described_by_its_code_or_class(ready4: OneDrive, code: int, words: str) -> None:
    """The code comes from 0x603F; each has a remedy."""
    ready4.drive.fail(code)
    ready4.clock.sleep(0.5)
    fault = _fault(ready4)
    assert fault.code == code
    assert fault.hint
    with pytest.raises(DriveFaultError, match=words):
        ready4.driver.configure(HEARTBEAT, None)


def test_a_fault_whose_cause_persists_is_not_reset(ready4: OneDrive) -> None:
    """The supply of the power stage must be back first."""
    ready4.drive.cut_power_stage()
    with pytest.raises(DriveFaultError, match="its cause is still there"):
        ready4.driver.reset_fault()
    ready4.drive.restore_power_stage()
    ready4.driver.reset_fault()
    ready4.driver.enable()
