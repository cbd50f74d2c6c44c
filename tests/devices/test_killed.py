"""labrig killed or frozen in the middle of a move, in a process of its own: the drive stops by itself.

All times are those of the drive's own clock and journal: however busy the machine is, the law between the last beat
that the drive heard and the instant at which it stood still is exact.
"""

import os
import signal
from collections.abc import Mapping
from multiprocessing import get_context
from pathlib import Path

import can
import pytest

from labrig.devices.clocks import SystemClock
from labrig.devices.simulated.bus import InProcessBus
from tests.devices.rigs import instants
from tests.devices.served import bench_description, bench_rig, served_drives

pytestmark = pytest.mark.slow

HEARTBEAT_S, SPEED_MM_S, QUICK_STOP_MM_S2 = 3.0, 4.0, 50.0


def _move(reached_by: Mapping[str, object], folder: Path) -> None:
    """Move an axis until something ends it, beating."""
    settings = (
        f"can.heartbeat.timeout_ms={1000 * HEARTBEAT_S:.0f}",
        "can.answer_timeout_ms=5000",
        f"axes.insertion.quick_stop_deceleration={QUICK_STOP_MM_S2}",
    )
    with bench_rig(bench_description(reached_by, *settings), folder) as rig:
        rig.reference_axes()
        rig.axis("insertion").start_move(119.0, SPEED_MM_S)
        while True:
            rig.wait(0.1)
            rig.read_states()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["kill", "stop"])
def test_a_drive_stops_by_itself_when_labrig_is_gone(number: signal.Signals, tmp_path: Path) -> None:
    """It brakes a heartbeat timeout after the last heartbeat, and then stands still."""
    with served_drives("slcan") as served:
        wire, drive, clock = served.wire, served.drives[1], SystemClock()
        beats: list[tuple[float, float]] = []

        def hear(sender: InProcessBus, frame: can.Message) -> bool:
            if frame.arbitration_id != 0x77F:
                return False
            before_s = drive._clock.now_s()
            wire.deliver(sender, frame)
            beats.append((before_s, drive._clock.now_s()))
            return True

        wire.catchers.append(hear)
        labrig = get_context("spawn").Process(target=_move, args=(served.reached_by, tmp_path))
        labrig.start()
        try:
            while not instants(drive, "set-point"):
                assert labrig.is_alive()
                clock.sleep(0.02)
            assert labrig.pid is not None
            os.kill(labrig.pid, number)
            while not instants(drive, "emergency") or drive.is_moving:
                assert clock.now_s() < 120.0, drive.journal
                clock.sleep(0.02)
        finally:
            labrig.kill()
            labrig.join()
    (failed_s,) = instants(drive, "emergency 0x8130")
    before_s, after_s = max(beat for beat in beats if beat[0] <= failed_s)
    assert before_s + HEARTBEAT_S <= failed_s <= after_s + HEARTBEAT_S
    assert failed_s <= drive.shaft.still_s <= failed_s + SPEED_MM_S / QUICK_STOP_MM_S2 + 1e-6
    assert drive.shaft_counts > 0
