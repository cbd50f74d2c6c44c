"""A camera over HTTP with times of exposure: which pictures count, and which streams and sections are refused."""

import re
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from threading import Event, Thread

import cv2
import numpy as np
import pytest

from labrig.devices.camera import Camera
from labrig.devices.camera_kind import CameraContext
from labrig.devices.clocks import SystemClock
from labrig.devices.mjpeg.camera import CAMERA as MJPEG
from labrig.devices.mjpeg.parts import Part, PartReader
from labrig.devices.mjpeg.receiver import StampedPictures
from labrig.devices.mjpeg.settings import MjpegCameraDescription
from labrig.devices.rig_file import load_rig
from labrig.devices.stream_source import Dropped, Received, StreamSource
from labrig.errors import CameraError, FileFormatError
from tests.devices.captures import SIZE_PX, Computer, ComputerClock
from tests.devices.rigs import BENCH

REHEARSAL = BENCH.parent / "rig-rehearsal.yaml"
DAY_S = 1_700_000_000.0
LATENCY_S, STAMP_ERROR_S = 0.5, 0.01
_LONG_S = 10.0
_BEGIN = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=picture\r\n\r\n"


def _jpeg(level: int = 100, size_px: tuple[int, int] = SIZE_PX) -> bytes:
    return cv2.imencode(".jpg", np.full(size_px[::-1], level, np.uint8))[1].tobytes()


def _part(*headers: str, data: bytes = b"") -> bytes:
    lines = ("--picture", "Content-Type: image/jpeg", *headers, "", "")
    return "\r\n".join(lines).encode() + data + b"\r\n"


def _stamped(stamp: str, data: bytes) -> bytes:
    return _part(f"Content-Length: {len(data)}", f"X-Timestamp: {stamp}", data=data)


# Which pictures count


class _DayClock(ComputerClock):
    """A clock whose day began at `DAY_S`, when the computer's time stood at 1000 s."""

    def utc(self) -> datetime:
        """Return the calendar time."""
        return datetime.fromtimestamp(DAY_S + self.now_s(), UTC)


class _Parts:
    """Parts that a test gives, each at the computer's time at which it arrives."""

    def __init__(self, computer: Computer, *arriving: tuple[float, Part]) -> None:
        self._computer = computer
        self._arriving = list(arriving)
        self.closed = 0

    def read_part(self) -> Part:
        """Let the time pass until the next part arrives."""
        if not self._arriving:
            raise CameraError("it has ended", "check the sender")
        self._computer.now_s, part = self._arriving.pop(0)
        return part

    def close(self) -> None:
        """Count."""
        self.closed += 1


def _receive(*arriving: tuple[float, float]) -> list[Received | Dropped]:
    """Return what becomes of pictures that arrive at a computer's time with a stamp, counted from the day's begin."""
    computer = Computer()
    parts = _Parts(computer, *((1000 + at_s, Part(DAY_S + stamp_s, _jpeg())) for at_s, stamp_s in arriving))
    pictures = StampedPictures(
        parts,
        "http://h/x",
        _DayClock(computer),
        latency_s=LATENCY_S,
        stamp_error_s=STAMP_ERROR_S,
        monotonic_s=computer,
    )
    return [pictures.receive() for _ in arriving]


def test_a_picture_has_the_time_of_its_stamp() -> None:
    """It is that of the computer's clock, however late the picture arrives within the latency."""
    received = _receive((2.3, 2.1), (2.9, 2.5))
    times_s = [picture.t_s for picture in received if isinstance(picture, Received)]
    assert times_s == pytest.approx([1002.1, 1002.5], abs=1e-5)


