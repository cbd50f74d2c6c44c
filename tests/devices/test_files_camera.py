"""Recorded pictures in place of a camera: order, times, and refusals."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from labrig.devices.camera import Camera, CameraContext
from labrig.devices.clocks import SimulatedClock
from labrig.devices.files import CAMERA as FILES
from labrig.devices.files import FilesCameraDescription
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.errors import CameraError, FileFormatError
from tests.devices.captures import SIZE_PX
from tests.devices.recorded import draw_numbered_picture, number_in, write_pictures
from tests.devices.rigs import SIMULATED


def _section(**keys: object) -> FilesCameraDescription:
    values = {"source": "p", "width_px": SIZE_PX[0], "height_px": SIZE_PX[1], "rate_hz": 20.0, **keys}
    return FilesCameraDescription(driver="files", **values)  # type: ignore[arg-type]


def _camera(folder: Path, clock: SimulatedClock | None = None, **keys: object) -> Camera:
    section, clock = _section(**keys), clock or SimulatedClock()
    return Camera(FILES.open(section, CameraContext(clock, folder)), section, clock)


def test_a_folder_gives_a_picture_for_each_read(tmp_path: Path) -> None:
    """In the order of the numbers, 2 before 10, at any rate; the time is that of the read."""
    write_pictures(tmp_path / "p", 12)
    clock = SimulatedClock()
    camera = _camera(tmp_path, clock)
    frames = []
    for _ in range(12):
        clock.sleep(1.5)
        frames.append(camera.capture())
    assert [number_in(frame.image) for frame in frames] == list(range(12))
    assert [frame.t_s for frame in frames] == [1.5 * (number + 1) for number in range(12)]
    assert frames[0].t_bound_s is None


def test_the_end_of_the_pictures_is_an_error_with_their_count(tmp_path: Path) -> None:
    """The error has their number, their folder and a remedy."""
    write_pictures(tmp_path / "p", 2)
    camera = _camera(tmp_path)
    camera.capture()
    camera.capture()
    with pytest.raises(CameraError, match=r"the 2 pictures of folder .*p have ended") as refusal:
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
        ("pipe:0", "pipe:0 cannot be read"),
        ("concat:a.avi|b.avi", r"b\.avi cannot be read"),
        ("-vf", "-vf cannot be read"),
        ("videotestsrc ! appsink", "appsink cannot be read"),
    ],
)
def test_a_source_without_pictures_is_refused(tmp_path: Path, source: str, words: str) -> None:
    """An empty folder and a missing one are named; what a library might open is a name like any other."""
    (tmp_path / "empty").mkdir()
    with pytest.raises(CameraError, match=words):
        _camera(tmp_path, source=source)


def test_pictures_of_another_size_are_refused(tmp_path: Path) -> None:
    """The size is compared when the source is opened, and for each picture."""
    folder = write_pictures(tmp_path / "p", 1)
    cv2.imwrite(str(folder / "2.png"), np.zeros((10, 10), np.uint8))
    with pytest.raises(CameraError, match="ignored width_px: 80 was asked for, it uses 64"):
        _camera(tmp_path, width_px=80)
    camera = _camera(tmp_path)
    camera.capture()
    with pytest.raises(CameraError, match="expected 64x48"):
        camera.capture()


# The section of the rig file


def _load(folder: Path, *overrides: str) -> RigDescription:
    """Return the simulated rig with recorded pictures in place of its camera, from a file that is written for it."""
    before, rest = SIMULATED.read_text(encoding="utf-8").split("camera:\n", 1)
    after = rest.split("\n\n", 1)[1]
    camera = "camera:\n  driver: files\n  source: p\n  width_px: 1280\n  height_px: 720\n  rate_hz: 30\n\n"
    path = folder / "rig.yaml"
    path.write_text(before + camera + after, encoding="utf-8")
    return load_rig(path, overrides)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("exposure_us=8000", "unknown key exposure_us"),
        ("sorce=p", "unknown key sorce"),
        ("source='http://10.0.0.7/live'", "no pictures over the network; name a folder of pictures"),
        ("latency_s=0.1", "unknown key latency_s"),
    ],
)
def test_an_invalid_section_is_refused(tmp_path: Path, override: str, words: str) -> None:
    """Unknown keys, and sources of another kind."""
    with pytest.raises(FileFormatError, match=words) as refusal:
        _load(tmp_path, f"camera.{override}")
    assert refusal.value.problems[0].where.startswith(("--set camera", "rig.yaml"))
