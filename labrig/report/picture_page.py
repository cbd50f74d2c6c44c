"""A page for a browser on this computer: a picture with what is drawn over it, and a pixel that is picked in it.

The page is the three files of `browser`. All that labrig says comes to it as JSON and enters it as text.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2

from labrig.input_file import parse_json
from labrig.report.local_server import LocalServer, Reply
from labrig.vision.camera_frame import encode_frame
from labrig.vision.camera_in_use import UNKNOWN_CAMERA, CameraInUse
from labrig.vision.landmarks import Landmark
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

Pixel = tuple[int, int]


@dataclass(frozen=True)
class Verdict:
    """Whether a picked pixel is the answer, and what the person is told."""

    taken: bool
    text: str


@dataclass(frozen=True, eq=False)
class ShownPicture:
    """What the page shows.

    Attributes
    ----------
    number : int
        Number of the picture.
    image : ndarray of uint8, (H, W) or (H, W, 3)
    heading, remark : str
        A headline, and a sentence below it; may be empty.
    scores : sequence of Score
    landmarks : sequence of Landmark
        What was found in it, or in one shortly before.
    camera : CameraInUse
        Its camera, kept in a saved test frame.
    """

    number: int
    image: Picture
    heading: str
    remark: str = ""
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
            "remark": self.remark,
            "scores": [asdict(score) for score in self.scores],
            "landmarks": [asdict(mark) for mark in self.landmarks],
            "asks": asks,
        }


class PicturePage:
    """The page, served from now on.

    Parameters
    ----------
    port : int
        Where it is served; 0 for any free port.
    take : callable or None
        Takes a pixel that a person has confirmed, in a thread of the server; None where no pixel is asked for.

    Raises
    ------
    InputError
        When the port cannot be had.
    """

    def __init__(self, port: int = 0, take: Callable[[Pixel], Verdict] | None = None) -> None:
        self._take = take
        self._shown: ShownPicture | None = None
        self._parts: Mapping[str, Reply] = {
            name: Reply(file.read_bytes(), kind) for name, (file, kind) in _FILES.items()
        }
        self._server = LocalServer(self._answer, port)
        self.url, self.port = self._server.url, self._server.port
        self.finish_replies, self.close = self._server.finish_replies, self._server.close

    def show(self, picture: ShownPicture) -> None:
        """Show this from now on."""
        self._shown = picture

    def _answer(self, name: str, sent: bytes | None) -> Reply | None:
        shown = self._shown
        if sent is not None:
            return self._judge(sent, shown) if name == "answer" and self._take is not None else None
        if name == "state.json":
            document = (
                {"number": -1, "remark": ""} if shown is None else shown.document(asks=self._take is not None)
            )
            return Reply(json.dumps(document).encode(), "application/json")
        if shown is not None and name == "picture":
            return Reply(cv2.imencode(".jpg", shown.image, _QUALITY)[1].tobytes(), "image/jpeg")
        if shown is not None and name == "picture.png":
            saved = {"Content-Disposition": f'attachment; filename="camera-{shown.number:06d}.png"'}
            return Reply(encode_frame(shown.image, shown.camera), "image/png", headers=saved)
        return self._parts.get(name)

    def _judge(self, sent: bytes, shown: ShownPicture | None) -> Reply:
        """Pass a pixel on; one that is none, or outside the picture, is told so."""
        pixel = _read_pixel(sent)
        width, height = (0, 0) if shown is None else size_of(shown.image)
        if pixel is None or not (0 <= pixel[0] < width and 0 <= pixel[1] < height) or self._take is None:
            return _say(f"That is no pixel of the picture, which has {width} x {height}.", 400)
        verdict = self._take(pixel)
        return _say(verdict.text, 200 if verdict.taken else 409)


def _say(text: str, status: int) -> Reply:
    return Reply(text.encode(), status=status)


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
