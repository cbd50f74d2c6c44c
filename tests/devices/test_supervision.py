"""What a rig does, and says, while it supervises: its heartbeat, drives that do not answer, and another master."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Thread

import pytest

from labrig.devices.drives import objects as co
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.errors import ERRORS
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.heartbeat import LONGEST_EXCHANGE_S, HeartbeatClock
from labrig.devices.opening import Opening
from labrig.devices.operator import NO_OFFER, Answer, ClearBench, ConfirmFaultReset, Offer, OperatorRequest
from labrig.devices.rig import Rig, open_rig
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.node import NmtState
from labrig.errors import (
    DriveFaultError,
    DriveSilentError,
    DriveStrayedError,
    InterruptedRunError,
    LabrigError,
    MachineError,
    SafetyStopError,
    SecondMasterError,
)
from tests.devices.rigs import OpenedRig, Person, Signal, opened_rig, ready_rig, simulated_rig
from tests.devices.wire_faults import (
    ERROR_PASSIVE,
    FOR_GOOD,
    deafen,
    delay_next,
    ignore_next,
    listening,
    require_no_fault,
    send_as_other,
)

LONG_S = 120.0


@dataclass(frozen=True)
class Absent:
    """A person who has gone for long, and comes back to press Ctrl+C."""

    opened: OpenedRig

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Never answer."""
        while True:
            self.opened.hardware.clock.sleep(0.1)
            meanwhile()
            if self.opened.hardware.clock.now_s() > LONG_S:
                self.opened.signal.name = "SIGINT"


def test_a_question_that_nobody_answers_for_long_holds_the_axes_until_ctrl_c() -> None:
    """The beat goes on, no drive trips, nothing moves; then a signal stops the run."""
    with opened_rig() as opened:
        opened.rig.connect()
        opened.rig.operator = Absent(opened)
        with pytest.raises(InterruptedRunError, match="SIGINT"):
            opened.rig.ask(ClearBench("the board"))
        assert opened.hardware.clock.now_s() > LONG_S
        assert {drive.shaft_counts for drive in opened.drives.values()} == {0}
        require_no_fault(opened)
        assert decode_state(opened.rig.read_states()["insertion"].statusword) is DriveState.OPERATION_ENABLED


PERIOD_S, TIMEOUT_S, ONE_WAY_S = 0.1, 0.5, 0.01


def test_answers_of_20_ms_delay_no_beat() -> None:
    """Opening, homing, moving and closing: no beat is late by more than a period, and no drive trips.

    What waits looks once a period, and after an answer, whether a beat is due; and the beat has a way to go.
    """
    with opened_rig() as opened, listening(opened) as heard:
        delay_next(opened.hardware.wire, opened.hardware.clock, FOR_GOOD, ONE_WAY_S)
        opened.rig.connect()
        opened.rig.reference_axes()
        for axis in opened.rig.axes:
            axis.start_move(1.0, 1.0)
        opened.rig.wait(0.5)
        opened.rig.read_states()
        opened.rig.close()
        assert heard.longest_gap_s <= 2 * PERIOD_S + 3 * ONE_WAY_S
        require_no_fault(opened)


def test_an_exchange_without_end_is_no_supervision() -> None:
    """A labrig that goes on asking drives and supervises nothing stops beating, and the moving axis stops."""
    with ready_rig() as opened, listening(opened) as heard:
        opened.rig.axis("insertion").start_move(100.0, 5.0)
        drive, clock = opened.rig.axis("insertion").drive, opened.hardware.clock
        assert isinstance(drive, Cia402Drive)
        opened.rig.wait(0.1)
        began_s = clock.now_s()
        delay_next(opened.hardware.wire, opened.hardware.clock, FOR_GOOD, ONE_WAY_S)
        while clock.now_s() < began_s + LONGEST_EXCHANGE_S + 2 * TIMEOUT_S:
            drive.upload(co.POSITION_ACTUAL)
        assert heard.times_s[-1] - began_s <= LONGEST_EXCHANGE_S + 2 * ONE_WAY_S
        still_s = opened.drives["insertion"].shaft.still_s
        assert still_s - heard.times_s[-1] <= TIMEOUT_S + 5.0 / 200 + ONE_WAY_S


def test_another_thread_sends_no_beat() -> None:
    """Only the thread that supervises can: one that goes on while it hangs does not keep the drives moving."""
    with opened_rig() as opened, listening(opened) as heard:
        link = opened.hardware.open_link()
        heartbeat = HeartbeatClock(opened.hardware.clock, link, opened.rig.description.can.heartbeat)
        other = Thread(target=heartbeat.beat)
        other.start()
        other.join()
        assert heard.times_s == []
        heartbeat.beat()
        assert len(heard.times_s) == 1


COMMANDS = (b"\x23\x7a\x60\0\x00\xfa\0\0", b"\x2b\x40\x60\0\x0f\0\0\0", b"\x2b\x40\x60\0\x3f\0\0\0")
"""Start a move to 64,000 counts."""


def _command(opened: OpenedRig) -> None:
    send_as_other(opened, *((0x603, data) for data in COMMANDS))


