"""Every kind of camera that labrig has passes the suite for cameras."""

from pathlib import Path

import pytest

from labrig.devices.camera import CameraContext
from labrig.devices.clocks import SimulatedClock
from labrig.devices.simulated.camera import SimulatedCameraDescription
from labrig.simulation.world import World
from labrig.testing.cameras import CameraConformance, OpenedCamera
from tests.devices.captures import FakeCapture, files_section, uvc_section, write_pictures
from tests.devices.rigs import simulated_rig


class TestSimulated(CameraConformance):
    """The simulated camera."""

    def open_camera(self) -> OpenedCamera:
        """Open one that sees a world."""
        rig, clock = simulated_rig(), SimulatedClock()
        assert rig.world is not None
        assert isinstance(rig.camera, SimulatedCameraDescription)
        source = rig.camera.open(CameraContext(clock, world=World(rig.world, seed=1)))
        return OpenedCamera(source, rig.camera, clock)


class TestUvc(CameraConformance):
    """A USB camera whose driver stamps its pictures."""

    stamps = True

    def open_camera(self) -> OpenedCamera:
        """Open one behind a fake device."""
        capture = FakeCapture(stamps=self.stamps)
        return OpenedCamera(capture.open()._source, uvc_section(), capture.clock)


class TestUvcWithoutStamps(TestUvc):
    """A USB camera whose driver does not stamp its pictures."""

    stamps = False


class TestFolder(CameraConformance):
    """A folder of pictures."""

    folder: Path

    @pytest.fixture(autouse=True)
    def _record(self, tmp_path: Path) -> None:
        self.folder = tmp_path
        write_pictures(tmp_path / "pictures", 40)

    def open_camera(self) -> OpenedCamera:
        """Open recorded pictures in simulated time."""
        clock, section = SimulatedClock(), files_section("pictures")
        return OpenedCamera(section.open(CameraContext(clock, self.folder)), section, clock)
