"""What makes the drives stop when labrig ends, verified at opening; and a bus that nobody else commands."""

from contextlib import ExitStack, nullcontext
from pathlib import Path

import pytest

from labrig.devices.axis_description import AxisDescription
from labrig.devices.check import check_bus
from labrig.devices.check_result import CheckStatus
from labrig.devices.clocks import SystemClock
from labrig.devices.dead_man import try_dead_man
from labrig.devices.drives import objects as co
from labrig.devices.drives.check import check_axis
from labrig.devices.drives.generic import DRIVE
from labrig.devices.drives.objects import Place
from labrig.devices.opening import Opening
from labrig.devices.operator import ConfirmUnguarded
from labrig.errors import BusError, DriveError, SecondMasterError
from tests.devices.rigs import HEARTBEAT, OneDrive, Person, instants, one_drive, opened_rig, ready_rig
from tests.devices.served import bench_description, bench_rig, served_drives
from tests.devices.wire_faults import abort_next, send_as_other

RECEIVE_PDO_COB_IDS = tuple(Place(0x1400 + n, 1) for n in range(4))
BEAT, READ_STATUS = (0x77F, b"\x05"), (0x601, b"\x40\x41\x60\0\0\0\0\0")
RETARGET = b"\x23\x7a\x60\0\x80\xa9\x03\0"


def configured(one: OneDrive) -> dict[str, int | None]:
    """Configure the drive, and return what the record says of its settings."""
    one.driver.identify()
    one.driver.configure(HEARTBEAT, None)
    found = one.driver.describe()["drive_settings"]
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize(("section", "codes"), [(None, (1, 1, 1, 2)), (DRIVE.example(1), (1, 1, 1, 2, 6))])
def test_option_codes_and_process_data_are_set_and_read_back(
    section: AxisDescription | None, codes: tuple[int, ...]
) -> None:
    """Whatever they were: a lost heartbeat is a fault, every way to stop is by a ramp, only the report is sent.

    An EPOS2 comes with four receive PDOs that anybody can write to.
    """
    with one_drive(section) as one:
        options = one.driver.model.stop_options
        one.drive.objects.values |= dict.fromkeys(options, 0)
        settings = configured(one)
        assert one.values(*options) == codes
        assert (settings["0x6007:00"], settings["0x1016:01"]) == (1, 127 << 16 | 500)
        assert one.values(co.CONSUMER_HEARTBEAT, co.PRODUCER_HEARTBEAT) == (127 << 16 | 500, 100)
        pdos = one.values(*RECEIVE_PDO_COB_IDS, *co.TRANSMIT_PDO_COB_IDS)
        assert [value & 0x7FF for value in pdos if not value & co.PDO_INVALID] == [0x381]
        assert one.driver.has_restarted is False


def test_an_option_that_a_firmware_lacks_is_null_in_the_record() -> None:
    """Without a reaction to silence a person has to confirm the drive, and the check names the object."""
    with one_drive() as one:
        abort_next(one.wire, one.drive, 0x06020000, co.SHUTDOWN_OPTION.index)
        assert configured(one)["0x605B:00"] is None
        abort_next(one.wire, one.drive, 0x06020000, co.ABORT_CONNECTION.index)
        assert "it may move on when labrig falls silent" in one.driver.identify().unguarded
        assert one.driver.identify().unguarded == ""
        for _ in range(2):  # it is asked with the identity, and again
            abort_next(one.wire, one.drive, 0x06020000, co.ABORT_CONNECTION.index)
        results = check_axis(one.link, one.driver.section, "insertion", one.clock)
        found = next(result for result in results if result.check == "guards insertion")
        assert found.status is CheckStatus.WARN
        assert "heartbeat stops (0x6007)" in found.value


@pytest.mark.parametrize("yes", [True, False])
def test_a_rig_with_a_drive_that_may_move_on_opens_on_confirmation(*, yes: bool) -> None:
    """The person is asked once for that drive; without a yes nothing is configured."""
    with opened_rig(person=(person := Person(yes))) as opened:
        opened.rig.operator = opened.rig._person = person
        abort_next(opened.hardware.wire, opened.drives["rotation"], 0x06020000, co.ABORT_CONNECTION.index)
        refusal = pytest.raises(DriveError, match="the operator did not confirm its use")
        with nullcontext() if yes else refusal:
            opened.rig.connect()
        assert [type(request) for request in person.asked] == [ConfirmUnguarded]
        assert opened.drives["insertion"].is_powered() is yes


@pytest.mark.parametrize(
    ("yes", "stops", "status", "told"),
    [
        (True, True, CheckStatus.PASS, "it stopped by itself, 0.5"),
        (True, False, CheckStatus.FAIL, "it moved on"),
        (False, True, CheckStatus.WARN, "not tried"),
    ],
)
def test_an_axis_has_to_stop_by_itself(*, yes: bool, stops: bool, status: CheckStatus, told: str) -> None:
    """Whatever its settings say; it is asked about before it moves, and the way that it still went is told."""
    with opened_rig(opening=Opening(("insertion",), camera=False)) as opened:
        opened.rig.operator = person = Person(yes)
        if not stops:
            vars(opened.drives["insertion"])["lose_master"] = lambda _t_s: None
        opened.rig.connect()
        result = try_dead_man(opened.rig, "insertion")
        assert result.status is status
        assert told in result.value
        assert "is going to move forwards by up to 2 mm, without a needle" in person.asked[0].text
        moved = opened.drives["insertion"].shaft_counts
        opened.hardware.clock.sleep(1.0)
        assert opened.drives["insertion"].shaft_counts == moved
        assert bool(moved) is yes


