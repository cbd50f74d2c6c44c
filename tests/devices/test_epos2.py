"""The EPOS2 driver against the simulated drive, over the bus."""

import math
from collections.abc import Iterator
from itertools import cycle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.drives import epos2 as od
from labrig.devices.drives import objects as co
from labrig.devices.drives.cia402 import still_time_s
from labrig.devices.drives.drive import STILL_COUNTS, Homing
from labrig.devices.drives.states import (
    ENABLE,
    FAULT_RESET,
    HALT,
    NEW_SETPOINT,
    SETPOINT_ACKNOWLEDGED,
    DriveState,
    TargetState,
    decode_state,
)
from labrig.devices.homing import HOMING_HERE
from labrig.devices.input_channel import InputChannel
from labrig.errors import DriveError, DriveRefusedError
from tests.devices.rigs import OneDrive, one_drive


def _configure(bench: OneDrive) -> None:
    bench.driver.configure(HeartbeatDescription(), None)


@pytest.fixture(name="bench")
def _bench() -> Iterator[OneDrive]:
    with one_drive() as bench:
        yield bench


@pytest.fixture(name="ready")
def _ready(bench: OneDrive) -> OneDrive:
    _configure(bench)
    bench.driver.enable()
    return bench


def _home_here(bench: OneDrive) -> None:
    bench.home(Homing(HOMING_HERE))


# Connecting


def test_identity_is_read(bench: OneDrive) -> None:
    """Model, versions and serial number are those that the drive reports."""
    identity = bench.driver.read_identity()
    assert identity.document() == {
        "model": "EPOS2 24/5",
        "hardware_version": 0x6220,
        "software_version": 0x2122,
        "serial_number": 1001,
    }


@pytest.mark.parametrize(
    ("hardware", "software", "model"),
    [
        (0x6120, 0x2101, "EPOS2 Module 36/2"),
        (0x6221, 0x2110, "EPOS2 24/5"),
        (0x6320, 0x2122, "EPOS2 50/5"),
        (0x6420, 0x2126, "EPOS2 70/10"),
    ],
)
def test_every_known_type_is_accepted(hardware: int, software: int, model: str) -> None:
    """The last digit of the hardware version, its revision, does not matter."""
    with one_drive(hardware=hardware, software=software) as bench:
        identity = bench.driver.identify()
        assert (identity.model, identity.versions["software_version"]) == (model, software)


def test_an_unknown_type_is_accepted_by_the_version_in_the_rig_file() -> None:
    """Refused at first, with the line that accepts it; with that line it is driven, and no other drive is."""
    words = "hardware version 0x6552, unknown to labrig"
    with one_drive(hardware=0x6552) as bench:
        with pytest.raises(DriveError, match=words) as refusal:
            bench.driver.read_identity()
        assert "EPOS2 70/10 (0x6420)" in str(refusal.value.hint)
        assert "hardware_version: 0x6552" in str(refusal.value.hint)
        model = bench.reopen(hardware_version=0x6552).identify().model
        assert model == "EPOS2 of a type unknown to labrig"
        with pytest.raises(DriveError, match="hardware version 0x6552, the rig file says 0x6553"):
            bench.reopen(hardware_version=0x6553).read_identity()


@pytest.mark.parametrize("version", [0x2033, 0x2200])
def test_software_of_another_generation_is_refused(version: int) -> None:
    """Its objects may have other meanings."""
    with (
        one_drive(software=version) as bench,
        pytest.raises(DriveError, match=rf"software version 0x{version:04X}, an EPOS2 has 0x2100 to 0x21FF"),
    ):
        bench.driver.identify()


def test_a_wrong_encoder_is_refused_and_never_written(bench: OneDrive) -> None:
    """The encoder resolution of the drive is compared with the rig file and not changed."""
    with pytest.raises(DriveError, match=r"encoder_pulses_per_turn 500 \(0x2210:01\), the rig file says 512"):
        bench.reopen(encoder_pulses_per_turn=512).identify()
    assert bench.driver.upload(od.ENCODER_PULSES) == 500


