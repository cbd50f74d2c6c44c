"""Opens the camera of a rig without its bus and axes."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from labrig.devices.camera import Camera, close_source
from labrig.devices.control import acquire_rig
from labrig.devices.hardware import make_hardware
from labrig.devices.rig_file import RigDescription


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
