"""A page for a browser on this computer: a picture with what is drawn over it, and a pixel that is picked in it.

The page is the files of `browser`. All that labrig says comes to it as JSON and enters it as text. The address holds a
token that other accounts of the computer and pages from elsewhere do not know; the `Host` header has to name this
computer (against DNS rebinding), and nothing may be kept or framed.
"""

import json
import re
import secrets
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from labrig.report.local_server import LOCALHOST, LocalServer, Reply, say
from labrig.vision.calibration_file import UNKNOWN_CAMERA, CameraInUse, encode_frame
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
_PIXEL = re.compile(r"u=(\d{1,6})&v=(\d{1,6})", re.ASCII)

Pixel = tuple[int, int]


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
    camera : CameraInUse
        Its camera, kept in a saved test frame.
    """

    number: int
    image: Picture
    heading: str
    scores: Sequence[Score] = ()
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
        self._token = secrets.token_urlsafe(16)
        self._server = LocalServer(self._answer, _HEADERS)
        self.port = self._server.port
        self.url = f"http://{LOCALHOST}:{self.port}/{self._token}/"

    def show(self, picture: ShownPicture) -> None:
        """Show this from now on."""
        self._shown = picture

    def close(self) -> None:
        """Stop listening, once everybody who has asked or sent something has a reply."""
        self._server.close()

    def _answer(self, request: str) -> Reply:
        begin = f"/{self._token}/"
        given = request[: len(begin)].encode("utf-8", "replace")
        found = self._find(request[len(begin) :]) if secrets.compare_digest(given, begin.encode()) else None
        return found or say(404, "there is no such page")

    def _find(self, request: str) -> Reply | None:
        """Return the reply to a request for a name below the token; None if there is no such."""
        name, _, query = request.partition("?")
        shown = self._shown
        match name:
            case "state.json":
                state = {"number": -1} if shown is None else shown.document(asks=self._take is not None)
                return 200, "application/json", json.dumps(state).encode()
            case "answer" if shown is not None and self._take is not None:
                return _judge(query, shown, self._take)
            case "picture" if shown is not None:
                return 200, "image/jpeg", cv2.imencode(".jpg", shown.image, _QUALITY)[1].tobytes()
            case "picture.png" if shown is not None:
                return 200, "image/png", encode_frame(shown.image, shown.camera)
            case _ if name in _FILES:
                file, kind = _FILES[name]
                return 200, kind, file.read_bytes()
        return None


def _judge(query: str, shown: ShownPicture, take: Callable[[Pixel], Verdict]) -> Reply:
    """Pass a pixel on, `u=640&v=290`; one that is none, or outside the picture, is told so."""
    width, height = size_of(shown.image)
    pixel = _PIXEL.fullmatch(query)
    if pixel is None or int(pixel[1]) >= width or int(pixel[2]) >= height:
        return say(400, f"That is no pixel of the picture, which has {width} x {height}.")
    verdict = take((int(pixel[1]), int(pixel[2])))
    return say(200 if verdict.taken else 409, verdict.text)
