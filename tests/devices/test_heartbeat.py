"""The heartbeats of computer and drives, and what each side does when the other falls silent."""

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from labrig.devices.axis import AxisReadback
from labrig.devices.drives import objects as co
from labrig.devices.drives.states import DriveState
from labrig.devices.operator import NO_OFFER, Answer, ClearBench, Offer, OperatorRequest
from labrig.errors import (
    BusError,
    BusOffError,
    DriveFaultError,
    DriveRestartedError,
    DriveSilentError,
    InterruptedRunError,
)
from tests.devices.rigs import OpenedRig, count_repeats, opened_rig, simulated_rig


def _moving(opened: OpenedRig) -> None:
    opened.rig.connect()
    opened.rig.reference_axes()
    opened.rig.insertion.start_move(100.0, 5.0)
    opened.rig.wait(1.0)


def _read(opened: OpenedRig) -> AxisReadback:
    return opened.rig.read_states()["insertion"]


def test_drives_stop_when_the_computer_hangs() -> None:
    """The axis stands still within the heartbeat timeout and its deceleration."""
    with opened_rig() as opened:
        _moving(opened)
        drive, clock = opened.hardware.drives["insertion"], opened.hardware.clock
        clock.sleep(0.5 + 0.1 + 5.0 / 200)
        stood = drive.shaft_counts
        clock.sleep(1.0)
        assert drive.shaft_counts == stood
        with pytest.raises(DriveFaultError) as fault:
            opened.rig.read_states()
        assert (fault.value.code, fault.value.register & 0x10) == (0x8130, 0x10)
        assert "heartbeat of the computer lost" in fault.value.text
        assert fault.value.remedy


def test_a_drive_without_heartbeat_stops_the_rig() -> None:
    """It still answers, but the rig stops within its timeout and names the drive."""
    with opened_rig() as opened:
        _moving(opened)
        opened.drives["linear"].stop_heartbeat()
        mute_s = opened.hardware.clock.now_s()
        with pytest.raises(DriveSilentError, match=r"axis linear \(node 3\) has sent no heartbeat"):
            opened.rig.wait(2.0)
        assert opened.hardware.clock.now_s() - mute_s < 0.5 + 0.5


def test_a_power_cycle_in_the_middle_of_a_move_is_named() -> None:
    """The boot-up is noticed: the axis has lost its reference, and the others are stopped."""
    with opened_rig() as opened:
        _moving(opened)
        opened.hardware.drives["insertion"].restart()
        with pytest.raises(DriveRestartedError, match="lost power, its position and its reference"):
            opened.rig.wait(1.0)


def test_bus_off_is_named_and_the_drives_stop_by_themselves() -> None:
    """Nothing can be sent, so the drives miss the heartbeat."""
    with opened_rig() as opened:
        _moving(opened)
        opened.hardware.wire.enter_bus_off()
        with pytest.raises(BusOffError, match="bus is off"):
            opened.rig.wait(1.0)
        drive, clock = opened.hardware.drives["insertion"], opened.hardware.clock
        clock.sleep(1.0)
        stood = drive.shaft_counts
        clock.sleep(1.0)
        assert drive.shaft_counts == stood


def test_an_unplugged_adapter_is_a_bus_error() -> None:
    """The next frame raises it."""
    with opened_rig() as opened:
        _moving(opened)
        opened.hardware.wire.unplug()
        with pytest.raises(BusError, match="took no frame"):
            opened.rig.wait(1.0)


@pytest.mark.parametrize("fault", ["lose", "duplicate"])
def test_one_lost_or_repeated_frame_is_tolerated_and_counted(fault: str) -> None:
    """The request is repeated, or the second answer dropped; the move goes on."""
    with opened_rig() as opened:
        _moving(opened)
        getattr(opened.hardware.wire, fault)(2)
        for _ in range(3):
            _read(opened)
        assert sum(count_repeats(axis.drive) for axis in opened.rig.axes) >= 1
        assert _read(opened).state is DriveState.OPERATION_ENABLED


def test_drives_that_share_a_cob_id_get_their_own() -> None:
    """Both would obey one frame: process data that labrig does not use is switched off in each."""
    with opened_rig() as opened:
        first = co.RECEIVE_PDO_COB_IDS[0]
        opened.drives["rotation"].objects.put(first, 0x201)
        opened.rig.connect()
        assert all(drive.objects.value(first) & co.PDO_INVALID for drive in opened.drives.values())


def test_the_speed_is_that_between_two_positions() -> None:
    """5 mm/s reads as 5 mm/s, not as the drive's rounded rpm."""
    with opened_rig() as opened:
        _moving(opened)
        _read(opened)
        opened.rig.wait(0.1)
        assert _read(opened).speed == pytest.approx(5.0, abs=0.01)


def test_backlash_is_always_taken_up_from_below() -> None:
    """A downward move passes its target by the backlash and comes back."""
    with opened_rig(simulated_rig("axes.insertion.backlash=0.5")) as opened:
        opened.rig.connect()
        opened.rig.reference_axes()
        for target in (10.0, 5.0):
            opened.rig.insertion.start_move(target, 5.0)
            reached = [_read(opened)]
            while not reached[-1].target_reached:
                opened.rig.wait(0.05)
                reached.append(_read(opened))
            assert reached[-1].position == target
        assert min(axis.position for axis in reached) == pytest.approx(4.5, abs=0.05)


def test_a_question_that_nobody_answers_for_an_hour_holds_the_axes_until_ctrl_c() -> None:
    """The beat goes on, no drive trips, nothing moves; then a signal stops the run."""
    with opened_rig() as opened:
        opened.rig.connect()
        opened.rig.operator = Absent(opened)
        with pytest.raises(InterruptedRunError, match="SIGINT"):
            opened.rig.ask(ClearBench("the board"))
        assert opened.hardware.clock.now_s() > 3600
        assert {drive.shaft_counts for drive in opened.drives.values()} == {0}
        assert not any(
            event.kind == "emergency" for drive in opened.drives.values() for event in drive.journal
        )
        assert opened.rig.read_states()["insertion"].state is DriveState.OPERATION_ENABLED


@dataclass(frozen=True)
class Absent:
    """A person who has gone for an hour, and comes back to press Ctrl+C."""

    opened: OpenedRig

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Never answer."""
        while True:
            self.opened.hardware.clock.sleep(0.1)
            meanwhile()
            if self.opened.hardware.clock.now_s() > 3600:
                self.opened.signal.name = "SIGINT"
