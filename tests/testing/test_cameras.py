"""Every kind of camera that labrig has passes the suite for cameras."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from threading import Event, Thread
from typing import Literal

import numpy as np
import pytest

from labrig.devices.camera_kind import CameraContext
from labrig.devices.clocks import SimulatedClock, SystemClock
from labrig.devices.files.camera import CAMERA as FILES
from labrig.devices.files.settings import FilesCameraDescription
from labrig.devices.files.stream import ArrivingPictures
from labrig.devices.mjpeg.camera import CAMERA as MJPEG
from labrig.devices.mjpeg.settings import MjpegCameraDescription
from labrig.devices.simulated.camera import CAMERA as SIMULATED
from labrig.devices.simulated.camera import SimulatedCameraDescription
from labrig.devices.simulated.picture_stream import PictureStream
from labrig.devices.stream_source import StreamSource
from labrig.devices.uvc.source import UvcSource
from labrig.simulation.world import World
from labrig.testing.cameras import CameraConformance, OpenedCamera
from tests.devices.captures import (
    SIZE_PX,
    Computer,
    ComputerClock,
    EndlessStream,
    FakeCapture,
    FakeControls,
    uvc_section,
)
from tests.devices.recorded import write_film, write_pictures
from tests.devices.rigs import simulated_rig
from tests.rehearsing import free_port


class TestSimulated(CameraConformance):
    """The simulated camera."""

    def open_camera(self) -> OpenedCamera:
        """Open one that sees a world."""
        rig, clock = simulated_rig(), SimulatedClock()
        assert rig.world is not None
        assert isinstance(rig.camera, SimulatedCameraDescription)
        source = SIMULATED.open(rig.camera, CameraContext(clock, world=World(rig.world, seed=1)))
        return OpenedCamera(source, rig.camera, clock)


class TestUvc(CameraConformance):
    """A USB camera whose driver stamps its pictures."""

    stamps = True

    def open_camera(self) -> OpenedCamera:
        """Open one behind a fake device."""
        computer = Computer()
        clock = ComputerClock(computer)
        capture = FakeCapture(computer, stamps=self.stamps)
        source = UvcSource(
            capture, FakeControls(), clock, exposure_s=0.005, rate_hz=24.0, monotonic_s=computer
        )
        return OpenedCamera(source, uvc_section(), clock)


class TestUvcWithoutStamps(TestUvc):
    """A USB camera whose driver does not stamp its pictures."""

    stamps = False


class _Files(CameraConformance):
    folder: Path
    source = "pictures"
    times: Literal["rate"] | None = None

    @pytest.fixture(autouse=True)
    def _record(self, tmp_path: Path) -> None:
        self.folder = tmp_path
        write_pictures(tmp_path / "pictures", 40)
        write_film(tmp_path / "film.avi", 40)

    def open_camera(self) -> OpenedCamera:
        """Open recorded pictures in simulated time."""
        clock = SimulatedClock()
        section = FilesCameraDescription(
            driver="files",
            source=self.source,
            width_px=SIZE_PX[0],
            height_px=SIZE_PX[1],
            rate_hz=20.0,
            times=self.times,
        )
        return OpenedCamera(FILES.open(section, CameraContext(clock, self.folder)), section, clock)


class TestFolder(_Files):
    """A folder whose pictures have no times."""


class TestFolderByRate(_Files):
    """A folder with a picture every 50 ms."""

    times = "rate"


class TestFilm(_Files):
    """A video file, by its own times."""

    source = "film.avi"


class TestStream(CameraConformance):
    """A stream that never ends, in real time."""

    def open_camera(self) -> OpenedCamera:
        """Open one whose pictures arrive as fast as they are taken."""
        clock = SystemClock()
        section = FilesCameraDescription(
            driver="files",
            source="http://camera/stream",
            width_px=SIZE_PX[0],
            height_px=SIZE_PX[1],
            rate_hz=100.0,
            latency_s=0.002,
        )
        pictures = ArrivingPictures(EndlessStream(), section.address)
        source = StreamSource(pictures, clock, bound_s=section.latency_s)
        source.wait_for_first()
        return OpenedCamera(source, section, clock)


class TestMjpeg(CameraConformance):
    """A camera over HTTP that stamps each picture, in real time."""

    url = ""

    @pytest.fixture(autouse=True)
    def _send(self) -> Iterator[None]:
        """Show another picture every few milliseconds."""
        over, clock = Event(), SystemClock()
        with closing(PictureStream(free_port())) as stream:

            def show_until_over() -> None:
                while not over.wait(0.005):
                    stream.show(np.zeros(SIZE_PX[::-1], np.uint8), clock.utc().timestamp())

            shower = Thread(target=show_until_over)
            shower.start()
            self.url = stream.url
            yield
            over.set()
            shower.join()

    def open_camera(self) -> OpenedCamera:
        """Open it on the same computer."""
        clock = SystemClock()
        section = MjpegCameraDescription(
            driver="mjpeg",
            source=self.url,
            width_px=SIZE_PX[0],
            height_px=SIZE_PX[1],
            rate_hz=100.0,
            stamp_error_s=0.002,
        )
        return OpenedCamera(MJPEG.open(section, CameraContext(clock)), section, clock)
