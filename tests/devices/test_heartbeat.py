"""The heartbeats of computer and drives, and what each side does when the other falls silent."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Thread

import can
import pytest

from labrig.devices.drives import objects as co
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.heartbeat import LONGEST_EXCHANGE_S, HeartbeatClock
from labrig.devices.operator import NO_OFFER, Answer, ClearBench, Offer, OperatorRequest
from labrig.devices.simulated.bus import InProcessBus
from labrig.devices.simulated.node import NmtState
from labrig.errors import InterruptedRunError, LabrigError
from tests.devices.beats import listening, require_no_fault
from tests.devices.rigs import OpenedRig, opened_rig, ready_rig
from tests.devices.wire_faults import ERROR_PASSIVE, FOR_GOOD, delay_next


def test_a_question_that_nobody_answers_for_an_hour_holds_the_axes_until_ctrl_c() -> None:
    """The beat goes on, no drive trips, nothing moves; then a signal stops the run."""
    with opened_rig() as opened:
        opened.rig.connect()
        opened.rig.operator = Absent(opened)
        with pytest.raises(InterruptedRunError, match="SIGINT"):
            opened.rig.ask(ClearBench("the board"))
        assert opened.hardware.clock.now_s() > 3600
        assert {drive.shaft_counts for drive in opened.drives.values()} == {0}
        require_no_fault(opened)
        assert decode_state(opened.rig.read_states()["insertion"].statusword) is DriveState.OPERATION_ENABLED


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


# On time, and not otherwise

PERIOD_S, TIMEOUT_S = 0.1, 0.5
ONE_WAY_S = 0.01
ON_TIME_S = 2 * PERIOD_S + 3 * ONE_WAY_S
"""Longest gap between two beats: what waits looks once a period, and after an answer, whether one is due; and the beat
has a way to go."""


def test_answers_of_20_ms_delay_no_beat() -> None:
    """Opening, homing, moving and closing: no beat is late by more than a period, and no drive trips."""
    with opened_rig() as opened, listening(opened) as heard:
        delay_next(opened.hardware.wire, opened.hardware.clock, FOR_GOOD, ONE_WAY_S)
        opened.rig.connect()
        opened.rig.reference_axes()
        for axis in opened.rig.axes:
            axis.start_move(1.0, 1.0)
        opened.rig.wait(0.5)
        opened.rig.read_states()
        opened.rig.close()
        assert heard.longest_gap_s <= ON_TIME_S
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


def _command(opened: OpenedRig) -> None:
    master = InProcessBus(opened.hardware.wire, lambda _message: None)
    master.send(can.Message(arbitration_id=0x601, data=bytes(8), is_extended_id=False))


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
