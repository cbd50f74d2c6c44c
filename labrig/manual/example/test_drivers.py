"""The drive and the camera pass the conformance tests."""

from contextlib import AbstractContextManager

from labrig.devices.camera import CameraContext
from labrig.devices.clocks import SimulatedClock
from labrig.testing.cameras import CameraConformance, OpenedCamera
from labrig.testing.drives import DriveConformance, OpenedDrive, simulated_drive
from labrig_example.marker_camera import MarkerDescription


class TestStepper(DriveConformance):
    """The stepper on a bus inside the process."""

    def open_drive(self) -> AbstractContextManager[OpenedDrive]:
        """Open it."""
        return simulated_drive("example-stepper")


class TestMarkerCamera(CameraConformance):
    """The drawn marker."""

    def open_camera(self) -> OpenedCamera:
        """Open it."""
        clock = SimulatedClock()
        section = MarkerDescription(driver="example-marker", width_px=160, height_px=120, rate_hz=30.0)
        return OpenedCamera(section.open(CameraContext(clock)), section, clock)
