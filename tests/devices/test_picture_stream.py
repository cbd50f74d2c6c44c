"""Pictures over HTTP: what a client receives, and what it cannot do to the others."""

import http.client
import socket
from collections.abc import Iterator
from email.message import Message
from threading import Event, Thread

import cv2
import numpy as np
import pytest

from labrig.devices.camera import Camera
from labrig.devices.camera_kind import CameraContext
from labrig.devices.clocks import SystemClock
from labrig.devices.mjpeg.camera import CAMERA as MJPEG
from labrig.devices.mjpeg.settings import MjpegCameraDescription
from labrig.devices.simulated.picture_stream import PictureStream
from labrig.errors import CameraError
from tests.devices.captures import SIZE_PX
from tests.rehearsing import free_port

_LONG_S = 10.0


@pytest.fixture(name="stream")
def _stream() -> Iterator[PictureStream]:
    stream = PictureStream(free_port())
    yield stream
    stream.close()


def _port(stream: PictureStream) -> int:
    return int(stream.url.rstrip("/").rpartition(":")[2])


def _connect(stream: PictureStream) -> http.client.HTTPResponse:
    """Return a client's answer, once the stream counts it."""
    connection = http.client.HTTPConnection("127.0.0.1", _port(stream), timeout=_LONG_S)
    connection.request("GET", "/")
    return connection.getresponse()


def _grey(level: int) -> np.ndarray:
    return np.full(SIZE_PX[::-1], level, np.uint8)


def _read_part(answer: http.client.HTTPResponse) -> tuple[Message, np.ndarray]:
    assert answer.readline() == b"--picture\r\n"
    header = http.client.parse_headers(answer)
    data = answer.read(int(header["Content-Length"]))
    assert answer.readline() == b"\r\n"
    return header, cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


def test_a_part_has_the_picture_and_its_time_of_exposure(stream: PictureStream) -> None:
    """Its headers are the type, the length and the seconds since 1970."""
    answer = _connect(stream)
    assert answer.headers["Content-Type"] == "multipart/x-mixed-replace; boundary=picture"
    stream.show(_grey(100), 1_700_000_000.25)
    header, picture = _read_part(answer)
    assert (header["Content-Type"], header["X-Timestamp"]) == ("image/jpeg", "1700000000.250000")
    assert np.abs(picture.astype(int) - 100).max() <= 1


def test_a_client_receives_no_picture_from_before_it_came(stream: PictureStream) -> None:
    """The first part is the first picture after its request."""
    stream.show(_grey(10), 0.0)
    answer = _connect(stream)
    stream.show(_grey(200), 1.0)
    assert _read_part(answer)[0]["X-Timestamp"] == "1.000000"


def test_a_client_that_never_reads_delays_nobody(stream: PictureStream) -> None:
    """Far more is shown than its connection holds, and another client receives the newest picture."""
    with socket.create_connection(("127.0.0.1", _port(stream))) as deaf:
        deaf.sendall(b"GET / HTTP/1.0\r\n\r\n")
        deaf.recv(1)
        noise = np.random.default_rng(0).integers(0, 256, (720, 1280)).astype(np.uint8)
        for number in range(20):
            stream.show(noise, float(number))
        answer = _connect(stream)
        stream.show(_grey(1), 100.0)
        assert _read_part(answer)[0]["X-Timestamp"] == "100.000000"


def test_a_ninth_client_is_refused(stream: PictureStream) -> None:
    """It gets an answer that says so."""
    clients = [_connect(stream) for _ in range(8)]
    assert {client.status for client in clients} == {200}
    assert _connect(stream).status == 503


def test_the_end_of_the_stream_ends_its_clients() -> None:
    """A client reads the end, and the port is free again."""
    stream = PictureStream(free_port())
    answer = _connect(stream)
    stream.close()
    assert answer.read() == b""
    PictureStream(_port(stream)).close()


def test_a_port_in_use_is_named(stream: PictureStream) -> None:
    """The error says which port, what may use it and where another one is written."""
    with pytest.raises(CameraError, match=r"port \d+ of 127\.0\.0\.1 cannot be used") as refusal:
        PictureStream(_port(stream))
    assert "camera.source" in refusal.value.hint


def test_the_camera_of_a_rig_file_takes_the_pictures(stream: PictureStream) -> None:
    """The driver `mjpeg` opens the stream, and a picture that is shown after its command arrives, at its own time."""
    section = MjpegCameraDescription(
        driver="mjpeg",
        source=stream.url,
        width_px=SIZE_PX[0],
        height_px=SIZE_PX[1],
        rate_hz=10.0,
        stamp_error_s=0.0,
    )
    over, clock = Event(), SystemClock()

    def show_until_over() -> None:
        while not over.wait(0.02):
            stream.show(_grey(100), clock.utc().timestamp())

    shower = Thread(target=show_until_over)
    shower.start()
    try:
        source = MJPEG.open(section, CameraContext(clock))
        asked_s = clock.now_s()
        frame = Camera(source, section, clock).capture()
        source.close()
    finally:
        over.set()
        shower.join()
    assert asked_s <= frame.t_s <= clock.now_s()
    assert frame.image.shape == SIZE_PX[::-1]
    assert np.abs(frame.image.astype(int) - 100).max() <= 1
