"""Cameras: settings are made or refused, pictures have the stated format and a time that can be trusted."""

from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest

from labrig.devices.camera import CONTROL_NAMES, Camera, CameraContext, Frame, Setting
from labrig.devices.clocks import SimulatedClock
from labrig.devices.rig_file import load_rig
from labrig.devices.simulated.camera import SimulatedSource
from labrig.devices.uvc.v4l2 import GET_CONTROL, SET_CONTROL
from labrig.errors import CameraError
from labrig.simulation.world import World
from tests.devices.captures import (
    BEGAN_S,
    FakeCapture,
    draw_numbered_picture,
    files_section,
    number_in,
    write_pictures,
)
from tests.devices.rigs import BENCH, large_rig

RIG = large_rig()
CAMERA = RIG.camera


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("pixel_format", "MJPG"), ("width_px", 800), ("height_px", 600), ("rate_hz", 25.0), ("mains_hz", 50),
        ("exposure_us", 100), ("gain", 7), ("white_balance_k", 3000), ("focus", 5),
    ],
)  # fmt: skip
def test_a_camera_that_ignores_a_setting_is_refused(name: str, asked: Setting) -> None:
    """The error names the setting, the requested value and the value in use."""
    assert RIG.world is not None
    source = SimulatedSource(World(RIG.world.model_copy(update={"ignores": (name,)}), 1), SimulatedClock())
    with pytest.raises(CameraError, match=f"ignored {name}: {asked} was asked for, it uses"):
        Camera(source, CAMERA.model_copy(update={name: asked}), SimulatedClock())


@pytest.mark.parametrize("name", CONTROL_NAMES)
def test_a_camera_that_lacks_a_control_is_usable_once_its_key_is_null(name: str) -> None:
    """Without the control it is refused; what the hint says to write makes it a camera that gives pictures."""
    capture, controls = FakeCapture(tells={name: None}), {"gain": 3, "white_balance_k": 4000, "focus": 3}
    with pytest.raises(CameraError, match=f"does not tell its {name}") as refusal:
        capture.open(**controls)
    assert f"write camera.{name}: null" in refusal.value.hint
    camera = capture.open(**controls | {name: None})
    assert camera.capture().image.shape == (48, 64)
    assert set(CONTROL_NAMES) - set(camera.settings) == {name}


def test_a_size_that_cannot_be_read_back_is_refused() -> None:
    """It cannot be recorded; the hint proposes nothing that the rig file would refuse."""
    with pytest.raises(CameraError, match="does not tell its width_px") as refusal:
        FakeCapture(tells={cv2.CAP_PROP_FRAME_WIDTH: 0.0}).open()
    assert "null" not in refusal.value.hint


@pytest.mark.parametrize(("rate_hz", "taken"), [(30.0003, True), (29.97, True), (25.0, False)])
def test_a_rate_is_a_fraction_of_integers(rate_hz: float, taken: bool) -> None:
    """29.97 Hz counts as 30 Hz; 25 Hz does not."""
    capture = FakeCapture(tells={cv2.CAP_PROP_FPS: rate_hz})
    with nullcontext() if taken else pytest.raises(CameraError, match="rate_hz"):
        assert capture.open(rate_hz=30.0).settings["rate_hz"] == rate_hz


@pytest.mark.parametrize(
    ("shape", "words"), [((0, 0), "no picture"), ((64, 48), "expected 64x48"), ((48, 64, 3, 1), "shape")]
)
def test_a_picture_of_another_format_is_refused(shape: tuple[int, ...], words: str) -> None:
    """No picture, another size and another shape are refused."""
    with pytest.raises(CameraError, match=words):
        FakeCapture(shows=np.zeros(shape, np.uint8)).open().capture()


def test_what_is_no_camera_is_refused(tmp_path: Path) -> None:
    """A missing device file is named with how to find the right one; so is a file that is no device."""
    (tmp_path / "video0").touch()
    for device, words in (
        ("/dev/video-missing", "cannot be opened: No such file"),
        (tmp_path / "video0", "gives no pictures"),
    ):
        with pytest.raises(CameraError, match=f"{device} {words}") as refusal:
            load_rig(BENCH, [f"camera.device={device}"]).camera.open(CameraContext(SimulatedClock()))
        assert "/dev/video*" in refusal.value.hint


def test_request_codes_are_those_of_the_kernel() -> None:
    """VIDIOC_G_CTRL and VIDIOC_S_CTRL."""
    assert (GET_CONTROL, SET_CONTROL) == (0xC008561B, 0xC008561C)


PERIOD_S = 1 / 24


