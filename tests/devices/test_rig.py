"""The open rig: axes, camera, operator and state together."""

import math
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from labrig.devices.drives import objects as co
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import wait_for_all
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.rig import open_rig
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.errors import DriveError, LimitError, SafetyStopError
from tests.devices.rigs import (
    OpenedRig,
    Person,
    Signal,
    instants,
    opened_rig,
    ready_rig,
    simulated_rig,
)


def _go(opened: OpenedRig, axis: str, position: float, speed: float) -> None:
    opened.rig.axis(axis).start_move(position, speed)
    while not opened.rig.read_states()[axis].target_reached:
        opened.rig.wait(0.1)


def _still(hardware: SimulatedHardware) -> bool:
    before = [drive.shaft_counts for drive in hardware.drives.values()]
    hardware.clock.sleep(1.0)
    return before == [drive.shaft_counts for drive in hardware.drives.values()]


# Moving


def test_moves_arrive_in_millimetres_and_radians() -> None:
    """Each axis reads its target; a reversed one turns its motor the other way, and keeps the direction of its limits.

    The limits are inside the range: rounding does not trip those of the drive.
    """
    with ready_rig("axes.insertion.reversed=true") as opened:
        _go(opened, "linear", 15.0, 5.0)
        _go(opened, "rotation", math.pi, 1.0)
        for position in (120.0, -2.0, 10.0):
            _go(opened, "insertion", position, 20.0)
            states = opened.rig.read_states()
            assert states["insertion"].position == position
        assert opened.hardware.drives["insertion"].shaft_counts == -40_000
        assert states["linear"].position == 15.0
        assert states["rotation"].position == pytest.approx(math.pi, abs=1e-4)
        enabled = {decode_state(state.statusword) for state in states.values()}
        assert enabled == {DriveState.OPERATION_ENABLED}


def test_a_setpoint_has_requested_and_sent_values() -> None:
    """Position and speed are rounded on the wire; the rounded values are reported too."""
    with ready_rig("axes.rotation.speed_tolerance_fraction=0.05") as opened:
        setpoint = opened.rig.axis("rotation").start_move(1.0, 1.0)
        assert (setpoint.asked_position, setpoint.sent_counts, setpoint.sent_speed_units) == (1.0, 5093, 153)
        assert setpoint.position == pytest.approx(1.0, abs=1e-4)
        assert setpoint.speed == pytest.approx(153 * 2 * math.pi / 960)


def test_a_move_beyond_a_limit_sends_nothing() -> None:
    """Position, speed and rounding are checked first; the error names axis, value and limit."""
    with ready_rig() as opened:
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
        assert _still(opened.hardware)


def test_backlash_is_taken_up_from_below_or_the_move_is_refused() -> None:
    """A downward move passes its target by the backlash and comes back; nothing is clipped at the lower limit."""
    with ready_rig("axes.insertion.backlash=0.5") as opened:
        lowest = []
        for target in (10.0, 5.0, -1.5):
            opened.rig.axis("insertion").start_move(target, 5.0)
            reached = [opened.rig.read_states()["insertion"]]
            while not reached[-1].target_reached:
                opened.rig.wait(0.05)
                reached.append(opened.rig.read_states()["insertion"])
            assert reached[-1].position == target
            lowest.append(min(state.position for state in reached))
        assert lowest[1:] == pytest.approx([4.5, -2.0], abs=0.05)
        _go(opened, "insertion", 0.0, 5.0)
        with pytest.raises(LimitError, match="passes its target by the backlash"):
            opened.rig.start_move("insertion", -1.6, 5.0)
        assert not opened.drives["insertion"].is_moving


def test_an_axis_without_reference_does_not_move() -> None:
    """Before zero is set, a position means nothing."""
    with opened_rig() as opened:
        opened.rig.connect()
        with pytest.raises(SafetyStopError, match="not referenced"):
            opened.rig.axis("insertion").start_move(1.0, 1.0)


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


# Stopping


def test_stop_quick_stops_an_axis_that_goes_on() -> None:
    """An axis that starts again after the halt is quick-stopped."""
    with ready_rig(moves=("insertion", 100.0, 1.0)) as opened:
        axis = opened.rig.axis("insertion")
        assert wait_for_all({"one": axis.wait_until_still()}, opened.rig._heartbeat) == {}
        assert isinstance(axis.drive, Cia402Drive)
        statusword = axis.drive.statusword()
        assert _still(opened.hardware)
        assert decode_state(statusword) is DriveState.QUICK_STOP_ACTIVE


def test_three_axes_are_stopped_in_parallel() -> None:
    """It takes the deceleration and the standstill time once, not once per axis."""
    with ready_rig(moves=("insertion", 100.0, 1.0)) as opened:
        before_s = opened.rig.clock.now_s()
        opened.rig.stop()
        assert opened.rig.clock.now_s() - before_s <= 0.2 + 0.05


def test_an_error_in_the_block_stops_and_releases_the_rig() -> None:
    """The axes stand still, power is off, and the error is the one raised."""
    opened = []

    def fail_while_moving() -> None:
        with open_rig(simulated_rig(), seed=1, person=Person(), interrupted=Signal()) as rig:
            opened.append(rig._hardware)
            rig.reference_axes()
            rig.axis("insertion").start_move(40.0, 1.0)
            rig.wait(1.0)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_while_moving()
    (hardware,) = opened
    assert isinstance(hardware, SimulatedHardware)
    assert _still(hardware)
    assert hardware.drives["insertion"].shaft_counts < 10_000
    assert {drive._state for drive in hardware.drives.values()} == {DriveState.SWITCH_ON_DISABLED}


# Opening


# The needle


def test_nothing_is_referenced_while_a_needle_may_be_in_tissue(tmp_path: Path) -> None:
    """Zero needs a confirmation that the needle is out, without a state file and after a run that left it there.

    A reference that the state file has and the new drives have not does not count.
    """
    description = simulated_rig("state_file=state.json").placed_in(tmp_path)
    with opened_rig(description) as opened:
        opened.rig.connect()
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


# Camera, operator, truth


# No command goes beyond the limits


RIG = simulated_rig("axes.insertion.backlash=0.3", "axes.linear.reversed=true")
AXES = ("insertion", "rotation", "linear")
ANYTHING = st.one_of(
    st.floats(),
    st.floats(-200, 200),
    st.sampled_from([-2.0, 120.0, -13.0, 13.0, -5.0, 150.0, 120.001, -2.0001]),
)
SPEED = st.one_of(st.floats(), st.floats(0.5, 20), st.just(20.0))


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
@given(st.lists(st.tuples(st.sampled_from(AXES), ANYTHING, SPEED, st.floats(0, 30)), max_size=8))
@example([("insertion", 120.0, 20.0, 7.0), ("insertion", -2.0, 20.0, 30.0), ("linear", 150.0, 20.0, 30.0)])
def test_no_moves_at_all_take_an_axis_beyond_its_limits(
    moves: list[tuple[str, float, float, float]],
) -> None:
    """Refused, made or replaced, with backlash and reversed axes: no move ends in a fault."""
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
            for _ in range(int(wait_s / 0.1)):
                opened.rig.wait(0.1)
        opened.rig.stop()
        assert beyond == []
        for drive in opened.drives.values():
            assert not instants(drive, "emergency")
            assert drive.objects.value(co.ERROR_COUNT) == 0
