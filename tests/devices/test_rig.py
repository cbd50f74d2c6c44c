"""The open rig: what connecting verifies and writes, moves and stops, states by SYNC and report."""

import math
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from labrig.devices.drives import objects as co
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import Homing, wait_for_all
from labrig.devices.drives.epos2 import Epos2Axis
from labrig.devices.drives.objects import Place
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.rig import Rig, open_rig
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.devices.simulated.shaft import Mechanics
from labrig.errors import DriveError, LimitError, SafetyStopError
from tests.devices import epos2_places as od
from tests.devices.rigs import (
    HEARTBEAT,
    OneDrive,
    OpenedRig,
    Person,
    Signal,
    epos2_axis,
    instants,
    one_drive,
    opened_rig,
    ready_rig,
    simulated_rig,
)
from tests.devices.wire_faults import catch_next, delay_next

QUADCOUNTS_PER_MM = 4000


def _go(opened: OpenedRig, axis: str, position: float, speed: float) -> list[float]:
    """Move an axis to the end, and return the positions on its way."""
    opened.rig.axis(axis).start_move(position, speed)
    states = [opened.rig.read_states()[axis]]
    while not states[-1].target_reached:
        opened.rig.wait(0.05)
        states.append(opened.rig.read_states()[axis])
    return [state.position for state in states]


def _still(hardware: SimulatedHardware) -> bool:
    before = [drive.shaft_counts for drive in hardware.drives.values()]
    hardware.clock.sleep(1.0)
    return before == [drive.shaft_counts for drive in hardware.drives.values()]


# Connecting


READ_BACK = {
    co.LOWER_LIMIT: -2 * QUADCOUNTS_PER_MM - 20, co.UPPER_LIMIT: 120 * QUADCOUNTS_PER_MM + 20,
    co.MAX_FOLLOWING_ERROR: round(0.4 * QUADCOUNTS_PER_MM), co.POSITION_WINDOW: 20,
    co.POSITION_WINDOW_TIME: 20, co.QUICK_STOP_DECELERATION: 200 * 120, od.LIMIT_EXECUTION_MASK: 0x0008 | 3,
}  # fmt: skip
DEAD_MAN = (co.CONSUMER_HEARTBEAT, co.ABORT_CONNECTION, co.FAULT_REACTION)
SWITCHES = ("axes.insertion.limit_switches=[negative, positive]", "axes.insertion.max_following_error=0.4")


def test_the_drive_has_the_settings_of_the_rig_file() -> None:
    """Windows, decelerations, heartbeat, switches; limits once the axis is referenced; later only what differs."""
    with opened_rig(simulated_rig(*SWITCHES)) as opened:
        opened.rig.connect()
        objects = opened.drives["insertion"].objects
        assert [objects.value(place) for place in (co.LOWER_LIMIT, co.UPPER_LIMIT)] == [-(2**31), 2**31 - 1]
        opened.rig.reference_axes()
        assert {place: objects.value(place) for place in READ_BACK} == READ_BACK
        objects.put(co.UPPER_LIMIT, 10 * QUADCOUNTS_PER_MM)
        opened.rig.take_can_frames()
        opened.rig.connect()
        assert opened.rig.axis("insertion").referenced
        assert {place: objects.value(place) for place in READ_BACK} == READ_BACK
        sent = [
            data for _, can_id, data, way in opened.rig.take_can_frames() if (can_id, way) == (0x601, "T")
        ]
        written = {int.from_bytes(data[1:3], "little") for data in sent if data[0] & 0xE0 == 0x20}
        assert written - {0x6040, 0x607A, 0x6060} == {0x607D}


def _configure(one: OneDrive, section: Epos2Axis) -> None:
    one.driver.configure(HEARTBEAT, None)
    one.driver.set_limits(section.limits)


@pytest.mark.parametrize("place", [*READ_BACK, *DEAD_MAN], ids=str)
def test_a_setting_that_the_drive_does_not_keep_is_refused(place: Place) -> None:
    """Each setting is read back after it has been written; the error names the object, and what it is needed for."""
    section = epos2_axis(limit_switches=("negative", "positive"), max_following_error=0.4)
    with one_drive(told=section) as one:
        objects = one.drive.objects
        name = objects._objects[place].name
        objects._live = {**objects._live, place: lambda: 0}
        with pytest.raises(DriveError, match=f"kept {name} .{place}. at 0 when") as refusal:
            _configure(one, section)
        assert ("cannot be relied upon to stop when" in refusal.value.message) is (place in DEAD_MAN)


