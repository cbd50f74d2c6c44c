"""Tests of every camera: pictures have the stated size, are new, and have increasing times."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

import numpy as np

from labrig.clock import Clock
from labrig.devices.camera import Camera, CameraDescription, PictureSource
from labrig.errors import CameraError

_PAUSES_S = (0.01, 0.5, 0.01, 0.01, 0.01)


@dataclass(frozen=True)
class OpenedCamera:
    """An open source of pictures, its section of the rig file, and its clock."""

    source: PictureSource
    section: CameraDescription
    clock: Clock


class CameraConformance:
    """Tests of a kind of camera; a subclass opens one."""

    def open_camera(self) -> OpenedCamera:
        """Open the camera; each test opens it again."""
        raise NotImplementedError

    @contextmanager
    def _open(self) -> Iterator[tuple[Camera, OpenedCamera]]:
        opened = self.open_camera()
        with closing(opened.source):
            yield Camera(opened.source, opened.section, opened.clock), opened
        opened.source.close()  # a closed camera can be closed again

    def test_every_setting_is_made_and_read_back(self) -> None:
        """The camera reads back each setting of the section as requested."""
        with self._open() as (camera, opened):
            assert set(camera.settings) >= set(opened.section.settings())
            assert None not in camera.read_settings().values()

    def test_a_size_that_the_camera_lacks_is_refused(self) -> None:
        """A section with another width is refused when the camera is opened, or at its first picture."""
        opened = self.open_camera()
        other = opened.section.model_copy(update={"width_px": opened.section.width_px + 1})
        with closing(opened.source):
            try:
                Camera(opened.source, other, opened.clock).capture()
            except CameraError:
                return
        raise AssertionError(f"a picture of width {other.width_px} px was taken")

    def test_pictures_have_the_stated_size_and_are_not_overwritten(self) -> None:
        """A picture is (H, W) or (H, W, 3) uint8, and the next one leaves it unchanged."""
        with self._open() as (camera, opened):
            first = camera.capture().image
            kept = first.copy()
            assert not np.shares_memory(first, camera.capture().image)
            assert np.array_equal(first, kept)
            assert first.dtype == np.uint8
            assert first.shape[:2] == (opened.section.height_px, opened.section.width_px)
            assert first.shape[2:] in {(), (3,)}

    def test_a_picture_is_not_older_than_its_command(self) -> None:
        """Its time lies between the call and its return, and is later than that of the one before; it has a bound."""
        before_s = -1.0
        with self._open() as (camera, opened):
            for pause_s in _PAUSES_S:
                opened.clock.sleep(pause_s)
                asked_s = opened.clock.now_s()
                t_s = camera.capture().t_s
                assert max(before_s, asked_s - 1e-6) < t_s <= opened.clock.now_s() + 1e-6
                before_s = t_s
            exposure = opened.source.read()
            assert exposure is not None
            assert (exposure.t_s is None) == (exposure.t_bound_s is None)
            assert exposure.t_bound_s is None or exposure.t_bound_s >= 0
