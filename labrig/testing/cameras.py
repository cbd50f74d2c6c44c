"""What every camera does: pictures of the size that was promised, new ones, at times that rise."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

import numpy as np

from labrig.clock import Clock
from labrig.devices.camera import Camera, PictureSource
from labrig.devices.camera_settings import CameraDescription
from labrig.errors import CameraError

_PAUSE_S = 0.5
_PICTURES = 5


@dataclass(frozen=True)
class OpenedCamera:
    """A source of pictures, its section of the rig file, and the rig time in which it was opened."""

    source: PictureSource
    section: CameraDescription
    clock: Clock


class CameraConformance:
    """Tests of a kind of camera; a subclass says how one is opened."""

    def open_camera(self) -> OpenedCamera:
        """Open the camera; each test opens it anew."""
        raise NotImplementedError

    @contextmanager
    def _opened(self) -> Iterator[tuple[Camera, OpenedCamera]]:
        opened = self.open_camera()
        with closing(opened.source):
            yield Camera(opened.source, opened.section, opened.clock), opened

    def test_every_setting_is_taken_and_read_back(self) -> None:
        """Each setting of the section is asked for, and the camera tells that it uses it."""
        with self._opened() as (camera, opened):
            assert set(camera.settings.readback) == set(opened.section.settings())
            assert None not in camera.read_settings().values()

    def test_a_size_that_the_camera_has_not_is_refused(self) -> None:
        """A section that promises another width is refused when the camera is opened, or with its first picture."""
        opened = self.open_camera()
        other = opened.section.model_copy(update={"width_px": opened.section.width_px + 1})
        with closing(opened.source):
            try:
                Camera(opened.source, other, opened.clock).capture()
            except CameraError:
                return
        raise AssertionError(f"a picture of width {other.width_px} px was taken")

    def test_pictures_are_of_the_size_that_was_promised(self) -> None:
        """A picture is (H, W) or (H, W, 3) uint8, of the section's size."""
        with self._opened() as (camera, opened):
            image = camera.capture().image
            assert image.dtype == np.uint8
            assert image.shape[:2] == (opened.section.height_px, opened.section.width_px)
            assert image.ndim == 2 or image.shape[2:] == (3,)

    def test_a_picture_is_not_older_than_its_command(self) -> None:
        """After a pause the picture is one from after the call, and the call has not ended before it was taken."""
        with self._opened() as (camera, opened):
            camera.capture()
            opened.clock.sleep(_PAUSE_S)
            asked_s = opened.clock.now_s()
            frame = camera.capture()
            assert asked_s - 1e-6 <= frame.t_s <= opened.clock.now_s() + 1e-6

    def test_times_rise_from_picture_to_picture(self) -> None:
        """Each picture is later than the one before it where rig time passes, and numbered after it."""
        with self._opened() as (camera, opened):
            frames = []
            for _ in range(_PICTURES):
                frames.append(camera.capture())
                opened.clock.sleep(0.01)
            times_s = [frame.t_s for frame in frames]
            assert times_s == sorted(set(times_s))
            assert [frame.sequence for frame in frames] == list(range(_PICTURES))

    def test_a_time_that_is_told_has_a_bound(self) -> None:
        """A source that tells a time says how far it may be wrong."""
        with self._opened() as (_, opened):
            exposure = opened.source.read()
            assert exposure is not None
            assert (exposure.t_s is None) == (exposure.t_bound_s is None)
            assert exposure.t_bound_s is None or exposure.t_bound_s >= 0

    def test_a_picture_stays_as_it_was_taken(self) -> None:
        """The next picture is not written over the one before it."""
        with self._opened() as (camera, _):
            first = camera.capture().image
            kept = first.copy()
            second = camera.capture().image
            assert not np.shares_memory(first, second)
            assert np.array_equal(first, kept)

    def test_exposures_are_counted(self) -> None:
        """Every picture counts, as does each that was thrown away for it."""
        with self._opened() as (camera, opened):
            before = opened.source.exposures
            camera.capture()
            assert opened.source.exposures > before

    def test_closing_twice_does_no_harm(self) -> None:
        """A camera that was let go of is let go of again without an error."""
        source = self.open_camera().source
        source.close()
        source.close()
