"""The parts of a multipart/x-mixed-replace answer over HTTP (RFC 2046, 5.1), each with its time of exposure."""

import http.client
import math
from dataclasses import dataclass
from http import HTTPStatus
from urllib.parse import urlsplit

from labrig.errors import CameraError

_LONGEST_LINE = 1000
"""Bytes of a line between two parts; a boundary has at most 70 characters."""

_MOST_BLANK_LINES = 4
_CHECK = "check the address, and that the sender is running"
_AS_FILES = "driver: files takes such a stream as recorded pictures, which never steer"


@dataclass(frozen=True)
class Part:
    """A JPEG file, and its time of exposure by the sender [s since 1970]."""

    exposed_utc_s: float
    jpeg: bytes


class PartReader:
    """Reads the parts of a stream, one after another.

    Parameters
    ----------
    url : str
        The stream, http or https.
    longest_bytes : int
        A longer part is refused.
    timeout_s : float
        The longest wait for an answer, and for any data [s].

    Raises
    ------
    CameraError
        When it does not answer in time, or with something else than such a stream.
    """

    def __init__(self, url: str, *, longest_bytes: int, timeout_s: float) -> None:
        self._longest_bytes = longest_bytes
        parts = urlsplit(url)
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        self._connection = kind(parts.hostname or "", parts.port, timeout=timeout_s)
        path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        try:
            self._connection.request("GET", path)
            self._answer = self._connection.getresponse()
        except (OSError, http.client.HTTPException) as error:
            self._connection.close()
            raise CameraError(
                f"camera {url} does not answer: {error or type(error).__name__}", _CHECK
            ) from error
        try:
            self._delimiter = _find_delimiter(self._answer)
        except CameraError as error:
            self.close()
            raise CameraError(f"camera {url}: {error.message}", error.hint) from error

    def read_part(self) -> Part:
        """Wait for the next part.

        Raises
        ------
        CameraError
            When the stream has ended, pauses for too long, or is not as it should be: it cannot go on then.
        """
        try:
            self._skip_to_part()
            headers = http.client.parse_headers(self._answer)
            exposed_utc_s = _read_time(headers)
            length = self._read_length(headers)
            jpeg = self._answer.read(length)
        except (OSError, http.client.HTTPException) as error:
            raise CameraError(f"it broke off: {error or type(error).__name__}", _CHECK) from error
        if len(jpeg) < length:
            raise CameraError("it has ended within a picture", _CHECK)
        return Part(exposed_utc_s, jpeg)

    def _skip_to_part(self) -> None:
        """Read the line that begins a part."""
        for _ in range(_MOST_BLANK_LINES + 1):
            line = self._answer.readline(_LONGEST_LINE)
            if line.strip() == self._delimiter:
                return
            if line.strip():
                break
        if not line or line.strip() == self._delimiter + b"--":
            raise CameraError("it has ended", _CHECK)
        raise CameraError(
            f"{line[:40]!r} stands between two pictures, expected {self._delimiter!r}",
            "check Content-Length and the boundary that the sender writes",
        )

    def _read_length(self, headers: http.client.HTTPMessage) -> int:
        text = headers.get("Content-Length", "")
        length = int(text) if text.isascii() and text.isdecimal() and len(text) <= len(str(2**63)) else 0
        if not 0 < length <= self._longest_bytes:
            raise CameraError(
                f"a picture has Content-Length {text[:40]!r}, expected 1 to {self._longest_bytes} bytes",
                "check width_px and height_px in the rig file, and the sender",
            )
        return length

    def close(self) -> None:
        """Close the connection; a second call changes nothing."""
        self._answer.close()
        self._connection.close()


def _find_delimiter(answer: http.client.HTTPResponse) -> bytes:
    """Return the line between two parts. Raises `CameraError` where the answer is not a stream of pictures."""
    if answer.status != HTTPStatus.OK:
        raise CameraError(f"it answers {answer.status} {answer.reason[:80]}", _CHECK)
    kind, boundary = answer.headers.get_content_type(), answer.headers.get_boundary()
    if kind != "multipart/x-mixed-replace" or not boundary:
        raise CameraError(
            f"it sends {kind[:80]}, expected multipart/x-mixed-replace with a boundary",
            "check the path of the URL; a sender of MJPEG often has pages beside its stream",
        )
    return b"--" + boundary.encode("ascii", "replace")


def _read_time(headers: http.client.HTTPMessage) -> float:
    """Return the time of exposure [s since 1970]. Raises `CameraError` if the part has none."""
    text = headers.get("X-Timestamp")
    if text is None:
        raise CameraError(
            "its pictures have no X-Timestamp, so when they were exposed is not known", _AS_FILES
        )
    try:
        exposed_utc_s = float(text)
    except ValueError:
        exposed_utc_s = math.nan
    if not math.isfinite(exposed_utc_s):
        raise CameraError(f"a picture has X-Timestamp {text[:40]!r}, expected seconds since 1970", _AS_FILES)
    return exposed_utc_s
