"""What blocks for a time of the injected clock: a camera that hangs, a disk that is busy."""

import math
import random
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures import wait as wait_in_real_time
from contextlib import contextmanager
from threading import Event, Lock
from typing import Any, TypeVar

from labrig.devices.camera import Exposure, PictureSource
from labrig.devices.clocks import SimulatedClock
from labrig.devices.rig_file import RigDescription
from labrig.devices.simulated.camera import SimulatedSource
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.devices.worker import WorkerThread
from labrig.simulation.world import World
from tests.devices.rigs import OpenedRig, opened_rig, simulated_rig

_T = TypeVar("_T")

_REAL_LIMIT_S = 60.0
"""A test fails whose rig time stands still for so long, as when the supervising thread itself is blocked [s]."""


class Blockade:
    """Blocks threads until rig time has passed, which somebody else lets pass."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._lock = Lock()
        self._blocked: list[tuple[float, Event]] = []
        clock.on_advance(self._release)

    def hold(self, duration_s: float) -> None:
        """Block this thread for so much rig time [s]."""
        over = Event()
        if not duration_s:
            return
        with self._lock:
            self._blocked.append((self._clock.now_s() + duration_s, over))
        assert over.wait(_REAL_LIMIT_S), "rig time stands still"

    def _release(self) -> None:
        with self._lock:
            due = [held for held in self._blocked if held[0] <= self._clock.now_s()]
            self._blocked = [held for held in self._blocked if held not in due]
        for _, over in due:
            over.set()

    def wait(self, future: Future[Any], longest_s: float) -> bool:
        """Wait for a call of a worker: rig time passes only while a thread is blocked."""
        limit_s = time.monotonic() + _REAL_LIMIT_S
        while not self._blocked and not future.done():
            wait_in_real_time([future], 0.001)
            assert time.monotonic() < limit_s, "a call neither ends nor is blocked"
        if not future.done():
            self._clock.sleep(longest_s)
        return future.done()


class BusyDisk(WorkerThread):
    """A worker each call of which waits for the disk first."""

    def __init__(self, blockade: Blockade, clock: SimulatedClock) -> None:
        super().__init__("disk", clock, blockade.wait)
        self.busy_s = 0.0
        self._blockade = blockade

    def do(self, call: Callable[[], _T], meanwhile: Callable[[], None], limit_s: float = math.inf) -> _T:
        """Do it, once the disk is ready."""

        def wait_and_call() -> _T:
            self._blockade.hold(self.busy_s)
            return call()

        return super().do(wait_and_call, meanwhile, limit_s)


class HangingSource(SimulatedSource):
    """A camera that shows the simulated world, and can hang."""

    hangs_s = 0.0

    def __init__(self, world: World, clock: SimulatedClock, blockade: Blockade) -> None:
        super().__init__(world, clock)
        self._blockade = blockade

    def read(self) -> Exposure:
        """Give a picture, after it has hung."""
        self._blockade.hold(self.hangs_s)
        return super().read()


class ThreadedHardware(SimulatedHardware):
    """Simulated drives and world, with the workers of a bench; its sleeps last up to `late_s` longer than asked."""

    def __init__(self, rig: RigDescription, late_s: float) -> None:
        assert rig.world is not None
        super().__init__(rig, rig.world, seed=1)
        self.blockade = Blockade(self.clock)
        self.camera_worker = WorkerThread("camera", self.clock, self.blockade.wait)
        self.disk = self.disk_worker = BusyDisk(self.blockade, self.clock)
        self.camera = HangingSource(self.world, self.clock, self.blockade)
        sleep, late = self.clock.sleep, random.Random(1)
        vars(self.clock)["sleep"] = lambda duration_s: sleep(duration_s + late.uniform(0.0, late_s))

    def open_source(self) -> PictureSource:
        """Open the camera."""
        return self.camera

    def close(self) -> None:
        """Take the drives off the bus, and end the workers."""
        super().close()
        self.camera_worker.close(0.0)
        self.disk_worker.close()


@contextmanager
def threaded_rig(
    description: RigDescription | None = None, *, late_s: float = 0.0
) -> Iterator[tuple[OpenedRig, ThreadedHardware]]:
    """Open a rig whose camera and disk can block, and whose computer may be late; it is not closed by this."""
    description = description or simulated_rig()
    hardware = ThreadedHardware(description, late_s)
    with opened_rig(description, hardware=hardware) as opened:
        yield opened, hardware
