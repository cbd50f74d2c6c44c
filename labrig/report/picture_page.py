"""A page for a browser on this computer: a picture with what is drawn over it, and a pixel that is picked in it.

The page is the files of `browser`. All that labrig says comes to it as JSON and enters it as text. The address holds a
token that other accounts of the computer do not know. Pages from elsewhere cannot reach it: the `Host` header has to
name this computer (against DNS rebinding), only JSON is taken, which no other origin may send, and nothing may be kept
or framed.
"""

import json
import secrets
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import cv2
import numpy as np

from labrig.input_file import parse_json
from labrig.report.web_page import LOCALHOST
from labrig.vision.camera_frame import UNKNOWN_CAMERA, CameraInUse, encode_frame
from labrig.vision.drawing import Landmark
from labrig.vision.picture import Picture, size_of
from labrig.vision.picture_quality import Score

_FOLDER = Path(__file__).parent
_FILES = {
    "": (_FOLDER / "browser" / "picture.html", "text/html; charset=utf-8"),
    "icon.svg": (_FOLDER / "browser" / "icon.svg", "image/svg+xml"),
    "picture.js": (_FOLDER / "browser" / "picture.js", "text/javascript; charset=utf-8"),
    "picture.css": (_FOLDER / "browser" / "picture.css", "text/css; charset=utf-8"),
    "style.css": (_FOLDER / "templates" / "style.css", "text/css; charset=utf-8"),
}
_QUALITY = (cv2.IMWRITE_JPEG_QUALITY, 92)
_POLICY = (
    "default-src 'none'; img-src 'self'; style-src 'self'; script-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": _POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_TEXT, _JSON = "text/plain; charset=utf-8", "application/json"
_TIMEOUT_S = 2.0
_MOST_SENT_BYTES = 1000

Pixel = tuple[int, int]
Reply = tuple[int, str, bytes]
"""Status of HTTP, type and content."""


@dataclass(frozen=True)
class Verdict:
    """Whether a picked pixel is the answer, and what the person is told."""

    taken: bool
    text: str


NO_PICTURE: Picture = np.zeros((1, 1), np.uint8)
"""Stands for one that is still to come."""


@dataclass(frozen=True, eq=False)
class ShownPicture:
    """What the page shows.

    Attributes
    ----------
    number : int
        Number of the picture.
    image : ndarray of uint8, (H, W) or (H, W, 3)
    heading : str
    scores : sequence of Score
    landmarks : sequence of Landmark
        What was found in it, or in one shortly before.
    camera : CameraInUse
        Its camera, kept in a saved test frame.
    """

    number: int
    image: Picture
    heading: str
    scores: Sequence[Score] = ()
    landmarks: Sequence[Landmark] = ()
    camera: CameraInUse = UNKNOWN_CAMERA

    def document(self, *, asks: bool) -> dict[str, Any]:
        """Return all but the picture, ready for JSON."""
        width, height = size_of(self.image)
        return {
            "number": self.number,
            "width": width,
            "height": height,
            "heading": self.heading,
            "scores": [asdict(score) for score in self.scores],
            "landmarks": [asdict(mark) for mark in self.landmarks],
            "asks": asks,
        }


class PicturePage:
    """The page, served on 127.0.0.1 from now on, in threads of this process.

    Parameters
    ----------
    take : callable or None
        Takes a pixel that a person has confirmed, in a thread of the server; None where no pixel is asked for.
    """

    def __init__(self, take: Callable[[Pixel], Verdict] | None = None) -> None:
        self._take = take
        self._shown: ShownPicture | None = None
        self._server = _Server(self._answer)
        self.port = int(self._server.server_address[1])
        self.url = f"http://{LOCALHOST}:{self.port}/{self._server.token}/"
        self._thread = Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    def show(self, picture: ShownPicture) -> None:
        """Show this from now on."""
        self._shown = picture

    def close(self) -> None:
        """Stop listening, once everybody who has asked or sent something has a reply."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _answer(self, name: str, sent: bytes | None) -> Reply | None:
        """Return the reply to a request for a name below the token; None if there is no such."""
        shown = self._shown
        if sent is not None:
            return self._judge(sent, shown) if name == "answer" and shown is not None else None
        if name == "state.json":
            state = {"number": -1} if shown is None else shown.document(asks=self._take is not None)
            return 200, _JSON, json.dumps(state).encode()
        if shown is not None and name == "picture":
            return 200, "image/jpeg", cv2.imencode(".jpg", shown.image, _QUALITY)[1].tobytes()
        if shown is not None and name == "picture.png":
            return 200, "image/png", encode_frame(shown.image, shown.camera)
        if name in _FILES:
            file, kind = _FILES[name]
            return 200, kind, file.read_bytes()
        return None

    def _judge(self, sent: bytes, shown: ShownPicture) -> Reply | None:
        """Pass a pixel on; one that is none, or outside the picture, is told so."""
        if self._take is None:
            return None
        pixel = _read_pixel(sent)
        width, height = size_of(shown.image)
        if pixel is None or not (0 <= pixel[0] < width and 0 <= pixel[1] < height):
            return _say(400, f"That is no pixel of the picture, which has {width} x {height}.")
        verdict = self._take(pixel)
        return _say(200 if verdict.taken else 409, verdict.text)


def _say(status: int, text: str) -> Reply:
    return status, _TEXT, text.encode()


def _read_pixel(sent: bytes) -> Pixel | None:
    """Return the pixel of a document {u, v} of whole numbers; None for anything else."""
    try:
        document = parse_json(sent)
    except ValueError:
        return None
    if not isinstance(document, dict):
        return None
    u, v = document.get("u"), document.get("v")
    return (u, v) if type(u) is int and type(v) is int else None


class _Server(ThreadingHTTPServer):
    daemon_threads = (
        False  # closing waits for them: a thread that is inside OpenCV when Python ends aborts it
    )

    def __init__(self, answer: Callable[[str, bytes | None], Reply | None]) -> None:
        self.token = secrets.token_urlsafe(16)
        self.answer = answer
        super().__init__((LOCALHOST, 0), _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a browser that has gone; whatever else fails is a bug."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = _TIMEOUT_S

    def do_GET(self) -> None:
        """Answer with a page or a part of it."""
        self._reply(self._refuse() or self._answer(None))

    def do_POST(self) -> None:
        """Answer to a document that was sent."""
        self._reply(self._refuse() or self._refuse_sender() or self._answer(self._read_sent()))

    def _refuse(self) -> Reply | None:
        """Return why a request is not answered: it names another computer, or does not know the token."""
        own = {f"{name}:{self.server.server_address[1]}" for name in (LOCALHOST, "localhost")}
        if self.headers.get("Host", "") not in own:
            return _say(421, "this server answers to its own address only")
        given = self.path.split("/")[1] if self.path.startswith("/") else ""
        if not secrets.compare_digest(given.encode("utf-8", "replace"), self.server.token.encode()):
            return _say(404, "there is no such page")
        return None

    def _refuse_sender(self) -> Reply | None:
        """Return why a document is not taken: it comes from another page, is no JSON, or is long."""
        origin, length = self.headers.get("Origin"), self.headers.get("Content-Length", "")
        if origin not in {None, f"http://{self.headers.get('Host')}"}:
            return _say(403, "another page may send nothing here")
        if self.headers.get("Content-Type") != _JSON:
            return _say(415, "only JSON is taken")
        if not (length.isascii() and length.isdecimal() and int(length) <= _MOST_SENT_BYTES):
            return _say(413, "too long")
        return None

    def _read_sent(self) -> bytes:
        return self.rfile.read(int(self.headers["Content-Length"]))

    def _answer(self, sent: bytes | None) -> Reply:
        name = self.path.split("?")[0].partition(f"/{self.server.token}/")[2]
        return self.server.answer(name, sent) or _say(404, "there is no such page")

    def _reply(self, reply: Reply) -> None:
        status, kind, content = reply
        self.send_response(status)
        for name, value in {**_HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def version_string(self) -> str:
        """Return what the server calls itself."""
        return "labrig"

    def log_message(self, *_words: Any) -> None:
        """Write nothing on standard error."""
