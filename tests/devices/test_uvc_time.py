"""The time of a picture of a USB camera: the kernel's if it can be trusted, else that of the call, with a bound."""

import pytest

from labrig.devices.camera import Camera, Frame
from labrig.errors import CameraError
from tests.devices.captures import BEGAN_S, FakeCapture, uvc_section

PERIOD_S = 1 / 24


def _open(**kinds: object) -> tuple[Camera, FakeCapture]:
    capture = FakeCapture(**kinds)  # type: ignore[arg-type]
    return Camera(capture.open(), uvc_section(), capture.clock), capture


def test_a_picture_has_the_time_of_its_buffer() -> None:
    """The kernel's time stamp, in rig time, known to a period."""
    camera, capture = _open()
    capture.clock.sleep(3.01)
    frame = camera.capture()
    assert frame.t_s == pytest.approx(capture.exposed_s - BEGAN_S, abs=1e-6)
    assert frame.t_bound_s == pytest.approx(PERIOD_S)


def test_queued_pictures_are_dropped() -> None:
    """After a pause four old pictures wait; the returned one was exposed after the call."""
    camera, capture = _open()
    camera.capture()
    capture.clock.sleep(10.0)
    asked_s = capture.monotonic_s()
    camera.capture()
    assert capture.exposed_s - 0.005 >= asked_s
    assert capture.monotonic_s() - asked_s <= PERIOD_S + 0.005 + 1e-5


@pytest.mark.parametrize("kind", [{"stamp_offset_s": 1.7e9}, {"stamp_offset_s": -900.0}, {"stamps": False}])
def test_stamps_of_another_clock_are_not_used(kind: dict[str, object]) -> None:
    """Without a usable stamp the time is the middle of the call, bounded by half its duration."""
    camera, capture = _open(**kind)
    capture.clock.sleep(3.0)
    asked_s = capture.monotonic_s()
    frame = camera.capture()
    assert frame.t_bound_s == pytest.approx(0.5 * (capture.monotonic_s() - asked_s))
    assert abs(frame.t_s - (capture.exposed_s - BEGAN_S)) <= (frame.t_bound_s or 0.0) + 1e-5


@pytest.mark.parametrize(
    ("queued", "into_period", "older_s"),
    [(100, 0.52, "2.818"), (5, 0.95, "0.003")],
)
def test_a_picture_that_began_before_its_command_is_refused(
    queued: int, into_period: float, older_s: str
) -> None:
    """If the queue is longer than any driver's, nothing old passes: not by seconds, nor by part of an exposure."""
    camera, capture = _open(queue_length=queued)
    capture.clock.sleep((72 + into_period) * PERIOD_S)
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
    frame = Frame(FakeCapture().retrieve()[1], t_s, t_bound_s)
    assert frame.place_between(1.0, 2.0) == (placed if t_bound_s is None else pytest.approx(placed))