STRIKES: dict[str, Callable[[OpenedRig], object]] = {
    "the bus": lambda opened: opened.hardware.wire.report(*ERROR_PASSIVE),
    "a signal": lambda opened: setattr(opened.signal, "name", "SIGINT"),
    "another master": _command,
    "a drive": lambda opened: opened.drives["linear"].fail(0x4210),
    "an NMT state": lambda opened: setattr(opened.drives["linear"], "nmt_state", NmtState.PRE_OPERATIONAL),
}


@pytest.mark.parametrize("what", STRIKES)
def test_nothing_beats_before_a_finding_is_dealt_with(what: str) -> None:
    """A step that finds something sends no heartbeat, however long the last one is ago."""
    with opened_rig() as opened:
        opened.rig.connect()
        opened.rig.wait(0.3)
        STRIKES[what](opened)
        opened.hardware.clock.sleep(0.11)
        with listening(opened) as heard:
            with pytest.raises(LabrigError):
                opened.rig.supervise()
            assert heard.times_s == []


def _command_unheard(opened: OpenedRig) -> None:
    for place, value in ((co.TARGET_POSITION, 64_000), (co.CONTROLWORD, 0x0F), (co.CONTROLWORD, 0x3F)):
        opened.drives["linear"].objects.put(place, value)


@pytest.mark.parametrize("moves", [("linear", 100.0, 1.0), None], ids=["moving", "idle"])
@pytest.mark.parametrize("move", [_command, _command_unheard], ids=["heard", "unheard"])
@pytest.mark.parametrize("after_s", [0.0, 0.07, 0.15])
def test_foreign_motion_is_stopped_and_told_within_half_a_second(
    after_s: float, move: Callable[[OpenedRig], None], moves: tuple[str, float, float] | None
) -> None:
    """By another program's set-point, also one of which nothing on the bus tells, whenever the last look was."""
    with ready_rig(moves=moves) as opened:
        opened.rig.wait(after_s)
        struck_s, linear = opened.hardware.clock.now_s(), opened.drives["linear"]
        move(opened)
        assert linear.is_moving
        with pytest.raises(SecondMasterError if move is _command else DriveStrayedError):
            opened.rig.wait(5.0)
        assert struck_s <= linear.shaft.still_s <= opened.hardware.clock.now_s() <= struck_s + 0.5


def test_another_master_ends_an_exchange_with_drives() -> None:
    """While a slow drive is started, a foreign set-point of an axis is found at once."""
    with ready_rig() as opened:
        linear = opened.drives["linear"]
        delay_next(opened.hardware.wire, opened.hardware.clock, FOR_GOOD, ONE_WAY_S)
        _command(opened)
        struck_s = opened.hardware.clock.now_s()
        with pytest.raises(SecondMasterError):
            opened.rig.start_move("insertion", 1.0, 1.0)
        assert struck_s < linear.shaft.still_s <= struck_s + 0.5
        assert not any(drive.is_moving for drive in opened.drives.values())


@contextmanager
def _moving() -> Iterator[OpenedRig]:
    """Yield a rig whose insertion axis moves, with the needle in tissue."""
    with ready_rig() as opened:
        opened.rig.needle.mark_in_tissue("run-1")
        opened.rig.axis("insertion").start_move(100.0, 5.0)
        for _ in range(20):
            opened.rig.wait(0.05)
            opened.rig.read_states()
        yield opened


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
    beats: list[int] = []
    with _moving() as opened, listening(opened) as heard:
        opened.rig._alert = lambda _text: beats.append(len(heard.times_s))
        opened.drives["insertion"].mute()
        with pytest.raises(DriveSilentError):
            opened.rig.wait(2.0)
        opened.rig._heartbeat.sleep(3.0)
        opened.rig._heartbeat.attend()
        opened.rig._heartbeat.beat()  # nor does a supervisor: stopping has failed
        assert beats == [len(heard.times_s)]
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
    description = simulated_rig("faults=[{fault: silent, axis: linear, once: moving}]")
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


@pytest.mark.parametrize("fault", [SimulatedCia402Drive.mute, deafen], ids=["silent", "deaf"])
def test_lost_drives_are_told_within_a_second(fault: Callable[[SimulatedCia402Drive], None]) -> None:
    """The alert comes before labrig tries to stop them; it names the emergency stop and the last positions."""
    alerts: list[tuple[float, str]] = []
    with _moving() as opened:
        struck_s = opened.rig.clock.now_s()
        opened.rig._alert = lambda text: alerts.append((opened.rig.clock.now_s(), text))
        for drive in opened.drives.values():
            fault(drive)
        with pytest.raises(DriveSilentError):
            opened.rig.wait(10.0)
        ((told_s, text),) = alerts
        assert told_s - struck_s <= 1.0
        assert re.match(
            r"the drive.* not answer: press the emergency stop; what the needle is doing is not", text
        )
        assert re.search(r"last positions: insertion 4\.\d\d mm 0\.\d s ago", text)
        located = opened.rig.locate_needle()
        assert "press the emergency stop" in located.motion
        assert located.axes[0].position == pytest.approx(5.0, abs=0.3)
        assert (located.axes[0].age_s or 0.0) > 0.5
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
