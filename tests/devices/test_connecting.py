"""What connecting verifies, writes and reads back."""

import math
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Homing
from labrig.devices.drives.epos2 import Epos2Axis
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.shaft import Mechanics
from labrig.errors import DriveError, DriveRefusedError
from tests.devices import epos2_places as od
from tests.devices.rigs import (
    HEARTBEAT,
    OneDrive,
    OpenedRig,
    epos2_axis,
    one_drive,
    opened_rig,
    simulated_rig,
)

QUADCOUNTS_PER_MM = 4000
READ_BACK = {
    co.LOWER_LIMIT: -2 * QUADCOUNTS_PER_MM - 20,
    co.UPPER_LIMIT: 120 * QUADCOUNTS_PER_MM + 20,
    co.MAX_FOLLOWING_ERROR: round(0.4 * QUADCOUNTS_PER_MM),
    co.POSITION_WINDOW: 20,
    co.POSITION_WINDOW_TIME: 20,
    co.QUICK_STOP_DECELERATION: 200 * 120,
    co.CONSUMER_HEARTBEAT: 127 << 16 | 500,
    od.LIMIT_EXECUTION_MASK: 0x0008 | 3,
}


def _rig(*overrides: str) -> AbstractContextManager[OpenedRig]:
    settings = (
        "axes.insertion.limit_switches=[negative, positive]",
        "axes.insertion.max_following_error=0.4",
    )
    return opened_rig(simulated_rig(*settings, *overrides))


def _configure(one: OneDrive, section: Epos2Axis) -> None:
    one.driver.configure(HEARTBEAT, None)
    one.driver.set_limits(section.limits)


def _value(opened: OpenedRig, entry: Place) -> int:
    return opened.drives["insertion"].objects.value(entry)


def test_the_drive_has_the_settings_of_the_rig_file() -> None:
    """Windows, decelerations, heartbeat and switches; software limits once the axis is referenced."""
    with _rig() as opened:
        opened.rig.connect()
        assert (_value(opened, co.LOWER_LIMIT), _value(opened, co.UPPER_LIMIT)) == (-(2**31), 2**31 - 1)
        opened.rig.reference_axes()
        assert {entry: _value(opened, entry) for entry in READ_BACK} == READ_BACK


@pytest.mark.parametrize("place", READ_BACK, ids=str)
def test_a_setting_that_the_drive_does_not_keep_is_refused(place: Place) -> None:
    """Each setting is read back after it has been written; the error names the object."""
    section = epos2_axis(limit_switches=("negative", "positive"), max_following_error=0.4)
    with one_drive(told=section) as one:
        objects = one.drive.objects
        kept, name = objects.values[place], objects._objects[place].name
        objects._live = {**objects._live, place: lambda: kept}
        with pytest.raises(DriveError, match=f"kept {name} .{place}. at {kept} when"):
            _configure(one, section)


def _list_writes(opened: OpenedRig) -> list[int]:
    """Return the objects of settings that were written since the last call."""
    requests = [
        data for _, can_id, data, way in opened.rig.take_can_frames() if can_id == 0x601 and way == "T"
    ]
    places = [int.from_bytes(data[1:3], "little") for data in requests if data[0] & 0xE0 == 0x20]
    return [place for place in places if place not in {0x6040, 0x607A, 0x6060}]


def test_only_what_differs_is_written_and_the_fingerprint_last() -> None:
    """A second connection writes nothing; the first ends with both parts of 0x1020."""
    with _rig() as opened:
        opened.drives["insertion"].objects.values |= dict.fromkeys(od.CONFIGURATION, 7)
        opened.rig.connect()
        settings = _list_writes(opened)
        assert 0x6067 in settings
        assert settings[-2:] == [0x1020, 0x1020]
        opened.rig.connect()
        assert _list_writes(opened) == []


def test_all_failures_of_all_drives_are_reported_together() -> None:
    """A silent drive, and a wrong encoder and fingerprint of another, are in one error."""
    with _rig(
        "axes.rotation.configuration_fingerprint=[1, 2]", "axes.rotation.counts_per_turn=2048"
    ) as opened:
        drives = opened.drives
        drives["insertion"].unplug()
        drives["rotation"].objects.set_fixed(od.ENCODER_PULSES, 500)
        with pytest.raises(DriveError) as refusal:
            opened.rig.connect()
        for words in (
            "(node 1) did not answer",
            "(node 2) has counts_per_turn 2000 (0x2210:01), the rig file says 2048",
            "(node 2) has the configuration fingerprint [0, 0]",
        ):
            assert words in refusal.value.message


def test_a_referenced_drive_gets_changed_limits(tmp_path: Path) -> None:
    """It has kept its reference and old limits; the limits of the rig file replace them."""
    with _rig(f"state_file={tmp_path / 'state.json'}") as opened:
        opened.rig.connect()
        opened.rig.needle.mark_out()
        opened.rig.reference_axes()
        drive = opened.drives["insertion"]
        drive.objects.put(co.UPPER_LIMIT, 10 * QUADCOUNTS_PER_MM)
        opened.rig.connect()
        assert opened.rig.axis("insertion").referenced
        assert _value(opened, co.UPPER_LIMIT) == 120 * QUADCOUNTS_PER_MM + 20


# Homing


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


def test_a_homing_method_that_the_drive_lacks_is_refused() -> None:
    """The drive refuses it with an abort code, and nothing has moved."""
    with _rig() as opened:
        opened.rig.connect()
        with pytest.raises(DriveRefusedError) as refusal:
            opened.rig.home("insertion", Homing(method=5))
        assert refusal.value.code == 0x06090030
        assert opened.drives["insertion"].shaft_counts == 0
