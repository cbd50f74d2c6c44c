"""The time of a picture of a USB camera: the kernel's if it can be trusted, else that of the call, with a bound."""

import pytest

from labrig.devices.camera import Camera, Frame
from labrig.devices.uvc.camera import UvcSource
from labrig.errors import CameraError
from tests.devices.captures import Computer, ComputerClock, FakeCapture, FakeControls, uvc_section

SECTION = uvc_section()
PERIOD_S = 1 / 24


def _open(**kinds: object) -> tuple[Camera, FakeCapture, UvcSource]:
    computer = Computer()
    capture = FakeCapture(computer, **kinds)  # type: ignore[arg-type]
    source = UvcSource(
        capture, FakeControls(), ComputerClock(computer), exposure_s=0.005, rate_hz=24.0, monotonic_s=computer
    )
    return Camera(source, SECTION, ComputerClock(computer)), capture, source


def test_a_picture_has_the_time_of_its_buffer() -> None:
    """The kernel's time stamp, in rig time, known to a period."""
    camera, capture, _ = _open()
    capture.computer.now_s += 3.01
    frame = camera.capture()
    assert frame.t_s == pytest.approx(capture.exposed_s - 1000.0, abs=1e-6)
    assert frame.t_bound_s == pytest.approx(PERIOD_S)


def test_queued_pictures_are_dropped() -> None:
    """After a pause four old pictures wait; the returned one was exposed after the call."""
    camera, capture, _ = _open()
    camera.capture()
    capture.computer.now_s += 10.0
    asked_s = capture.computer.now_s
    camera.capture()
    assert capture.exposed_s - 0.005 >= asked_s
    assert capture.computer.now_s - asked_s <= PERIOD_S + 0.005


@pytest.mark.parametrize("kind", [{"stamp_offset_s": 1.7e9}, {"stamp_offset_s": -900.0}, {"stamps": False}])
def test_stamps_of_another_clock_are_not_used(kind: dict[str, object]) -> None:
    """Without a usable stamp the time is the middle of the call, bounded by half its duration."""
    camera, capture, _ = _open(**kind)
    capture.computer.now_s += 3.0
    asked_s = capture.computer.now_s
    frame = camera.capture()
    assert frame.t_bound_s is not None
    assert frame.t_bound_s == pytest.approx(0.5 * (capture.computer.now_s - asked_s))
    assert abs(frame.t_s - (capture.exposed_s - 1000.0)) <= frame.t_bound_s + 1e-6


@pytest.mark.parametrize(
    ("queued", "into_period", "older_s"),
    [(100, 0.5, "2.818"), (5, 0.95, "0.003")],
)
def test_a_picture_that_began_before_its_command_is_refused(
    queued: int, into_period: float, older_s: str
) -> None:
    """If the queue is longer than any driver's, nothing old passes: not by seconds, nor by part of an exposure."""
    camera, capture, _ = _open(queue_length=queued)
    capture.computer.now_s += (72 + into_period) * PERIOD_S
    with pytest.raises(
        CameraError, match=rf"gave 6 pictures, each older .* began {older_s} s before it"
    ) as refusal:
        camera.capture()
    assert "plug it in again" in refusal.value.hint


@pytest.mark.parametrize(
    ("t_s", "t_bound_s", "placed"),
    [
        (1.25, 0.04, (0.25, 0.04)),
        (0.9, 0.04, (0.0, 0.14)),
        (2.1, 0.04, (1.0, 0.14)),
        (1.25, None, (None, None)),
    ],
)
def test_a_frame_lies_between_two_readings(
    t_s: float, t_bound_s: float | None, placed: tuple[float | None, float | None]
) -> None:
    """It is placed by its own time; a time outside them widens its bound, that of a call has none."""
    frame = Frame(FakeCapture(Computer()).retrieve()[1], t_s, t_bound_s)
    assert frame.place_between(1.0, 2.0) == (placed if t_bound_s is None else pytest.approx(placed))
