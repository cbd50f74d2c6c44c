"""The computer's heartbeat while drives are slow, and that it ends when nobody supervises."""

from pathlib import Path
from threading import Thread

import pytest

from labrig.devices.drives import objects as co
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.heartbeat import LONGEST_EXCHANGE_S, HeartbeatClock
from labrig.devices.rig_file import RigDescription
from tests.devices.beats import listening, require_no_fault
from tests.devices.cia402.sections import section_of
from tests.devices.rigs import opened_rig, ready_rig, simulated_rig
from tests.devices.wire_faults import FOR_GOOD, delay_next

PERIOD_S, TIMEOUT_S = 0.1, 0.5
ONE_WAY_S = 0.01
ON_TIME_S = 2 * PERIOD_S + 3 * ONE_WAY_S
"""Longest gap between two beats: what waits looks once a period, and after an answer, whether one is due; and the beat
has a way to go."""


def rig_of(kind: str, folder: Path) -> RigDescription:
    """Return a rig whose rotation has a drive of this kind."""
    description = simulated_rig()
    if kind == "epos2":
        return description
    rotation = section_of(
        folder, node_id=2, unit="rad", gear_ratio=16, lead_mm=None, limits=(-13, 13), max_speed=6.0
    )
    return description.model_copy(update={"axes": description.axes.model_copy(update={"rotation": rotation})})


@pytest.mark.parametrize("kind", ["epos2", "cia402"])
def test_answers_of_20_ms_delay_no_beat(kind: str, tmp_path: Path) -> None:
    """Opening, homing, moving and closing: no beat is late by more than a period, and no drive trips."""
    with opened_rig(rig_of(kind, tmp_path)) as opened, listening(opened) as heard:
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
        assert (
            opened.drives["insertion"].shaft.still_s - heard.times_s[-1] <= TIMEOUT_S + 5.0 / 200 + ONE_WAY_S
        )


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
