"""labrig killed or frozen in the middle of a move, in a process of its own: the drive stops by itself.

All times are those of the drive's own clock and journal: however busy the machine is, the law between the last beat
that the drive heard and the instant at which it stood still is exact.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from labrig.devices.clocks import SystemClock
from labrig.devices.simulated.bus import InProcessBus
from labrig.devices.simulated.cia402 import DriveEvent
from tests.devices.mover import HEARTBEAT_S, QUICK_STOP_MM_S2, SPEED_MM_S
from tests.devices.served import Served, served_drives

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
COMPUTER = 0x77F
PATIENCE_S = 120.0
ATTEMPTS = 5


class Beats:
    """When beats passed the drives, in the drives' time: before the first of them heard one, and after the last had."""

    def __init__(self, served: Served) -> None:
        self.before: list[float] = []
        self.after: list[float] = []
        self._served = served
        served.do(self._listen)

    def _listen(self) -> None:
        wire, clock = self._served.wire, self._served.drives[1]._clock
        for place, times in ((0, self.before), (len(wire.endpoints), self.after)):

            def hear(message: can.Message, times: list[float] = times) -> None:
                if message.arbitration_id == COMPUTER:
                    times.append(clock.now_s())

            tap = InProcessBus(wire, hear)
            wire.endpoints.remove(tap)
            wire.endpoints.insert(place, tap)


@contextmanager
def _mover(served: Served, folder: Path) -> Iterator["subprocess.Popen[str]"]:
    """Start labrig; again where the machine was so busy that the drives gave it up before it moved anything."""
    command = [sys.executable, "-m", "tests.devices.mover", json.dumps(served.reached_by), str(folder)]
    for _ in range(ATTEMPTS):
        with subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as mover:
            try:
                assert mover.stdout is not None
                if mover.stdout.readline().strip() == "moving":
                    yield mover
                    return
            finally:
                mover.kill()
        for drive in served.drives.values():
            served.do(drive.restart)
    pytest.fail(f"labrig did not come to move anything in {ATTEMPTS} attempts")


def _wait_for(served: Served, kind: str) -> DriveEvent:
    """Return the drive's event of a kind, once there is one after the move began."""
    journal, clock = served.drives[1].journal, SystemClock()
    while clock.now_s() < PATIENCE_S:
        events = [event.kind for event in journal]
        if "set-point" in events and kind in events[events.index("set-point") :]:
            found = served.drives[1].find_last(kind)
            assert found is not None
            return found
        clock.sleep(0.02)
    pytest.fail(f"no {kind} in the drive's journal: {list(journal)}")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["kill", "stop"])
def test_a_drive_stops_by_itself_when_labrig_is_gone(number: signal.Signals, tmp_path: Path) -> None:
    """It brakes a heartbeat timeout after the last heartbeat, and then stands still."""
    with served_drives("slcan") as served:
        beats = Beats(served)
        with _mover(served, tmp_path) as mover:
            _wait_for(served, "set-point")
            os.kill(mover.pid, number)
            emergency = _wait_for(served, "emergency")
            while served.drives[1].is_moving:
                SystemClock().sleep(0.02)
    assert emergency.text == "0x8130"
    last = sum(before <= emergency.t_s for before in beats.before) - 1
    assert beats.before[last] + HEARTBEAT_S <= emergency.t_s <= beats.after[last] + HEARTBEAT_S
    assert (
        emergency.t_s
        <= served.drives[1].shaft.still_s
        <= emergency.t_s + SPEED_MM_S / QUICK_STOP_MM_S2 + 1e-6
    )
    assert served.drives[1].shaft_counts > 0
