"""The open rig: axes, camera, operator and state together."""

import json
import math
from pathlib import Path

import pytest

from labrig.devices.drives import objects as co
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import wait_for_all
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.operator import MountNeedle, PlaceSpecimen, ShiftToHole
from labrig.devices.rig import open_rig
from labrig.devices.rig_file import RigDescription
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.errors import DriveError, LimitError, SafetyStopError
from tests.devices.rigs import OpenedRig, Person, Signal, epos2_drives, opened_rig, simulated_rig


def _go(opened: OpenedRig, axis: str, position: float, speed: float) -> None:
    opened.rig.axis(axis).start_move(position, speed)
    while not opened.rig.read_states()[axis].target_reached:
        opened.rig.wait(0.1)


def _ready(opened: OpenedRig) -> OpenedRig:
    opened.rig.connect()
    opened.rig.reference_axes()
    return opened


def _still(opened: OpenedRig) -> bool:
    before = [drive.shaft_counts for drive in opened.hardware.drives.values()]
    opened.hardware.clock.sleep(1.0)
    return before == [drive.shaft_counts for drive in opened.hardware.drives.values()]


# Moving


def test_moves_arrive_in_millimetres_and_radians() -> None:
    """Each axis reads its target, and the world is there too."""
    with opened_rig() as opened:
        _ready(opened)
        _go(opened, "linear", 15.0, 5.0)
        _go(opened, "rotation", math.pi, 1.0)
        _go(opened, "insertion", 40.0, 5.0)
        states = opened.rig.read_states()
        assert states["linear"].position == 15.0
        assert states["rotation"].position == pytest.approx(math.pi, abs=1e-4)
        assert states["insertion"].position == 40.0
        assert all(
            decode_state(state.statusword) is DriveState.OPERATION_ENABLED for state in states.values()
        )


def test_a_setpoint_has_requested_and_sent_values() -> None:
    """Position and speed are rounded on the wire; the rounded values are reported too."""
    with opened_rig(simulated_rig("axes.rotation.speed_tolerance_fraction=0.05")) as opened:
        setpoint = _ready(opened).rig.axis("rotation").start_move(1.0, 1.0)
        assert (setpoint.asked_position, setpoint.sent) == (1.0, {"sent_quadcounts": 5093, "sent_rpm": 153})
        assert setpoint.position == pytest.approx(1.0, abs=1e-4)
        assert setpoint.speed == pytest.approx(153 * 2 * math.pi / 960)


@pytest.mark.parametrize(
    ("position", "speed", "words"),
    [
        (120.001, 1.0, r"axis insertion: 120.001 mm is beyond its limits \[-2, 120\] mm"),
        (-2.001, 1.0, "beyond its limits"),
        (math.nan, 1.0, "beyond its limits"),
        (10.0, 20.001, "speed 20.001 mm/s is not within 0 to 20 mm/s"),
        (10.0, 0.0, "not within"),
        (10.0, 0.011, "1.32 rpm of the motor; the drive takes 1, off by 24.2 %"),
    ],
)
def test_a_move_beyond_a_limit_sends_nothing(position: float, speed: float, words: str) -> None:
    """Position, speed and rounding are checked first; the error names axis, value and limit."""
    with opened_rig() as opened:
        _ready(opened)
        with pytest.raises(LimitError, match=words):
            opened.rig.axis("insertion").start_move(position, speed)
        assert _still(opened)


def test_the_whole_range_can_be_driven() -> None:
    """The limits are inside the range: rounding does not trip those of the drive."""
    with opened_rig() as opened:
        _ready(opened)
        for position in (120.0, -2.0):
            _go(opened, "insertion", position, 20.0)
            assert opened.rig.read_states()["insertion"].position == position


def test_an_axis_without_reference_does_not_move() -> None:
    """Before zero is set, a position means nothing."""
    with opened_rig() as opened:
        opened.rig.connect()
        with pytest.raises(SafetyStopError, match="not referenced"):
            opened.rig.axis("insertion").start_move(1.0, 1.0)


def test_a_reversed_axis_turns_its_motor_the_other_way() -> None:
    """`reversed` changes the sign of the counter; limits stay in the direction of the axis."""
    with opened_rig(simulated_rig("axes.insertion.reversed=true")) as opened:
        _ready(opened)
        _go(opened, "insertion", 10.0, 5.0)
        assert opened.hardware.drives["insertion"].shaft_counts == -40_000
        _go(opened, "insertion", 120.0, 20.0)
        assert opened.rig.read_states()["insertion"].position == 120.0