@pytest.mark.parametrize(
    ("from_s", "frame", "words"),
    [
        (0.0, BEAT, "it sends the heartbeat of node 127, as labrig does"),
        (0.0, READ_STATUS, "it reads object 0x6041:00 of axis insertion"),
        (0.0, (0x601, b"\x60"), "CAN frame 601#60 to axis insertion"),
        (0.35, BEAT, "heartbeat of node 127"),
    ],
)
def test_a_rig_on_a_bus_with_another_master_is_not_opened(
    from_s: float, frame: tuple[int, bytes], words: str
) -> None:
    """It is heard before anything is sent to a drive, and during the opening before power is switched on."""
    with opened_rig() as opened:
        clock = opened.hardware.clock
        clock.on_advance(lambda: send_as_other(opened, *([frame] if clock.now_s() > from_s else [])))
        with pytest.raises(SecondMasterError, match=words):
            opened.rig.connect()
        assert from_s or all(way == "R" for _, _, _, way in opened.rig.take_can_frames())
        assert not any(drive.is_powered() for drive in opened.drives.values())


def test_frames_to_other_nodes_are_ignored() -> None:
    """A node that is none of ours may have a master of its own."""
    with opened_rig() as opened:
        others = ((0x604, RETARGET), (0x77E, b"\x05"), (0x000, b"\x81\x04"), (0x401 + 3, b""))
        opened.hardware.clock.on_advance(lambda: send_as_other(opened, *others))
        opened.rig.connect()
        opened.rig.wait(1.0)


def test_the_check_warns_of_another_master() -> None:
    """It says what it heard."""
    with opened_rig() as opened, ExitStack() as stack:
        opened.hardware.clock.on_advance(lambda: send_as_other(opened, BEAT))
        found = next(check_bus(opened.rig.description, opened.hardware, stack))
        assert found.status is CheckStatus.WARN
        assert "it sends the heartbeat of node 127" in found.value


HEARTBEAT_S, SPEED_MM_S, QUICK_STOP_MM_S2 = 3.0, 4.0, 50.0
PATIENT = ("can.answer_timeout_ms=5000", f"can.heartbeat.timeout_ms={1000 * HEARTBEAT_S:.0f}")


def test_a_pulled_adapter_is_a_bus_error_and_the_drive_stops_by_itself(tmp_path: Path) -> None:
    """labrig names the bus; the drive misses the heartbeat and brakes, in its own time."""
    quick_stop = f"axes.insertion.quick_stop_deceleration={QUICK_STOP_MM_S2}"
    with served_drives("slcan") as served:
        drive = served.drives[1]
        with bench_rig(bench_description(served.reached_by, *PATIENT, quick_stop), tmp_path) as rig:
            rig.reference_axes()
            rig.axis("insertion").start_move(119.0, SPEED_MM_S)
            served.do(served.bus.shutdown)
            with pytest.raises(BusError, match=r"the CAN (adapter is gone|bus took no frame)"):
                rig.wait(60.0)
            while not instants(drive, "emergency") or drive.is_moving:
                rig.clock.sleep(0.01)
    failed_s = instants(drive, "emergency 0x8130")[-1]
    assert failed_s <= drive.shaft.still_s <= failed_s + SPEED_MM_S / QUICK_STOP_MM_S2 + 1e-6


def test_a_rehearsed_rig_lives_in_real_time() -> None:
    """5 mm at 10 mm/s and 50 mm/s2 take 0.5 s and the ramps by another clock; a picture's time lies within its call.

    Time passes for the drives while labrig does nothing: they miss its heartbeat, as on a bench.
    """
    with ready_rig("clock=real", PATIENT[1]) as opened:
        rig, clock = opened.rig, SystemClock()
        rig.axis("linear").start_move(5.0, 10.0)
        while not rig.read_states()["linear"].target_reached:
            rig.wait(0.02)
        assert 0.7 <= clock.now_s() < HEARTBEAT_S
        assert rig.read_states()["linear"].position == pytest.approx(5.0, abs=0.01)
        rig.axis("linear").start_move(100.0, 5.0)
        before_s = rig.clock.now_s()
        frame = rig.camera.capture()
        assert before_s <= frame.t_s <= rig.clock.now_s()
        assert 0 <= (frame.t_bound_s or -1) <= rig.clock.now_s() - before_s
        clock.sleep(HEARTBEAT_S + 0.5)
        with pytest.raises(DriveError):
            rig.wait(1.0)
        assert instants(opened.drives["linear"], "emergency 0x8130")