@pytest.mark.parametrize(
    ("arriving", "words"),
    [
        ([(2.0, 1.0)], "it was 1.000 s old by its X-Timestamp when it came, latency_s is 0.5 s"),
        ([(2.0, 2.0 - DAY_S)], "it was 1700000000.000 s old by its X-Timestamp"),
        ([(2.0, 2.2)], "its X-Timestamp is 0.200 s after it came, stamp_error_s is 0.01 s"),
        ([(2.0, 1.9), (2.1, 1.9)], "is not later than that of one before, 1700000001.900000"),
        ([(2.0, 1.9), (2.1, 1.8)], "its X-Timestamp 1700000001.800000 is not later"),
    ],
)
def test_a_picture_with_an_impossible_time_is_dropped(
    arriving: list[tuple[float, float]], words: str
) -> None:
    """Old, stamped since the start of a computer, from the future, the same once more, from before."""
    *before, last = _receive(*arriving)
    assert all(isinstance(picture, Received) for picture in before)
    assert isinstance(last, Dropped)
    assert words in last.reason


def test_a_stamp_within_its_error_after_the_arrival_is_taken() -> None:
    """The clock of the sender may be ahead by so much."""
    (picture,) = _receive((2.0, 2.009))
    assert isinstance(picture, Received)


def test_a_picture_that_cannot_be_decoded_is_dropped() -> None:
    """The reason says so, and the next one counts."""
    computer = Computer()
    parts = _Parts(computer, (1001.0, Part(DAY_S + 1, _jpeg()[:-40])), (1002.0, Part(DAY_S + 2, _jpeg())))
    pictures = StampedPictures(
        parts, "h", _DayClock(computer), latency_s=LATENCY_S, stamp_error_s=0.0, monotonic_s=computer
    )
    broken, whole = pictures.receive(), pictures.receive()
    assert isinstance(broken, Dropped)
    assert "truncated" in broken.reason
    assert isinstance(whole, Received)


class _Sender(_Parts):
    """A camera with a picture each 0.1 s, each of which arrives 0.2 s after its exposure; it never ends."""

    def read_part(self) -> Part:
        """Let 0.1 s pass."""
        self._computer.now_s += 0.1
        return Part(DAY_S + self._computer.now_s - 1000.2, _jpeg())


def test_a_picture_is_newer_than_its_command_by_more_than_the_error_of_its_stamp() -> None:
    """Its time is that of its stamp, and the bound of that time is the error of the stamp."""
    computer = Computer()
    clock = _DayClock(computer)
    pictures = StampedPictures(
        _Sender(computer), "h", clock, latency_s=LATENCY_S, stamp_error_s=0.25, monotonic_s=computer
    )
    with closing(StreamSource(pictures, clock, bound_s=0.25, monotonic_s=computer)) as source:
        asked_s = clock.now_s()
        exposure = source.read()
    assert exposure.t_s is not None
    assert exposure.t_s >= asked_s + 0.25
    assert exposure.t_bound_s == 0.25


def test_pictures_that_are_all_dropped_are_an_error_that_says_why() -> None:
    """It has their number, and the reason of the last one."""
    computer = Computer()
    clock = _DayClock(computer)
    pictures = StampedPictures(
        _Sender(computer), "http://h/x", clock, latency_s=0.1, stamp_error_s=0.0, monotonic_s=computer
    )
    source = StreamSource(pictures, clock, bound_s=0.0, timeout_s=0.05, monotonic_s=computer)
    with pytest.raises(
        CameraError, match=r"camera http://h/x: it gave none that can be used within 0\.05 s; .* 0\.200 s old"
    ):
        source.wait_for_first()


class _FallenSilent(_Parts):
    """A camera that gives no more pictures, and does not end, until it is told to."""

    ended = Event()

    def read_part(self) -> Part:
        """Wait where there is no further one."""
        if not self._arriving:
            self.ended.wait(_LONG_S)
        return super().read_part()


