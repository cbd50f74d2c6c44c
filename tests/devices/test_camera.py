"""The camera: every setting is made or refused, and every picture has the stated format."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from labrig.devices.camera import CONTROL_NAMES, Camera, CameraContext, Exposure, Picture, Setting
from labrig.devices.clocks import SimulatedClock
from labrig.devices.rig_file import load_rig
from labrig.devices.simulated.camera import SimulatedSource
from labrig.devices.uvc.camera import UvcCameraDescription
from labrig.devices.uvc.v4l2 import CONTROLS, GET_CONTROL, SET_CONTROL
from labrig.errors import CameraError
from labrig.simulation.world import World
from tests.devices.captures import FakeCapture
from tests.devices.rigs import BENCH, large_rig

CAMERA = large_rig().camera


def _world(*ignores: str) -> World:
    world = large_rig().world
    assert world is not None
    return World(world.model_copy(update={"ignores": ignores}), seed=1)


class Lens:
    """A source that takes every setting and gives the pictures that it was given."""

    def __init__(self, *pictures: Picture | None, **tells: Setting | None) -> None:
        self._pictures = list(pictures)
        self._settings: dict[str, Setting] = {}
        self._tells = tells

    def set(self, name: str, value: Setting) -> None:
        """Take it."""
        self._settings[name] = value

    def get(self, name: str) -> Setting | None:
        """Tell it, or something else."""
        return self._tells.get(name, self._settings.get(name))

    def read(self) -> Exposure | None:
        """Give the next."""
        picture = self._pictures.pop(0)
        return None if picture is None else Exposure(picture)

    def close(self) -> None:
        """Nothing is held."""


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("pixel_format", "MJPG"),
        ("width_px", 800),
        ("height_px", 600),
        ("rate_hz", 25.0),
        ("mains_hz", 50),
        ("exposure_us", 100),
        ("gain", 7),
        ("white_balance_k", 3000),
        ("focus", 5),
    ],
)
def test_a_camera_that_ignores_a_setting_is_refused(name: str, asked: Setting) -> None:
    """The error names the setting, the requested value and the value in use."""
    description = CAMERA.model_copy(update={name: asked})
    with pytest.raises(CameraError, match=f"ignored {name}: {asked} was asked for, it uses"):
        Camera(SimulatedSource(_world(name), SimulatedClock()), description, SimulatedClock())


@pytest.mark.parametrize(("told_not", "may_be_null"), [("focus", True), ("width_px", False)])
def test_a_setting_that_cannot_be_read_back_is_refused(told_not: str, may_be_null: bool) -> None:
    """Such a setting cannot be recorded; the hint proposes nothing that the rig file would refuse."""
    description = CAMERA.model_copy(update={"focus": 3})
    with pytest.raises(CameraError, match=f"does not tell its {told_not}") as refusal:
        Camera(Lens(**{told_not: None}), description, SimulatedClock())
    assert ("null" in refusal.value.hint) is may_be_null


@pytest.mark.parametrize(("rate_hz", "taken"), [(30.0003, True), (29.97, True), (25.0, False)])
def test_a_rate_is_a_fraction_of_integers(rate_hz: float, taken: bool) -> None:
    """29.97 Hz counts as 30 Hz; 25 Hz does not."""
    with nullcontext() if taken else pytest.raises(CameraError, match="rate_hz"):
        assert Camera(Lens(rate_hz=rate_hz), CAMERA, SimulatedClock()).settings["rate_hz"] == rate_hz


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (None, "no picture"),
        (np.zeros((480, 640), np.uint8), "expected 1280x720"),
        (np.zeros((720, 1280), np.uint16), "uint16"),
        (np.zeros((720, 1280, 3, 1), np.uint8), "shape"),
    ],
)
def test_a_picture_of_another_format_is_refused(picture: Picture | None, words: str) -> None:
    """No picture, another size and another depth are refused."""
    with pytest.raises(CameraError, match=words):
        Camera(Lens(picture), CAMERA, SimulatedClock()).capture()


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


@pytest.mark.parametrize("name", CONTROL_NAMES)
def test_a_camera_that_lacks_a_control_is_usable_once_its_key_is_null(name: str) -> None:
    """Without the control it is refused; what the hint says to write makes it a camera that gives pictures."""
    with pytest.raises(CameraError, match=f"does not tell its {name}") as refusal:
        _open_lacking(name, *_ALL_CONTROLS)
    assert f"write camera.{name}: null" in refusal.value.hint
    camera = _open_lacking(name, *_ALL_CONTROLS, f"camera.{name}=null")
    assert camera.capture().image.shape == (48, 64)
    assert set(CONTROL_NAMES) - set(camera.settings) == {name}


_SMALL = ("camera.width_px=64", "camera.height_px=48", "camera.pixel_format=GREY")
_ALL_CONTROLS = (*_SMALL, "camera.focus=3")


def _open_lacking(name: str, *overrides: str) -> Camera:
    """Return an opened USB camera that has every control but one."""
    section, capture = load_rig(BENCH, overrides).camera, FakeCapture(rate_hz=30.0)
    assert isinstance(section, UvcCameraDescription)
    return Camera(capture.open(section, lacks=name), section, capture.clock)


def test_request_codes_are_those_of_the_kernel() -> None:
    """VIDIOC_G_CTRL, VIDIOC_S_CTRL and VIDIOC_QUERYCAP, and ids of linux/v4l2-controls.h."""
    assert (GET_CONTROL, SET_CONTROL) == (0xC008561B, 0xC008561C)
    assert {name: control.identifier for name, control in CONTROLS.items()} == {
        "exposure_us": 0x009A0902,
        "gain": 0x00980913,
        "white_balance_k": 0x0098091A,
        "focus": 0x009A090A,
        "mains_hz": 0x00980918,
    }
