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
from tests.devices.mover import HEARTBEAT_S, QUICK_STOP_MM_S2, SPEED_MM_S
from tests.devices.rigs import instants
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


def _wait_for(served: Served, what: str) -> float:
    """Return when the drive did something last, once it has done so after the move began [s]."""
    drive, clock = served.drives[1], SystemClock()
    while clock.now_s() < PATIENCE_S:
        begun, found = instants(drive, "set-point"), instants(drive, what)
        if begun and found and found[-1] >= begun[0]:
            return found[-1]
        clock.sleep(0.02)
    pytest.fail(f"no {what} in the drive's journal: {list(drive.journal)}")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["kill", "stop"])
def test_a_drive_stops_by_itself_when_labrig_is_gone(number: signal.Signals, tmp_path: Path) -> None:
    """It brakes a heartbeat timeout after the last heartbeat, and then stands still."""
    with served_drives("slcan") as served:
        beats = Beats(served)
        with _mover(served, tmp_path) as mover:
            _wait_for(served, "set-point")
            os.kill(mover.pid, number)
            failed_s = _wait_for(served, "emergency 0x8130")
            while served.drives[1].is_moving:
                SystemClock().sleep(0.02)
    last = sum(before <= failed_s for before in beats.before) - 1
    assert beats.before[last] + HEARTBEAT_S <= failed_s <= beats.after[last] + HEARTBEAT_S
    assert failed_s <= served.drives[1].shaft.still_s <= failed_s + SPEED_MM_S / QUICK_STOP_MM_S2 + 1e-6
    assert served.drives[1].shaft_counts > 0