def test_all_failures_of_all_drives_are_reported_together() -> None:
    """A silent drive, and a wrong encoder and fingerprint of another, are in one error."""
    wrong = ("axes.rotation.configuration_fingerprint=[1, 2]", "axes.rotation.counts_per_turn=2048")
    with opened_rig(simulated_rig(*wrong)) as opened:
        opened.drives["insertion"].unplug()
        opened.drives["rotation"].objects.set_fixed(od.ENCODER_PULSES, 500)
        with pytest.raises(DriveError) as refusal:
            opened.rig.connect()
        for words in (
            "(node 1) did not answer",
            "(node 2) has counts_per_turn 2000 (0x2210:01), the rig file says 2048",
            "(node 2) has the configuration fingerprint [0, 0]",
        ):
            assert words in refusal.value.message


HOMES = {-1: 10_000, -2: -10_000, -3: 10_300, -4: -10_300, 1: -8_000, 2: 8_000, 17: -9_100, 18: 9_100}
"""Method -> where the shaft stands then [counts]: at a stop, at a switch, or at the next index behind it."""


@pytest.mark.parametrize(("method", "home"), HOMES.items())
def test_each_homing_method_has_its_direction(method: int, home: float) -> None:
    """Signs are maxon's: -1 and -3 go positive, -2 and -4 negative, switches to their side; then off by the offset."""
    with one_drive(mechanics=Mechanics(-10_300.0, 10_300.0, -9_100.0, 9_100.0)) as one:
        one.get_ready()
        one.home(Homing(method=method, position=2.0, offset=0.25, speed=16.0, timeout_s=60.0))
        assert home * Epos2Axis.homing_directions[method] > 0
        assert one.drive.shaft_counts == pytest.approx(home - math.copysign(1000, home), abs=1e-6)
        assert one.driver.is_referenced()
        assert one.driver.position() == pytest.approx(2.0, abs=1e-3)


def test_nothing_moves_and_nothing_is_referenced_while_a_needle_may_be_in_tissue(tmp_path: Path) -> None:
    """Zero needs a confirmation that the needle is out, without a state file and after a run that left it there.

    Before zero is set, a position means nothing. A reference that the state file has and new drives have not is none.
    """
    description = simulated_rig("state_file=state.json").placed_in(tmp_path)
    with opened_rig(description) as opened:
        opened.rig.connect()
        with pytest.raises(SafetyStopError, match="not referenced"):
            opened.rig.axis("insertion").start_move(1.0, 1.0)
        with pytest.raises(SafetyStopError, match="no state file yet"):
            opened.rig.reference_axes()
        opened.rig.needle.mark_out()
        opened.rig.reference_axes()
        assert opened.rig.state.referenced == ("insertion", "rotation", "linear")
        opened.rig.needle.mark_in_tissue("run-7")
    with opened_rig(description) as opened:
        opened.rig.connect()
        assert opened.rig.state.referenced == ()
        assert not opened.rig.axis("insertion").referenced
        with pytest.raises(SafetyStopError, match="run run-7 ended with the needle in tissue"):
            opened.rig.reference_axes()


# Moving


def test_moves_arrive_in_millimetres_and_radians() -> None:
    """Each axis reads its target; a reversed one turns its motor the other way, and keeps the direction of its limits.

    The limits are inside the range: rounding does not trip those of the drive.
    """
    with ready_rig("axes.insertion.reversed=true") as opened:
        _go(opened, "linear", 15.0, 5.0)
        _go(opened, "rotation", math.pi, 1.0)
        for position in (120.0, -2.0, 10.0):
            assert _go(opened, "insertion", position, 20.0)[-1] == position
        assert opened.drives["insertion"].shaft_counts == -40_000
        states = opened.rig.read_states()
        assert states["linear"].position == 15.0
        assert states["rotation"].position == pytest.approx(math.pi, abs=1e-4)
        enabled = {decode_state(state.statusword) for state in states.values()}
        assert enabled == {DriveState.OPERATION_ENABLED}


def test_a_move_beyond_a_limit_sends_nothing() -> None:
    """Position, speed and rounding are checked first; the error names axis, value and limit.

    What is rounded within the tolerance is sent, and both are reported.
    """
    with ready_rig("axes.rotation.speed_tolerance_fraction=0.05") as opened:
        for position, speed, words in (
            (120.001, 1.0, r"axis insertion: 120.001 mm is beyond its limits \[-2, 120\] mm"),
            (-2.001, 1.0, "beyond its limits"),
            (math.nan, 1.0, "beyond its limits"),
            (10.0, 20.001, "speed 20.001 mm/s is not within 0 to 20 mm/s"),
            (10.0, 0.0, "not within"),
            (10.0, 0.011, "is off by 24.2 % in whole units of the drive"),
        ):
            with pytest.raises(LimitError, match=words):
                opened.rig.axis("insertion").start_move(position, speed)
        assert not any(instants(drive, "set-point") for drive in opened.drives.values())
        setpoint = opened.rig.axis("rotation").start_move(1.0, 1.0)
        assert (setpoint.asked_position, setpoint.sent_counts, setpoint.sent_speed_units) == (1.0, 5093, 153)
        assert setpoint.position == pytest.approx(1.0, abs=1e-4)
        assert setpoint.speed == pytest.approx(153 * 2 * math.pi / 960)