def test_a_picture_has_the_time_of_its_buffer_and_queued_ones_are_dropped() -> None:
    """The kernel's time stamp, in rig time, known to a period; after a pause, one that was exposed after the call."""
    camera = (capture := FakeCapture()).open()
    for pause_s in (3.01, 10.0):
        capture.clock.sleep(pause_s)
        asked_s = capture.monotonic_s()
        frame = camera.capture()
        assert frame.t_s == pytest.approx(capture.exposed_s - BEGAN_S, abs=1e-6)
        assert frame.t_bound_s == pytest.approx(PERIOD_S)
        assert capture.exposed_s - 0.005 >= asked_s
        assert capture.monotonic_s() - asked_s <= PERIOD_S + 0.005 + 1e-5


@pytest.mark.parametrize(("stamps", "offset_s"), [(True, 1.7e9), (True, -900.0), (False, 0.0)])
def test_stamps_of_another_clock_are_not_used(*, stamps: bool, offset_s: float) -> None:
    """Without a usable stamp the time is the middle of the call, bounded by half its duration."""
    camera = (capture := FakeCapture(stamps=stamps, stamp_offset_s=offset_s)).open()
    capture.clock.sleep(3.0)
    asked_s = capture.monotonic_s()
    frame = camera.capture()
    assert frame.t_bound_s == pytest.approx(0.5 * (capture.monotonic_s() - asked_s))
    assert abs(frame.t_s - (capture.exposed_s - BEGAN_S)) <= (frame.t_bound_s or 0.0) + 1e-5


@pytest.mark.parametrize(("queued", "into_period", "older_s"), [(100, 0.52, "2.818"), (5, 0.95, "0.003")])
def test_a_picture_that_began_before_its_command_is_refused(
    queued: int, into_period: float, older_s: str
) -> None:
    """If the queue is longer than any driver's, nothing old passes: not by seconds, nor by part of an exposure."""
    camera = (capture := FakeCapture(queue_length=queued)).open()
    capture.clock.sleep((72 + into_period) * PERIOD_S)
    words = f"gave 6 pictures, each older .* began {older_s} s before it"
    with pytest.raises(CameraError, match=words) as refusal:
        camera.capture()
    assert "plug it in again" in refusal.value.hint


@pytest.mark.parametrize(
    ("t_s", "t_bound_s", "placed"),
    [
        (1.25, 0.04, (0.25, 0.04)), (0.9, 0.04, (0.0, 0.14)), (2.1, 0.04, (1.0, 0.14)),
        (1.25, None, (None, None)),
    ],
)  # fmt: skip
def test_a_frame_lies_between_two_readings(
    t_s: float, t_bound_s: float | None, placed: tuple[float | None, float | None]
) -> None:
    """It is placed by its own time; a time outside them widens its bound, that of a call has none."""
    frame = Frame(draw_numbered_picture(0), t_s, t_bound_s)
    assert frame.place_between(1.0, 2.0) == (placed if t_bound_s is None else pytest.approx(placed))


def test_a_folder_gives_a_picture_for_each_read_and_ends_with_an_error(tmp_path: Path) -> None:
    """In the order of the numbers, 2 before 10, at the time of the read; the error has number, folder and remedy."""
    write_pictures(tmp_path / "p", 12)
    clock = SimulatedClock()
    camera = Camera(files_section("p").open(CameraContext(clock, tmp_path)), files_section("p"), clock)
    for number in range(12):
        clock.sleep(1.5)
        frame = camera.capture()
        assert (number_in(frame.image), frame.t_s, frame.t_bound_s) == (number, 1.5 * (number + 1), None)
    with pytest.raises(CameraError, match=r"the 12 pictures of folder .*p have ended") as refusal:
        camera.capture()
    assert "labrig check" in refusal.value.hint


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("empty", "holds no picture"), ("none", "none cannot be read"),
        ("linked", r"2\.png is not a regular file"), ("concat:a.avi|b.avi", r"b\.avi cannot be read"),
        ("http://10.0.0.7/live", "live cannot be read"),
    ],
)  # fmt: skip
def test_a_source_without_pictures_is_refused(tmp_path: Path, source: str, words: str) -> None:
    """A link out of the folder is no picture of it; what a library might open is a name like any other."""
    (tmp_path / "empty").mkdir()
    cv2.imwrite(str(tmp_path / "outside.png"), draw_numbered_picture(0))
    (write_pictures(tmp_path / "linked", 1) / "2.png").symlink_to(tmp_path / "outside.png")
    with pytest.raises(CameraError, match=words):
        files_section(source).open(CameraContext(SimulatedClock(), tmp_path))
