"""Pictures as a stream: JPEG parts of multipart/x-mixed-replace over HTTP, on this computer alone.

Network cameras send such streams and browsers show them. Each part has its length and, as mjpg-streamer sends it,
`X-Timestamp`: the time of exposure in seconds since 1970. Each client gets the newest picture whenever it has taken the
one before, so that a slow client misses pictures and delays nobody.
"""

import sys
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Condition, Thread

import cv2

from labrig.devices.camera import Picture
from labrig.devices.simulated.local_ports import LOCAL_HOST
from labrig.errors import CameraError

_BOUNDARY = "picture"
_JPEG_QUALITY = 95
_MOST_CLIENTS = 8
_LOOK_S = 0.05
"""Time after which closing is noticed."""

_CLIENT_TIMEOUT_S = 5.0
"""A client that takes nothing for so long is dropped."""


@dataclass(frozen=True)
class _Part:
    """A picture as it is sent."""

    number: int
    data: bytes


class PictureStream:
    """Serves pictures until it is closed.

    Parameters
    ----------
    port : int
        TCP port to listen on.

    Raises
    ------
    CameraError
        When the port is in use or may not be used.
    """

    def __init__(self, port: int) -> None:
        self.url = f"http://{LOCAL_HOST}:{port}/"
        self._changed = Condition()
        self._part = _Part(0, b"")
        self._clients = 0
        self._is_over = False
        try:
            self._server = _Server((LOCAL_HOST, port), self)
        except OSError as error:
            raise CameraError(
                f"port {port} of {LOCAL_HOST} cannot be used for the camera: {error.strerror}",
                "end the program that uses it, perhaps another labrig devices simulate; or write another port in "
                "camera.source",
            ) from error
        self._thread = Thread(
            target=self._server.serve_forever, args=(_LOOK_S,), name="labrig pictures", daemon=True
        )
        self._thread.start()

    @property
    def has_clients(self) -> bool:
        """Whether a program takes the pictures now."""
        return self._clients > 0

    def show(self, picture: Picture, exposed_utc_s: float) -> None:
        """Send a picture (H, W) or (H, W, 3), exposed at a time [s since 1970], to every client."""
        jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
        header = (
            f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n"
            f"X-Timestamp: {exposed_utc_s:.6f}\r\n\r\n"
        )
        with self._changed:
            self._part = _Part(self._part.number + 1, header.encode() + jpeg + b"\r\n")
            self._changed.notify_all()

    def enter(self) -> bool:
        """Count a new client; return False if there are too many."""
        with self._changed:
            if self._clients >= _MOST_CLIENTS:
                return False
            self._clients += 1
            return True

    def leave(self) -> None:
        """Count a client that has gone."""
        with self._changed:
            self._clients -= 1

    def wait_for_part(self, after: int) -> _Part | None:
        """Return the newest picture once there is one after a number; None when the stream is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_over or self._part.number > after)
            return None if self._is_over else self._part

    @property
    def last_number(self) -> int:
        """Number of the picture that was shown last."""
        return self._part.number

    def close(self) -> None:
        """End the stream and free the port."""
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, address: tuple[str, int], stream: PictureStream) -> None:
        self.stream = stream
        super().__init__(address, _Handler)

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore a client that has gone or takes nothing; show a traceback of any other failure."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _Handler(BaseHTTPRequestHandler):
    timeout = _CLIENT_TIMEOUT_S
    server: _Server

    def do_GET(self) -> None:
        """Send pictures until the client goes or the stream ends."""
        stream = self.server.stream
        if not stream.enter():
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, "too many clients")
            return
        number = stream.last_number  # its picture was exposed before the client asked; a later one is sent
        try:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            while (part := stream.wait_for_part(number)) is not None:
                self.wfile.write(part.data)
                number = part.number
        finally:
            stream.leave()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the signature of the standard library
        """Print nothing."""
