"""The hardware of a rig, real or simulated. Only this file chooses between them, by the rig file."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from labrig.devices.bus import CanLink, open_can
from labrig.devices.camera import Camera, CameraContext, PictureSource, close_source
from labrig.devices.clocks import SystemClock
from labrig.devices.exclusive import acquire_rig
from labrig.devices.operator import Operator
from labrig.devices.rig_file import RigDescription
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.devices.worker import WorkerThread


class BenchHardware:
    """A real bus, camera and clock.

    Parameters
    ----------
    rig : RigDescription
        Names them.
    """

    operator: Operator | None = None

    def __init__(self, rig: RigDescription) -> None:
        self.clock = SystemClock()
        self.camera_worker = WorkerThread("camera", self.clock)
        self.disk_worker = WorkerThread("disk", self.clock)
        self._rig = rig

    def accompany(self, person: Operator) -> Operator:
        """Return the person."""
        return person

    def open_link(self) -> CanLink:
        """Connect to the CAN interface. Raises `BusError`."""
        return open_can(self._rig.can, self.clock)

    def open_source(self) -> PictureSource:
        """Open the camera. Raises `CameraError`."""
        return self._rig.camera.open(CameraContext(self.clock, self._rig.folder))

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return nothing: the truth of a bench is unknown."""
        return ()

    def close(self) -> None:
        """End the workers, once everything is on disk; a camera that hangs is not waited for."""
        self.camera_worker.close(0.0)
        self.disk_worker.close()


Hardware = BenchHardware | SimulatedHardware
"""Opens bus and camera of a rig; has its clock, its workers, and an operator that answers by itself, or None."""


def make_hardware(rig: RigDescription, seed: int) -> Hardware:
    """Return the hardware that the rig file describes; nothing is opened yet.

    Parameters
    ----------
    rig : RigDescription
        The rig file.
    seed : int
        For every draw of a simulated world.

    Raises
    ------
    InputError
        When entries that a simulated rig needs are unknown.
    """
    return BenchHardware(rig) if rig.world is None else SimulatedHardware(rig, rig.world, seed)


@contextmanager
def open_camera(rig: RigDescription, doing: str) -> Iterator[Camera]:
    """Open the camera of a rig, with all its settings made, and release it when the block ends.

    Parameters
    ----------
    rig : RigDescription
        The rig file; its axes need not be complete, nor connected, except on a simulated rig.
    doing : str
        What the camera is used for; another labrig that wants the rig prints it.

    Raises
    ------
    LockedError
        When another labrig uses the rig.
    CameraError
        When there is no camera, or it ignores a setting.
    """
    with ExitStack() as stack:
        stack.enter_context(acquire_rig(rig, doing))
        hardware = make_hardware(rig, seed=0)
        stack.callback(hardware.close)
        source = hardware.open_source()
        stack.callback(close_source, source, hardware.camera_worker)
        yield Camera(source, rig.camera, hardware.clock, hardware.camera_worker)
