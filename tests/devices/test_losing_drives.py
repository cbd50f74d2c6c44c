"""What a rig does, and says, once drives do not answer or are in fault."""

from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest

from labrig.devices.opening import Opening
from labrig.devices.operator import ConfirmFaultReset
from labrig.devices.rig import Rig, open_rig
from labrig.devices.simulated.bus import InProcessBus
from labrig.errors import DriveFaultError, DriveSilentError, LimitError, SafetyStopError, SecondMasterError
from tests.devices.beats import listening
from tests.devices.rigs import OpenedRig, Person, Signal, opened_rig, ready_rig, simulated_rig
from tests.devices.wire_faults import FOR_GOOD, delay_next, ignore_next

SILENT = "faults=[{fault: silent, axis: linear, once: moving}]"


@contextmanager
def _moving() -> Iterator[OpenedRig]:
    with ready_rig() as opened:
        opened.rig.axis("insertion").start_move(100.0, 5.0)
        opened.rig.wait(0.5)
        yield opened


def _move_on(rig: Rig) -> None:
    rig.reference_axes()
    rig.axis("linear").start_move(50.0, 5.0)
    while True:
        rig.wait(0.1)
        rig.read_states()


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
def test_one_cause_is_one_question(codes: tuple[int, ...]) -> None:
    """Three drives that lost the computer's heartbeat are reset by one answer; another error is asked for itself."""
    with opened_rig(opening=Opening(reset_faults=True)) as opened:
        for drive, code in zip(opened.drives.values(), codes, strict=True):
            drive.fail(code)
        person = opened.rig.operator = Person()
        opened.rig.connect()
        questions = [request for request in person.asked if isinstance(request, ConfirmFaultReset)]
        assert len(questions) == len(person.asked) == len(set(codes))
        assert all(f"axis {name}" in " ".join(q.fault for q in questions) for name in opened.drives)


def test_one_cause_is_one_refusal() -> None:
    """The hint of a run that may reset nothing is one command for all axes."""
    with opened_rig() as opened:
        for drive in opened.drives.values():
            drive.fail(0x8130)
        with pytest.raises(DriveFaultError, match=r"insertion.*rotation.*linear") as refused:
            opened.rig.connect()
        assert refused.value.hint.count("labrig devices home --rig") == 1


def test_another_master_ends_an_exchange_with_drives() -> None:
    """While a slow drive is started, a foreign set-point of an axis is found at once."""
    with ready_rig() as opened:
        wire, clock, linear = opened.hardware.wire, opened.hardware.clock, opened.drives["linear"]
        delay_next(wire, clock, FOR_GOOD, 0.01)
        master = InProcessBus(wire, lambda _message: None)
        heads = (b"\x23\x7a\x60\0\x00\xfa\0\0", b"\x2b\x40\x60\0\x0f\0\0\0", b"\x2b\x40\x60\0\x3f\0\0\0")
        for data in heads:
            master.send(can.Message(arbitration_id=0x603, data=data, is_extended_id=False))
        struck_s = clock.now_s()
        with pytest.raises(SecondMasterError):
            opened.rig.start_move("insertion", 1.0, 1.0)
        assert struck_s < linear.shaft.still_s <= struck_s + 0.5
        assert not any(drive.is_moving for drive in opened.drives.values())


@pytest.mark.parametrize(("target", "goes"), [(0.0, True), (-1.5, True), (-1.6, False)])
def test_a_move_that_cannot_end_from_below_is_refused(target: float, goes: bool) -> None:
    """Backlash is taken up within the limits or not at all: nothing is clipped."""
    with ready_rig("axes.insertion.backlash=0.5") as opened:
        if goes:
            assert opened.rig.start_move("insertion", target, 5.0).position == pytest.approx(target)
            return
        with pytest.raises(LimitError, match="passes its target by the backlash"):
            opened.rig.start_move("insertion", target, 5.0)
        assert not opened.drives["insertion"].is_moving
