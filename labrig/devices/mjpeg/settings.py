"""The section `camera` of a rig file with `driver: mjpeg`."""

from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field

from labrig.devices.camera_settings import CameraDescription, Setting

_BYTES_A_PIXEL = 3
_HEADER_BYTES = 65_536


def _check_url(source: str) -> str:
    parts = urlsplit(source)
    if not source.isascii() or not source.isprintable() or " " in source:
        raise ValueError("a URL has neither spaces nor control characters; write them as %20")
    if parts.scheme not in {"http", "https"} or not parts.hostname:
        raise ValueError("expected http://HOST:PORT/PATH or https://HOST/PATH")
    if "@" in parts.netloc:
        raise ValueError("labrig sends no user and no password to such a camera; use one that asks for none")
    _ = parts.port  # raises ValueError for one that is not a port
    return source


class MjpegCameraDescription(CameraDescription):
    """A camera that sends MJPEG over HTTP, with the time of exposure of each picture as X-Timestamp."""

    driver: Literal["mjpeg"] = Field(
        description="mjpeg: a camera that sends pictures over HTTP with their times of exposure."
    )
    source: Annotated[str, Field(min_length=1, max_length=1000), AfterValidator(_check_url)] = Field(
        description="URL of the stream, http or https, without a user."
    )
    latency_s: Annotated[float, Field(gt=0, le=5)] = Field(
        1.0, description="Greatest age of a picture on its arrival; an older one is dropped [s]."
    )
    stamp_error_s: Annotated[float, Field(ge=0, le=1)] = Field(
        description="How far X-Timestamp may be from the time of exposure: the time from exposure to stamp, plus the "
        "difference of the clocks if the sender is another computer. Keep both synchronised (NTP or PTP); labrig "
        "cannot measure this. A picture counts as newer than its command only by more than it [s]."
    )

    @property
    def address(self) -> str:
        """The URL."""
        return self.source

    @property
    def longest_bytes(self) -> int:
        """Most bytes of a part: those of a picture without compression, and a header."""
        return _BYTES_A_PIXEL * self.width_px * self.height_px + _HEADER_BYTES

    def settings(self) -> dict[str, Setting]:
        """Return the required size of the pictures; the sender has a rate of its own."""
        return {"width_px": self.width_px, "height_px": self.height_px}