def test_enabling_moves_nothing(bench: OneDrive) -> None:
    """The actual position replaces the target of another program, and Halt is set."""
    _configure(bench)
    bench.driver.download(co.TARGET_POSITION, 1_000_000)
    bench.driver.enable()
    assert bench.driver.upload(co.TARGET_POSITION) == 0
    assert bench.driver.upload(co.CONTROLWORD) & HALT
    bench.clock.sleep(1.0)
    assert bench.drive.shaft_counts == 0


def test_connecting_stops_a_moving_axis(ready: OneDrive) -> None:
    """A drive that a crashed program left moving stands still before it is configured."""
    ready.driver.start_profile(100_000, 120)
    ready.clock.sleep(2.0)
    _configure(ready)
    stopped_at = ready.drive.shaft_counts
    ready.clock.sleep(1.0)
    assert ready.drive.shaft_counts == stopped_at < 20_000
    assert decode_state(ready.driver.statusword()) is DriveState.SWITCH_ON_DISABLED


# Moving


def test_both_edges_of_the_handshake_are_checked(ready: OneDrive) -> None:
    """After a move has started, the acknowledge is cleared for the next set-point."""
    ready.driver.start_profile(40_000, 120)
    assert not ready.driver.statusword() & SETPOINT_ACKNOWLEDGED


def test_a_stale_acknowledge_is_no_success(ready: OneDrive) -> None:
    """A set-point bit left high by another program would hide the next move; the driver notices."""
    ready.driver.download(co.CONTROLWORD, ENABLE | NEW_SETPOINT)
    with pytest.raises(DriveError, match="get ready for a set-point"):
        ready.driver.start_profile(1000, 120)


def test_halting_a_drive_without_power_does_not_switch_it_on(bench: OneDrive) -> None:
    """Halt has the enable bits set, so it is sent only to an enabled drive."""
    _configure(bench)
    bench.driver.go_to(TargetState.POWER_OFF)
    bench.driver.stop()
    assert decode_state(bench.driver.statusword()) is DriveState.SWITCH_ON_DISABLED


@pytest.mark.parametrize("rpm", [1, -1, 2])
def test_a_creep_does_not_count_as_standstill(rpm: int, ready: OneDrive) -> None:
    """1 rpm, the slowest speed of the drive, is 1.7 quadcounts in 50 ms, and is noticed."""
    ready.driver.start_profile(int(math.copysign(4000, rpm)), abs(rpm))
    ready.clock.sleep(1.0)
    with pytest.raises(DriveError, match="still moves"):
        ready.driver.settle(2.0)


def test_standstill_is_noticed_in_time(ready: OneDrive) -> None:
    """With 500 pulses per turn standstill is certain within 0.2 s, so a stop meets its deadline."""
    before_s = ready.clock.now_s()
    ready.driver.settle(0.5)
    assert 0.15 <= ready.clock.now_s() - before_s <= 0.2


@given(pulses=st.integers(188, 65_535), phase=st.floats(0, 1))
def test_a_creep_moves_farther_than_a_servo_at_rest(pulses: int, phase: float) -> None:
    """In the waiting time, 1 rpm turns any encoder by more than the dither, at any start."""
    turned = 4 * pulses / 60 * still_time_s(4 * pulses / 60)
    assert math.floor(phase + turned) - math.floor(phase) > STILL_COUNTS
    assert still_time_s(4 * pulses / 60) <= still_time_s(None)


# Faults


def test_a_refusal_names_object_value_and_reason(bench: OneDrive) -> None:
    """What is out of range is not sent; what the drive refuses has the meaning of its SDO abort code."""
    with pytest.raises(
        DriveError, match=r"does not take profile velocity \(0x6081:00\) = 0, only 1 to 25000"
    ):
        bench.driver.download(co.PROFILE_VELOCITY, 0)
    bench.drive.abort_next(0x08000022)
    with pytest.raises(
        DriveRefusedError,
        match=r"profile velocity \(0x6081:00\) = 1: .*the present device state .*0x08000022",
    ):
        bench.driver.download(co.PROFILE_VELOCITY, 1)