def test_a_move_that_takes_far_too_long_is_an_error() -> None:
    """The rig does not wait forever for target reached."""
    with opened_rig() as opened:
        _ready(opened)
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
    with opened_rig() as opened:
        _ready(opened)
        opened.rig.axis("insertion").start_move(100.0, 1.0)
        opened.rig.wait(1.0)
        assert (
            wait_for_all({"one": opened.rig.axis("insertion").wait_until_still()}, opened.rig._heartbeat)
            == {}
        )
        driver = opened.rig.axis("insertion").drive
        assert isinstance(driver, Cia402Drive)
        statusword = driver.statusword()
        assert _still(opened)
        assert decode_state(statusword) is DriveState.QUICK_STOP_ACTIVE


def test_three_axes_are_stopped_in_parallel() -> None:
    """It takes the deceleration and the standstill time once, not once per axis."""
    with opened_rig() as opened:
        _ready(opened)
        opened.rig.axis("insertion").start_move(100.0, 1.0)
        opened.rig.wait(1.0)
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
    before = hardware.drives["insertion"].shaft_counts
    hardware.clock.sleep(1.0)
    assert hardware.drives["insertion"].shaft_counts == before < 10_000
    assert {drive._state for drive in epos2_drives(hardware).values()} == {DriveState.SWITCH_ON_DISABLED}


# Opening


def test_the_record_gets_every_device_in_json() -> None:
    """The description has drives with their settings, camera and bus."""
    with open_rig(simulated_rig(), seed=1, person=Person(), interrupted=Signal()) as rig:
        described = json.loads(json.dumps(rig.describe()))
    assert described["axes"]["linear"]["drive"]["model"] == "EPOS2 24/5"
    for axis in described["axes"].values():
        assert {"0x6065:00", "0x607F:00", "0x6083:00", "0x6085:00", "0x1016:01"} <= set(
            axis["drive_settings"]
        )
    assert described["camera"]["readback"]["exposure_us"] == 8000


# The needle


def _with_state(tmp_path: Path) -> RigDescription:
    return simulated_rig("state_file=state.json").placed_in(tmp_path)


def test_nothing_is_referenced_while_a_needle_may_be_in_tissue(tmp_path: Path) -> None:
    """Without a state file, zero needs a confirmation that the needle is out."""
    with opened_rig(_with_state(tmp_path)) as opened:
        opened.rig.connect()
        with pytest.raises(SafetyStopError, match="no state file yet"):
            opened.rig.reference_axes()
        opened.rig.needle.mark_out()
        opened.rig.reference_axes()


def test_the_next_run_respects_a_needle_left_in_tissue(tmp_path: Path) -> None:
    """It names the run that left the needle, and references nothing."""
    description = _with_state(tmp_path)
    with opened_rig(description) as opened:
        opened.rig.needle.mark_in_tissue("run-7")
    with opened_rig(description) as opened:
        opened.rig.connect()
        assert opened.rig.state.needle_in_tissue is True
        with pytest.raises(SafetyStopError, match="run run-7 ended with the needle in tissue"):
            opened.rig.reference_axes()


def test_a_reference_that_the_drive_lacks_does_not_count(tmp_path: Path) -> None:
    """The state file says referenced, the new drives do not: reference again."""
    description = _with_state(tmp_path)
    with opened_rig(description) as opened:
        opened.rig.needle.mark_out()
        _ready(opened)
        assert opened.rig.state.referenced == ("insertion", "rotation", "linear")
    with opened_rig(description) as opened:
        opened.rig.connect()
        assert opened.rig.state.referenced == ()
        assert not opened.rig.axis("insertion").referenced


# Camera, operator, truth


def test_the_operator_of_a_simulated_rig_moves_the_world() -> None:
    """Its requests set needle, specimen and hole; no person is asked."""
    with opened_rig() as opened:
        _ready(opened)
        for request in (MountNeedle("N7"), PlaceSpecimen("A", 10.0), ShiftToHole("A", 2, 20.0)):
            assert opened.rig.ask(request).confirmed
        _go(opened, "linear", 15.0, 5.0)
        _go(opened, "insertion", 10.0, 5.0)
        (truth,) = opened.rig.truth()
        assert (truth["needle_id"], truth["specimen"], truth["hole"]) == ("N7", "A", 2)
        assert truth["arc_length_mm"] == pytest.approx(10.0)
        assert opened.person.asked == []
