"""What is said of the needle when the drives are lost, fail, or labrig itself stood still."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from labrig.devices.drives.errors import ERRORS
from labrig.devices.fault_script import FaultDescription
from labrig.devices.rig import Rig
from labrig.errors import DriveFaultError, DriveSilentError, MachineError
from tests.devices.rigs import OpenedRig, opened_rig, ready_rig
from tests.devices.wire_faults import deafen

SAID_WITHIN_S = 1.0
"""Longest time from the loss of the drives until the person at the rig is told [s]."""


@contextmanager
def _moving(alerts: list[tuple[float, str]]) -> Iterator[OpenedRig]:
    """Move the insertion axis of a rig whose alerts are kept with their time."""
    with ready_rig() as opened:
        rig = opened.rig
        rig._alert = lambda text: alerts.append((rig.clock.now_s(), text))
        rig.needle.mark_in_tissue("run-1")
        rig.axis("insertion").start_move(100.0, 5.0)
        for _ in range(20):
            rig.wait(0.05)
            rig.read_states()
        yield opened


def _go_on(rig: Rig) -> None:
    while True:
        rig.wait(rig.state_period_s)
        rig.read_states()


def _wait(rig: Rig) -> None:
    while True:
        rig.wait(0.05)


def _silence(opened: OpenedRig, fault: str) -> None:
    for axis in ("insertion", "rotation", "linear"):
        opened.drives[axis].mute() if fault == "silent" else deafen(opened.drives[axis])


@pytest.mark.parametrize("doing", [_go_on, _wait], ids=["reading states", "waiting"])
@pytest.mark.parametrize("fault", ["silent", "deaf"])
def test_lost_drives_are_told_within_a_second(doing: Callable[[Rig], None], fault: str) -> None:
    """The alert comes before labrig tries to stop them; it names the emergency stop and the last positions."""
    alerts: list[tuple[float, str]] = []
    with _moving(alerts) as opened:
        struck_s = opened.rig.clock.now_s()
        _silence(opened, fault)
        with pytest.raises(DriveSilentError):
            doing(opened.rig)
        ((told_s, text),) = alerts
        assert told_s - struck_s <= SAID_WITHIN_S
        assert re.match(
            r"the drive.* not answer: press the emergency stop; what the needle is doing is not", text
        )
        assert re.search(r"last positions: insertion 4\.\d\d mm 0\.\d s ago", text)
        located = opened.rig.locate_needle()
        assert "press the emergency stop" in located.motion
        assert located.axes[0].position == pytest.approx(5.0, abs=0.3)
        assert located.axes[0].age_s is not None
        assert located.axes[0].age_s > 0.5
        assert re.search("does not answer|did not answer|no heartbeat", located.axes[0].why_old)


def test_a_drive_in_fault_still_says_where_it_is() -> None:
    """Its position is read after the end, not recalled."""
    alerts: list[tuple[float, str]] = []
    with _moving(alerts) as opened:
        opened.hardware.faults.inject(
            FaultDescription.model_validate({"fault": "emergency", "axis": "insertion", "code": 0x8611})
        )
        with pytest.raises(DriveFaultError):
            _go_on(opened.rig)
        opened.hardware.clock.sleep(1.0)
        located = opened.rig.locate_needle()
        truly_mm = opened.drives["insertion"].shaft_counts / 4000
        assert alerts == []
        assert located.motion == "every axis stands still; the needle is in tissue"
        assert located.axes[0].position == pytest.approx(truly_mm, abs=0.02)
        assert (located.axes[0].age_s, located.axes[0].why_old) == (0.0, "")


def test_a_drive_that_restarted_is_where_it_was_last() -> None:
    """Its counter starts anew at zero, which is not where the needle is."""
    with _moving([]) as opened:
        opened.drives["insertion"].restart()
        with pytest.raises(MachineError):
            _go_on(opened.rig)
        located = opened.rig.locate_needle()
        assert located.axes[0].position == pytest.approx(5.0, abs=0.3)
        assert "lost power" in located.axes[0].why_old


@pytest.mark.parametrize("standstill_s", [0.8, 300.0])
def test_a_labrig_that_stood_still_says_so(standstill_s: float) -> None:
    """Drives that stopped because labrig sent nothing are not blamed, and neither is the wiring; nobody is alarmed."""
    alerts: list[tuple[float, str]] = []
    with _moving(alerts) as opened:
        opened.hardware.clock.sleep(standstill_s)
        with pytest.raises(
            DriveFaultError, match=rf"labrig itself stood still for {standstill_s:.1f} s"
        ) as error:
            _go_on(opened.rig)
        assert "heartbeat of the computer lost" in error.value.message
        assert "suspended computer" in error.value.hint
        assert not re.search("wiring|power the drive", error.value.hint)
        assert alerts == []


def test_an_unknown_needle_is_said_to_be_unknown() -> None:
    """Nobody knows of a rig without a state file; it is neither in tissue nor out."""
    with opened_rig() as opened:
        opened.rig.connect()
        opened.rig.needle.update(needle_in_tissue=None, note="this rig has no state file yet")
        opened.rig.stop()
        located = opened.rig.locate_needle()
        assert located.motion == (
            "every axis stands still; whether a needle is in tissue is not known (this rig has no state file yet)"
        )
        assert located.document()["in_tissue"] is None


def test_no_remedy_costs_the_position_of_a_needle_in_tissue() -> None:
    """Power is switched off and on only with no needle in tissue, and nothing is moved by hand."""
    for (table, code), (text, remedy) in ERRORS.items():
        assert text
        assert remedy or table == "sdo-abort" or (table, code) == ("class", 0x9)
        assert "by hand" not in remedy
        assert "off and on" not in remedy or "with no needle in tissue" in remedy
