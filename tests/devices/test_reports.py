"""States by SYNC and report: few frames, a single instant, and SDO if a report fails."""

import pytest

from labrig.devices.drives import objects as co
from tests.devices.rigs import OpenedRig, one_drive, opened_rig, simulated_rig
from tests.devices.wire_faults import catch_next, delay_next

SYNC, REPORTS = 0x080, {0x381, 0x382, 0x383}


def _moving(opened: OpenedRig) -> None:
    opened.rig.connect()
    opened.rig.reference_axes()
    opened.rig.axis("insertion").start_move(100.0, 5.0)
    opened.rig.wait(1.0)
    opened.rig.take_can_frames()


def _frames(opened: OpenedRig) -> list[int]:
    """Return the COB-IDs of what has passed, beats left out."""
    return [can_id for _, can_id, _, _ in opened.rig.take_can_frames() if can_id < 0x700]


def test_the_states_of_three_axes_take_four_frames() -> None:
    """A SYNC and a report per drive; position, state and motor current are those of the drive.

    The current is 60 mA for friction of 1.5 mNm, by the motor's 25 mNm/A.
    """
    with opened_rig() as opened:
        _moving(opened)
        states = opened.rig.read_states()
        assert set(_frames(opened)) == {SYNC, *REPORTS}
        drive = opened.drives["insertion"]
        assert states["insertion"].position == pytest.approx(drive.shaft_counts / 4000, abs=1 / 4000)
        assert states["insertion"].statusword == drive._statusword()
        assert [state.current_ma for state in states.values()] == [60.0, 0.0, 0.0]
        assert drive.objects.value(co.TPDO_MAPS[2][3]) == 0x20270010


def test_inputs_of_a_drive_are_read_with_its_report() -> None:
    """Only of the drive to which something is wired; analog values are in the sensor's unit."""
    force = "needle_force: {source: analog-1, unit: N, units_per_volt: 4, zero_v: 0.5}"
    with opened_rig(
        simulated_rig(f"axes.insertion.inputs={{{force}, door: {{source: general-A}}}}")
    ) as opened:
        opened.drives["insertion"].set_input("analog-1", 1750.0)
        opened.drives["insertion"].set_input("general-A", 1.0)
        _moving(opened)
        states = opened.rig.read_states()
        assert states["insertion"].inputs == {"needle_force": pytest.approx(5.0), "door": True}
        assert states["linear"].inputs == {}
        assert set(_frames(opened)) == {SYNC, *REPORTS, 0x601, 0x581}


def test_a_missing_report_is_requested_and_counted() -> None:
    """The move goes on; the requests are in the recorded traffic and in the counts."""
    with opened_rig() as opened:
        _moving(opened)
        catch_next(opened.hardware.wire, of=lambda frame: frame.arbitration_id == 0x382)
        states = opened.rig.read_states()
        assert states["rotation"].position == 0.0
        assert opened.rig.axis("rotation").drive.describe()["retries"] == 1
        assert 0x602 in _frames(opened)


def test_a_late_report_is_dropped() -> None:
    """It counts as a stray, and the reported state is the present one."""
    with opened_rig() as opened:
        _moving(opened)
        delay_next(opened.hardware.wire, opened.hardware.clock, 4, 0.3)
        opened.rig.read_states()
        opened.rig.wait(1.0)
        read = opened.rig.read_states()["insertion"].position
        assert read == pytest.approx(opened.drives["insertion"].shaft_counts / 4000, abs=1 / 4000)


def test_a_drive_with_another_mapping_is_mapped_anew() -> None:
    """Whatever another program has left there."""
    with opened_rig() as opened:
        opened.drives["linear"].objects.put(co.TPDO_MAPS[2][0], 1)
        _moving(opened)
        assert opened.rig.read_states()["linear"].position == 0.0
        assert set(_frames(opened)) == {SYNC, *REPORTS}


def test_a_drive_whose_mapping_is_refused_midway_is_read_by_sdo() -> None:
    """It sends no report then, and labrig asks for each value."""
    with one_drive() as bench:
        last = co.TPDO_MAPS[2][3]
        bench.drive.objects.refuse = lambda place: 0x06040041 if place == last else None
        bench.get_ready()
        assert bench.drive.objects.value(co.TRANSMIT_PDO_COB_IDS[2]) & co.PDO_INVALID
        bench.link.network.take_frames()
        bench.link.send(SYNC, b"")
        assert bench.driver.read(bench.clock.now_s()).current_ma == 0.0
        frames = bench.link.network.take_frames()
        asked = [data[1:3] for _, can_id, data, _ in frames if can_id == 0x601]
        assert asked == [b"\x41\x60", b"\x64\x60", b"\x27\x20"]
