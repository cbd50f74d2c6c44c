"""The heartbeats of computer and drives, and what each side does when the other falls silent."""

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import DriveReading
from labrig.devices.drives.objects import Place
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.operator import NO_OFFER, Answer, ClearBench, Offer, OperatorRequest
from labrig.errors import (
    InterruptedRunError,
)
from tests.devices.rigs import OpenedRig, opened_rig, ready_rig


def _moving(opened: OpenedRig) -> None:
    opened.rig.connect()
    opened.rig.reference_axes()
    opened.rig.axis("insertion").start_move(100.0, 5.0)
    opened.rig.wait(1.0)


def _read(opened: OpenedRig) -> DriveReading:
    return opened.rig.read_states()["insertion"]


def test_drives_that_share_a_cob_id_get_their_own() -> None:
    """Both would obey one frame: process data that labrig does not use is switched off in each."""
    with opened_rig() as opened:
        first = Place(0x1400, 1)
        opened.drives["rotation"].objects.put(first, 0x201)
        opened.rig.connect()
        assert all(drive.objects.value(first) & co.PDO_INVALID for drive in opened.drives.values())


def test_backlash_is_always_taken_up_from_below() -> None:
    """A downward move passes its target by the backlash and comes back."""
    with ready_rig("axes.insertion.backlash=0.5") as opened:
        for target in (10.0, 5.0):
            opened.rig.axis("insertion").start_move(target, 5.0)
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
