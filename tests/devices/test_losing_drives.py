"""What a rig does, and says, once drives do not answer or are in fault."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import can
import pytest

from labrig.devices.drives import objects as co
from labrig.devices.drives.errors import ERRORS
from labrig.devices.opening import Opening
from labrig.devices.operator import ConfirmFaultReset
from labrig.devices.rig import Rig, open_rig
from labrig.devices.simulated.bus import InProcessBus
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.errors import (
    DriveFaultError,
    DriveSilentError,
    DriveStrayedError,
    MachineError,
    SafetyStopError,
    SecondMasterError,
)
from tests.devices.beats import listening
from tests.devices.rigs import OpenedRig, Person, Signal, opened_rig, ready_rig, simulated_rig
from tests.devices.wire_faults import FOR_GOOD, deafen, delay_next, ignore_next

SAID_WITHIN_S = 1.0
"""Longest time from the loss of the drives until the person at the rig is told [s]."""

SILENT = "faults=[{fault: silent, axis: linear, once: moving}]"


@dataclass
class Moving(OpenedRig):
    """A rig whose insertion axis moves, with the alerts that it gave and their times [s]."""

    alerts: list[tuple[float, str]] = field(default_factory=list)


@contextmanager
def _moving() -> Iterator[Moving]:
    with ready_rig() as opened:
        rig, moving = opened.rig, Moving(opened.rig, opened.hardware, opened.signal, opened.person)
        rig._alert = lambda text: moving.alerts.append((rig.clock.now_s(), text))
        rig.needle.mark_in_tissue("run-1")
        rig.axis("insertion").start_move(100.0, 5.0)
        for _ in range(20):
            rig.wait(0.05)
            rig.read_states()
        yield moving


def _go_on(rig: Rig) -> None:
    while True:
        rig.wait(rig.state_period_s)
        rig.read_states()


def _move_on(rig: Rig) -> None:
    rig.reference_axes()
    rig.axis("linear").start_move(50.0, 5.0)
    _go_on(rig)


def test_nothing_beats_after_a_loss() -> None:
    """A drive that hears and does not answer stops by itself: no wait, answer or question sends a beat."""
    with _moving() as opened, listening(opened) as heard:
        opened.drives["insertion"].mute()
        with pytest.raises(DriveSilentError):
            opened.rig.wait(2.0)
        beats = len(heard.times_s)
        opened.rig._heartbeat.sleep(3.0)
        opened.rig._heartbeat.attend()
        assert len(heard.times_s) == beats
        assert not opened.drives["insertion"].is_moving
        assert not opened.drives["linear"].is_moving


def test_beats_go_on_once_every_drive_answers() -> None:
    """A drive that missed two questions is no lost drive: it is stopped, read, and not driven into a fault."""
    with _moving() as opened, listening(opened) as heard:
        ignore_next(opened.hardware.wire, opened.drives["insertion"], 2)
        with pytest.raises(DriveSilentError):
            opened.rig.wait(2.0)
        opened.rig.wait(1.0)
        assert heard.times_s[-1] == pytest.approx(opened.rig.clock.now_s(), abs=0.1)


def test_closing_says_that_an_axis_may_move_and_that_its_power_may_be_on() -> None:
    """Neither hides the other."""
    with _moving() as opened:
        opened.drives["insertion"].unplug()
        with pytest.raises(SafetyStopError, match=r"not known to stand still: .*power not known to be off: "):
            opened.rig.close()


def test_an_error_says_too_that_the_rig_did_not_close() -> None:
    """What was wrong comes first, and what to do begins with the emergency stop; it is no bug of labrig."""
    description = simulated_rig(SILENT)
    with (
        pytest.raises(DriveSilentError, match=r"did not answer.*power not known to be off") as failure,
        open_rig(description, seed=1, person=Person(), interrupted=Signal()) as rig,
    ):
        _move_on(rig)
    assert failure.value.hint.startswith("press the emergency stop; then: check power")
    assert not hasattr(failure.value, "__notes__")


@pytest.mark.parametrize("codes", [(0x8130, 0x8130, 0x8130), (0x8130, 0x4210, 0x8130)])
def test_one_cause_is_one_question_or_refusal(codes: tuple[int, ...]) -> None:
    """Three drives that lost the computer's heartbeat are reset by one answer; another error is asked for itself."""
    with opened_rig(opening=Opening(reset_faults=True)) as opened:
        for drive, code in zip(opened.drives.values(), codes, strict=True):
            drive.fail(code)
        person = opened.rig.operator = Person()
        opened.rig.connect()
        questions = [request for request in person.asked if isinstance(request, ConfirmFaultReset)]
        assert len(questions) == len(person.asked) == len(set(codes))
        assert all(f"axis {name}" in " ".join(q.fault for q in questions) for name in opened.drives)
    with opened_rig() as opened:  # a run may reset nothing; the hint is one command for all axes
        for drive in opened.drives.values():
            drive.fail(0x8130)
        with pytest.raises(DriveFaultError, match=r"insertion.*rotation.*linear") as refused:
            opened.rig.connect()
        assert refused.value.hint.count("labrig devices home --rig") == 1