def test_a_camera_that_has_recovered_is_not_blamed_for_a_dropped_picture() -> None:
    """If it falls silent later, the error says only that."""
    computer = Computer()
    clock = _DayClock(computer)
    late, timely = Part(DAY_S + 1, _jpeg()), Part(DAY_S + 9, _jpeg())
    parts = _FallenSilent(computer, (1009.0, late), (1009.0, timely))
    pictures = StampedPictures(
        parts, "h", clock, latency_s=LATENCY_S, stamp_error_s=0.0, monotonic_s=computer
    )
    source = StreamSource(pictures, clock, bound_s=0.0, timeout_s=0.05, monotonic_s=computer)
    source.wait_for_first()
    computer.now_s += 1
    with pytest.raises(CameraError, match=r"camera h: it gave no picture within 0\.05 s, after 2"):
        source.read()
    parts.ended.set()
    source.close()
    assert parts.closed == 1


# What a sender may say


@contextmanager
def _serving(answer: bytes, *, hang_up: bool = True) -> Iterator[str]:
    """Serve one client with these bytes; yield the URL."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            client, _ = server.accept()
            with client:
                client.recv(4096)
                client.sendall(answer)
                if not hang_up:
                    client.recv(1)

        thread = Thread(target=serve)
        thread.start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}/live?a=b"
        thread.join(_LONG_S)


def _read_first(url: str, timeout_s: float = _LONG_S) -> Part:
    with closing(PartReader(url, longest_bytes=10_000, timeout_s=timeout_s)) as parts:
        return parts.read_part()


def test_parts_are_read_with_their_times() -> None:
    """Blank lines between them do not matter."""
    pictures = [_jpeg(10), _jpeg(200)]
    answer = b"\r\n".join(_stamped(f"{number}.25", data) for number, data in enumerate(pictures))
    with (
        _serving(_BEGIN + answer) as url,
        closing(PartReader(url, longest_bytes=10_000, timeout_s=_LONG_S)) as parts,
    ):
        assert [parts.read_part() for _ in pictures] == [Part(0.25, pictures[0]), Part(1.25, pictures[1])]
        with pytest.raises(CameraError, match="it has ended"):
            parts.read_part()


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (b"HTTP/1.0 404 Not Found\r\n\r\n", "it answers 404 Not Found"),
        (
            b"HTTP/1.0 200 OK\r\nContent-Type: text/html\r\n\r\n<html>",
            "it sends text/html, expected multipart",
        ),
        (b"SSH-2.0-OpenSSH_9\r\n", "does not answer: SSH-2.0-OpenSSH_9"),
        (b"", "does not answer"),
        (_BEGIN, "it has ended"),
        (_BEGIN + b"--picture--\r\n", "it has ended"),
        (_BEGIN + b"\xff\xd8\xff\xe0", "stands between two pictures, expected b'--picture'"),
        (_BEGIN + b"\r\n" * 100, "stands between two pictures"),
        (_BEGIN + _part("Content-Length: 4", data=b"abcd"), "its pictures have no X-Timestamp"),
        (_BEGIN + _part("Content-Length: 4", "X-Timestamp: soon", data=b"abcd"), "X-Timestamp 'soon'"),
        (_BEGIN + _part("Content-Length: 4", "X-Timestamp: nan", data=b"abcd"), "X-Timestamp 'nan'"),
        (_BEGIN + _part("X-Timestamp: 1", data=b"abcd"), "Content-Length '', expected 1 to 10000 bytes"),
        (_BEGIN + _part("X-Timestamp: 1", "Content-Length: 10001"), "Content-Length '10001'"),
        (_BEGIN + _part("X-Timestamp: 1", "Content-Length: -4"), "Content-Length '-4'"),
        (_BEGIN + _part("X-Timestamp: 1", "Content-Length: " + 5000 * "9"), "Content-Length '999"),
        (_BEGIN + _part("X-Timestamp: 1", "Content-Length: 50", data=b"abcd"), "ended within a picture"),
        (_BEGIN + b"--picture\r\nX-Timestamp: " + b"1" * 70_000, "it broke off: got more than"),
    ],
)
def test_a_sender_that_does_not_keep_to_the_format_is_refused(answer: bytes, words: str) -> None:
    """The error says what it sent; nothing is read without bound."""
    with _serving(answer) as url, pytest.raises(CameraError, match=re.escape(words)) as refusal:
        _read_first(url)
    assert refusal.value.hint


def test_a_silent_sender_is_an_error_after_the_timeout() -> None:
    """It says that the time is over."""
    with _serving(_BEGIN, hang_up=False) as url, pytest.raises(CameraError, match="it broke off: timed out"):
        _read_first(url, timeout_s=0.05)


def test_a_stream_without_times_of_exposure_is_refused_when_it_is_opened() -> None:
    """The hint names the driver that takes it as recorded pictures."""
    data = _jpeg()
    with (
        _serving(_BEGIN + _part(f"Content-Length: {len(data)}", data=data)) as url,
        pytest.raises(CameraError, match=r"camera http://.*: its pictures have no X-Timestamp") as refusal,
    ):
        MJPEG.open(_section(source=url), CameraContext(SystemClock()))
    assert "driver: files" in refusal.value.hint


def test_an_address_where_nobody_listens_is_named() -> None:
    """The error has the URL."""
    with pytest.raises(CameraError, match=r"camera http://127\.0\.0\.1:9/ does not answer"):
        MJPEG.open(_section(source="http://127.0.0.1:9/"), CameraContext(SystemClock()))


def test_pictures_of_another_size_are_refused() -> None:
    """The first picture shows it."""
    data, clock = _jpeg(), SystemClock()
    stamped = _stamped(f"{clock.utc().timestamp():.6f}", data)
    with _serving(_BEGIN + stamped) as url:
        section = _section(source=url, width_px=80)
        with (
            closing(MJPEG.open(section, CameraContext(clock))) as source,
            pytest.raises(CameraError, match="ignored width_px: 80 was asked for, it uses 64"),
        ):
            Camera(source, section, clock)


# The section of the rig file


def _section(**keys: object) -> MjpegCameraDescription:
    values = {
        "source": "http://h/x",
        "width_px": SIZE_PX[0],
        "height_px": SIZE_PX[1],
        "rate_hz": 10.0,
        "stamp_error_s": 0.01,
        **keys,
    }
    return MjpegCameraDescription(driver="mjpeg", **values)  # type: ignore[arg-type]


def test_its_pictures_are_not_recorded_ones() -> None:
    """They may decide how real drives move, and only on a bench."""
    camera = load_rig(REHEARSAL).camera
    assert isinstance(camera, MjpegCameraDescription)
    assert camera.recorded is False
    assert camera.rig_kinds == {"bench"}


def test_a_part_may_have_the_bytes_of_a_picture_without_compression() -> None:
    """Three a pixel, and a header."""
    assert _section().longest_bytes == 3 * 64 * 48 + 65_536


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("source=film.avi", "expected http://HOST:PORT/PATH"),
        ("source='rtsp://h/x'", "expected http://HOST:PORT/PATH"),
        ("source='http:///x'", "expected http://HOST:PORT/PATH"),
        ("source='http://h:port/x'", "Port could not be cast"),
        ("source='http://h:99999/x'", "Port out of range"),
        ("source='http://h/a b'", "spaces"),
        ("source='http://lab:p@ss@h/x'", "no user and no password"),
        ("stamp_error_s=null", "stamp_error_s"),
        ("stamp_error_s=2", "stamp_error_s"),
        ("latency_s=0", "latency_s"),
        ("times=rate", "unknown key times"),
    ],
)
def test_an_invalid_section_is_refused(override: str, words: str) -> None:
    """No other kind of address, no password, and no error that is not stated."""
    with pytest.raises(FileFormatError, match=words) as refusal:
        load_rig(REHEARSAL, [f"camera.{override}"])
    assert "p@ss" not in str(refusal.value)