def test_backlash_is_taken_up_from_below_or_the_move_is_refused() -> None:
    """A downward move passes its target by the backlash and comes back; nothing is clipped at the lower limit."""
    with ready_rig("axes.insertion.backlash=0.5") as opened:
        ways = {target: _go(opened, "insertion", target, 5.0) for target in (10.0, 5.0, -1.5)}
        assert [way[-1] for way in ways.values()] == list(ways)
        assert (min(ways[5.0]), min(ways[-1.5])) == pytest.approx((4.5, -2.0), abs=0.05)
        _go(opened, "insertion", 0.0, 5.0)
        with pytest.raises(LimitError, match="passes its target by the backlash"):
            opened.rig.start_move("insertion", -1.6, 5.0)
        assert not opened.drives["insertion"].is_moving


def test_a_move_that_takes_far_too_long_is_an_error() -> None:
    """The rig does not wait forever for target reached."""
    with ready_rig() as opened:
        opened.drives["insertion"].objects.put(co.POSITION_WINDOW_TIME, 60_000)
        opened.rig.axis("insertion").start_move(1.0, 1.0)
        opened.rig.wait(2.0)
        assert not opened.rig.read_states()["insertion"].target_reached
        opened.rig.wait(3.0)
        with pytest.raises(DriveError, match="has not arrived in good time"):
            opened.rig.read_states()


RIG = simulated_rig("axes.insertion.backlash=0.3", "axes.linear.reversed=true")
EDGES = [-2.0, 120.0, -13.0, 13.0, -5.0, 150.0, 120.001, -2.0001]
MOVE = st.tuples(
    st.sampled_from(("insertion", "rotation", "linear")),
    st.one_of(st.floats(), st.floats(-200, 200), st.sampled_from(EDGES)),
    st.one_of(st.floats(), st.floats(0.5, 20), st.just(20.0)),
    st.floats(0, 10),
)


def _beyond(opened: OpenedRig) -> list[str]:
    """Return every axis whose shaft stands beyond its limits, by more than a quadcount."""
    places = []
    for name, axis in RIG.axes.items():
        position = axis.scale().to_position(opened.drives[name].shaft_counts)
        low, high = axis.limits
        slack = 1 / axis.scale().counts_per_unit
        if not low - slack <= position <= high + slack:
            places.append(f"{name} at {position}")
    return places


@settings(max_examples=25)
@given(st.lists(MOVE, max_size=8))
@example([("insertion", 120.0, 20.0, 7.0), ("insertion", -2.0, 20.0, 30.0), ("linear", 150.0, 20.0, 30.0)])
def test_no_moves_at_all_take_an_axis_beyond_its_limits(moves: list[tuple[str, float, float, float]]) -> None:
    """Refused, made or replaced, with backlash and reversed axes: no move ends in a fault, none raises an alarm."""
    with opened_rig(RIG) as opened:
        opened.rig.connect()
        opened.rig.reference_axes()
        beyond: list[str] = []
        opened.hardware.clock.on_advance(lambda: beyond.extend(_beyond(opened)))
        for name, position, speed, wait_s in moves:
            try:
                opened.rig.axis(name).start_move(position, speed)
            except LimitError:
                continue
            opened.rig.wait(wait_s)
        opened.rig.stop()
        assert beyond == []
        for drive in opened.drives.values():
            assert not instants(drive, "emergency")
            assert drive.objects.value(co.ERROR_COUNT) == 0


# Stopping


def test_stop_quick_stops_an_axis_that_goes_on() -> None:
    """An axis that starts again after the halt is quick-stopped."""
    with ready_rig(moves=("insertion", 100.0, 1.0)) as opened:
        axis = opened.rig.axis("insertion")
        assert wait_for_all({"one": axis.wait_until_still()}, opened.rig._heartbeat) == {}
        assert isinstance(axis.drive, Cia402Drive)
        statusword = axis.drive.upload(co.STATUSWORD)
        assert _still(opened.hardware)
        assert decode_state(statusword) is DriveState.QUICK_STOP_ACTIVE


def test_three_axes_are_stopped_in_parallel() -> None:
    """It takes the deceleration and the standstill time once, not once per axis."""
    with ready_rig(moves=("insertion", 100.0, 1.0)) as opened:
        before_s = opened.rig.clock.now_s()
        opened.rig.stop()
        assert opened.rig.clock.now_s() - before_s <= 0.2 + 0.05