def _command(opened: OpenedRig, node: int) -> None:
    """Start a move to 64,000 counts as another program on the bus does."""
    master = InProcessBus(opened.hardware.wire, lambda _message: None)
    heads = (b"\x23\x7a\x60\0\x00\xfa\0\0", b"\x2b\x40\x60\0\x0f\0\0\0", b"\x2b\x40\x60\0\x3f\0\0\0")
    for data in heads:
        master.send(can.Message(arbitration_id=0x600 + node, data=data, is_extended_id=False))
    master.shutdown()


def _command_unheard(opened: OpenedRig, node: int) -> None:
    """Let a drive take such a move, of which nothing on the bus tells."""
    drive = next(drive for drive in opened.drives.values() if drive.node_id == node)
    for place, value in ((co.TARGET_POSITION, 64_000), (co.CONTROLWORD, 0x0F), (co.CONTROLWORD, 0x3F)):
        drive.objects.put(place, value)


@pytest.mark.parametrize("moves", [("insertion", 100.0, 1.0), None], ids=["moving axis", "idle axis"])
@pytest.mark.parametrize(("move", "told_within_s"), [(_command, 0.5), (_command_unheard, 0.6)])
def test_foreign_motion_is_reported_and_stopped_within_half_a_second(
    move: Callable[[OpenedRig, int], None], told_within_s: float, moves: tuple[str, float, float] | None
) -> None:
    """By another program's set-point, also one that was not heard; of an axis that moves and of one at rest.

    It is told once standstill has been read back: a set-point that was not heard is found by the next look.
    """
    with ready_rig(moves=moves) as opened:
        struck_s, drive = opened.rig.clock.now_s(), opened.drives["insertion"]
        move(opened, drive.node_id)
        assert drive.is_moving
        with pytest.raises(SecondMasterError if move is _command else DriveStrayedError):
            opened.rig.wait(5.0)
        assert opened.rig.clock.now_s() - struck_s <= told_within_s
        assert struck_s <= drive.shaft.still_s <= struck_s + 0.5
        assert not drive.is_moving


def test_another_master_ends_an_exchange_with_drives() -> None:
    """While a slow drive is started, a foreign set-point of an axis is found at once."""
    with ready_rig() as opened:
        wire, clock, linear = opened.hardware.wire, opened.hardware.clock, opened.drives["linear"]
        delay_next(wire, clock, FOR_GOOD, 0.01)
        _command(opened, linear.node_id)
        struck_s = clock.now_s()
        with pytest.raises(SecondMasterError):
            opened.rig.start_move("insertion", 1.0, 1.0)
        assert struck_s < linear.shaft.still_s <= struck_s + 0.5
        assert not any(drive.is_moving for drive in opened.drives.values())


# What is said of the needle


@pytest.mark.parametrize("fault", [SimulatedCia402Drive.mute, deafen], ids=["silent", "deaf"])
def test_lost_drives_are_told_within_a_second(fault: Callable[[SimulatedCia402Drive], None]) -> None:
    """The alert comes before labrig tries to stop them; it names the emergency stop and the last positions."""
    with _moving() as opened:
        struck_s = opened.rig.clock.now_s()
        for drive in opened.drives.values():
            fault(drive)
        with pytest.raises(DriveSilentError):
            opened.rig.wait(10.0)
        ((told_s, text),) = opened.alerts
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


def test_a_drive_that_restarted_is_where_it_was_last() -> None:
    """Its counter starts anew at zero, which is not where the needle is."""
    with _moving() as opened:
        opened.drives["insertion"].restart()
        with pytest.raises(MachineError):
            _go_on(opened.rig)
        located = opened.rig.locate_needle()
        assert located.axes[0].position == pytest.approx(5.0, abs=0.3)
        assert "lost power" in located.axes[0].why_old


def test_no_remedy_costs_the_position_of_a_needle_in_tissue() -> None:
    """Power is switched off and on only with no needle in tissue, and nothing is moved by hand."""
    for (table, code), (text, remedy) in ERRORS.items():
        assert text
        assert remedy or table == "sdo-abort" or (table, code) == ("class", 0x9)
        assert "by hand" not in remedy
        assert "off and on" not in remedy or "with no needle in tissue" in remedy
