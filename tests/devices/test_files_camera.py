"""Recorded pictures in place of a camera: order, times, and refusals."""

from pathlib import Path

import cv2
import pytest

from labrig.devices.camera import Camera, CameraContext
from labrig.devices.clocks import SimulatedClock
from labrig.devices.files import FilesCameraDescription
from labrig.errors import CameraError
from tests.devices.captures import SIZE_PX
from tests.devices.recorded import draw_numbered_picture, number_in, write_pictures


def _section(**keys: object) -> FilesCameraDescription:
    values = {"source": "p", "width_px": SIZE_PX[0], "height_px": SIZE_PX[1], "rate_hz": 20.0, **keys}
    return FilesCameraDescription(driver="files", **values)  # type: ignore[arg-type]


def _camera(folder: Path, clock: SimulatedClock | None = None, **keys: object) -> Camera:
    section, clock = _section(**keys), clock or SimulatedClock()
    return Camera(section.open(CameraContext(clock, folder)), section, clock)


def test_a_folder_gives_a_picture_for_each_read_and_ends_with_an_error(tmp_path: Path) -> None:
    """In the order of the numbers, 2 before 10, at the time of the read; the error has number, folder and remedy."""
    write_pictures(tmp_path / "p", 12)
    clock = SimulatedClock()
    camera = _camera(tmp_path, clock)
    for number in range(12):
        clock.sleep(1.5)
        frame = camera.capture()
        assert (number_in(frame.image), frame.t_s, frame.t_bound_s) == (number, 1.5 * (number + 1), None)
    with pytest.raises(CameraError, match=r"the 12 pictures of folder .*p have ended") as refusal:
        camera.capture()
    assert "labrig check" in refusal.value.hint


def test_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    """Only pictures inside the folder are read."""
    cv2.imwrite(str(tmp_path / "outside.png"), draw_numbered_picture(0))
    folder = write_pictures(tmp_path / "p", 1)
    (folder / "2.png").symlink_to(tmp_path / "outside.png")
    with pytest.raises(CameraError, match=r"2\.png is not a regular file"):
        _camera(tmp_path)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("empty", "holds no picture"),
        ("none", "none cannot be read"),
        ("concat:a.avi|b.avi", r"b\.avi cannot be read"),
        ("http://10.0.0.7/live", "live cannot be read"),
    ],
)
def test_a_source_without_pictures_is_refused(tmp_path: Path, source: str, words: str) -> None:
    """An empty folder and a missing one are named; what a library might open is a name like any other."""
    (tmp_path / "empty").mkdir()
    with pytest.raises(CameraError, match=words):
        _camera(tmp_path, source=source)


def test_a_setting_of_a_camera_is_no_key_of_a_folder() -> None:
    """Recorded pictures have no exposure."""
    with pytest.raises(ValueError, match="exposure_us"):
        _section(exposure_us=8000)