def test_a_silent_drive_is_named(bench: OneDrive) -> None:
    """An absent node does not answer; on this bus that is certain at once."""
    bench.drive.unplug()
    with pytest.raises(DriveError, match=r"drive of axis insertion \(node 1\) did not answer") as silence:
        bench.driver.statusword()
    assert "node id" in silence.value.hint


def test_nothing_enables_a_faulted_drive(ready: OneDrive) -> None:
    """Enabling, moving and configuring are all refused; the fault stays until a person resets it."""
    ready.drive.fail(0x2310)
    ready.clock.sleep(1.0)
    for action in (
        ready.driver.enable,
        lambda: ready.driver.start_profile(10, 120),
        ready.driver.raise_if_faulted,
    ):
        with pytest.raises(DriveError, match="0x2310"):
            action()
    assert decode_state(ready.driver.statusword()) is DriveState.FAULT
    ready.driver.go_to(TargetState.POWER_OFF)
    ready.driver.download(co.CONTROLWORD, 0)
    ready.driver.download(co.CONTROLWORD, FAULT_RESET)
    assert decode_state(ready.driver.statusword()) is DriveState.SWITCH_ON_DISABLED


@pytest.mark.parametrize("answers", [[0x0140], [0x0140, 0x0121]], ids=["stuck", "to and fro"])
def test_a_drive_that_obeys_no_command_is_told(bench: OneDrive, answers: list[int]) -> None:
    """It stays where it is, or comes back there again and again: a second, and no longer, is waited for it."""
    words = cycle(answers)
    bench.drive.objects._live = {**bench.drive.objects._live, co.STATUSWORD: lambda: next(words)}
    with pytest.raises(DriveError, match=r"stayed in .* for 1 s on the way to ENABLED"):
        bench.driver.go_to(TargetState.ENABLED)
    assert bench.clock.now_s() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("bit", "name"),
    [(0, "negative-limit"), (2, "home"), (8, "general-H"), (13, "general-C"), (15, "general-A")],
)
def test_an_input_has_the_name_of_its_function(bench: OneDrive, bit: int, name: str) -> None:
    """The general inputs count backwards: maxon's EposCmd gives A the number 15 and H the number 8."""
    driver = bench.reopen(
        inputs={"wired": InputChannel(source=name), "other": InputChannel(source="general-B")}
    )
    bench.drive.press(1 << bit)
    assert driver.read_inputs() == {"wired": True, "other": False}


def test_a_homing_that_takes_too_long_is_given_up(ready: OneDrive) -> None:
    """The attained bit of an earlier homing does not count."""
    _home_here(ready)
    with pytest.raises(DriveError, match="did not find home in time"):
        ready.home(Homing(-3, timeout_s=0.05))


def test_the_fingerprint_is_as_before_whatever_labrig_writes(bench: OneDrive) -> None:
    """It is the drive's record of its configuration; another one than in the rig file is refused."""
    values = bench.drive.objects.values
    values |= dict(zip(od.CONFIGURATION, (1, 2), strict=True))
    driver = bench.reopen(configuration_fingerprint=(1, 2))
    driver.identify()
    driver.configure(HeartbeatDescription(), 500)
    driver.enable()
    driver.start_profile(10, 77)
    driver.close()
    assert (values[od.CONFIGURATION[0]], values[od.CONFIGURATION[1]]) == (1, 2)
    with pytest.raises(DriveError, match="parameters have been changed"):
        bench.reopen(configuration_fingerprint=(1, 3)).identify()


def test_states_that_an_epos2_passes_are_waited_through(bench: OneDrive) -> None:
    """Measure init and refresh look like switched on to the standard: no command is repeated in them."""
    assert bench.driver.decode(0x4323) is bench.driver.decode(0x0333) is DriveState.PASSING
    assert bench.driver.decode(0x0323) is DriveState.SWITCHED_ON