def _break_off(rig: Rig) -> None:
    rig.reference_axes()
    rig.axis("insertion").start_move(40.0, 1.0)
    rig.wait(1.0)
    raise ZeroDivisionError


def test_an_error_in_the_block_stops_and_releases_the_rig() -> None:
    """The axes stand still, power is off, and the error is the one raised."""
    opening = open_rig(simulated_rig(), seed=1, person=Person(), interrupted=Signal())
    with pytest.raises(ZeroDivisionError), opening as rig:
        _break_off(rig)
    hardware = rig._hardware
    assert isinstance(hardware, SimulatedHardware)
    assert _still(hardware)
    assert hardware.drives["insertion"].shaft_counts < 10_000
    assert {drive._state for drive in hardware.drives.values()} == {DriveState.SWITCH_ON_DISABLED}


# Reading


SYNC, REPORTS = 0x080, {0x381, 0x382, 0x383}


def _frames(opened: OpenedRig) -> list[int]:
    """Return the COB-IDs of what has passed, beats left out."""
    return [can_id for _, can_id, _, _ in opened.rig.take_can_frames() if can_id < 0x700]


def test_the_states_of_three_axes_take_four_frames() -> None:
    """A SYNC and a report per drive; position, state and motor current are those of the drive.

    The current is 60 mA for friction of 1.5 mNm, by the motor's 25 mNm/A. Whatever another program has mapped there.
    Inputs are asked for, of the drive to which something is wired; analog values are in the sensor's unit.
    """
    force = "needle_force: {source: analog-1, unit: N, units_per_volt: 4, zero_v: 0.5}"
    wired = f"axes.linear.inputs={{{force}, door: {{source: general-A}}}}"
    for overrides, asked in (((), set[int]()), ((wired,), {0x603, 0x583})):
        with opened_rig(simulated_rig(*overrides)) as opened:
            opened.drives["linear"].set_input("analog-1", 1750.0)
            opened.drives["linear"].set_input("general-A", 1.0)
            opened.drives["linear"].objects.put(co.TPDO_MAPS[2][0], 1)
            opened.rig.connect()
            opened.rig.reference_axes()
            opened.rig.axis("insertion").start_move(100.0, 5.0)
            opened.rig.wait(1.0)
            opened.rig.take_can_frames()
            states, drive = opened.rig.read_states(), opened.drives["insertion"]
            assert set(_frames(opened)) == {SYNC, *REPORTS, *asked}
        assert states["insertion"].position == pytest.approx(drive.shaft_counts / 4000, abs=1 / 4000)
        assert states["insertion"].statusword == drive._statusword()
        assert [state.current_ma for state in states.values()] == [60.0, 0.0, 0.0]
        assert [state.position for state in states.values()][1:] == [0.0, 0.0]
        assert drive.objects.value(co.TPDO_MAPS[2][3]) == 0x20270010
    assert states["linear"].inputs == {"needle_force": pytest.approx(5.0), "door": True}
    assert states["insertion"].inputs == {}


def test_a_missing_report_is_requested_and_a_late_one_dropped() -> None:
    """The move goes on; requests are in the traffic and in the counts, and the reported state is the present one."""
    with ready_rig(moves=("insertion", 100.0, 5.0)) as opened:
        opened.rig.take_can_frames()
        catch_next(opened.hardware.wire, of=lambda frame: frame.arbitration_id == 0x382)
        assert opened.rig.read_states()["rotation"].position == 0.0
        assert opened.rig.axis("rotation").drive.describe()["retries"] == 1
        assert 0x602 in _frames(opened)
        delay_next(opened.hardware.wire, opened.hardware.clock, 4, 0.3)
        opened.rig.read_states()
        opened.rig.wait(1.0)
        read = opened.rig.read_states()["insertion"].position
        assert read == pytest.approx(opened.drives["insertion"].shaft_counts / 4000, abs=1 / 4000)


def test_a_drive_whose_mapping_is_refused_midway_is_read_by_sdo() -> None:
    """It sends no report then, and labrig asks for each value."""
    with one_drive() as bench:
        last = co.TPDO_MAPS[2][3]
        bench.drive.objects.values[co.TRANSMIT_PDO_COB_IDS[2]] = 0x381
        bench.drive.objects.refuse = lambda place: 0x06040041 if place == last else None
        bench.get_ready()
        assert bench.drive.objects.value(co.TRANSMIT_PDO_COB_IDS[2]) & co.PDO_INVALID
        bench.link.network.take_frames()
        bench.link.send(SYNC, b"")
        assert bench.driver.read(bench.clock.now_s()).current_ma == 0.0
        frames = bench.link.network.take_frames()
        asked = [data[1:3] for _, can_id, data, _ in frames if can_id == 0x601]
        assert asked == [b"\x41\x60", b"\x64\x60", b"\x27\x20"]
