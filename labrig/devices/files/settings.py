"""The section `camera` of a rig file with `driver: files`."""

import re
from collections.abc import Iterable
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, PlainSerializer

from labrig.devices.camera_settings import CameraDescription, RigKind, Setting
from labrig.protocol.formatting import mask_passwords
from labrig.protocol.model import Conflict

MOST_PIXELS = 7680 * 4320
"""Pixels of the largest picture, that of 8K video: a stream must not fill the memory."""

STREAMS = ("http", "https", "rtsp", "rtmp")
"""URL schemes of the streams that labrig opens."""

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):(//[^\s/?#]+)?")


def _check_source(source: str) -> str:
    if source.startswith("-"):
        raise ValueError("a name that starts with - reads as an option; write ./ before it")
    if " ! " in source:
        raise ValueError("labrig opens no GStreamer pipeline; name a folder, a video file or a stream")
    if not source.isprintable():
        raise ValueError("a control character is not allowed")
    found = _SCHEME.match(source)
    if found is not None and found[1].lower() not in STREAMS:
        raise ValueError(f"{found[1]}: is not a stream that labrig opens: {', '.join(STREAMS)}")
    if found is not None and found[2] is None:
        raise ValueError(f"the stream has no host, expected {found[1]}://HOST/...")
    return source


class FilesCameraDescription(CameraDescription):
    """Recorded pictures in place of a camera: a folder, a video file, or a network stream. They never steer."""

    rig_kinds: ClassVar[frozenset[RigKind]] = frozenset({"simulated", "bench"})
    recorded: ClassVar[bool] = True

    driver: Literal["files"] = Field(description="files: recorded pictures in place of a camera.")
    source: Annotated[
        str,
        Field(min_length=1, max_length=1000, repr=False),
        AfterValidator(_check_source),
        PlainSerializer(mask_passwords, when_used="json"),
    ] = Field(
        description="Folder of pictures or video file, relative to the rig file; or a stream, http, https, rtsp or "
        "rtmp. Its password is not kept in records."
    )
    times: Literal["rate", "sidecar", "modified"] | None = Field(
        None,
        description="Times of the pictures. rate: one every 1 / rate_hz; sidecar: from times.csv in the folder, with "
        "the columns picture and t_s; modified: the modification time of each file. null: a video has its own times; a "
        "folder gives its next picture at each request.",
    )
    start_s: Annotated[float, Field(ge=0, le=1e6)] = Field(
        0.0, description="Time of the picture that a run takes first, counted from the first picture [s]."
    )
    latency_s: Annotated[float, Field(ge=0, le=5)] = Field(
        0.5,
        description="Longest measured latency of a picture of the stream; a picture counts as newer than its command "
        "only if it arrives later than this [s].",
    )

    @property
    def is_stream(self) -> bool:
        """Whether the pictures come over the network."""
        return _SCHEME.match(self.source) is not None

    @property
    def address(self) -> str:
        """The source without its password."""
        return mask_passwords(self.source)

    def settings(self) -> dict[str, Setting]:
        """Return the required size of the pictures; they have a rate of their own."""
        return {"width_px": self.width_px, "height_px": self.height_px}

    def conflicts(self) -> Iterable[Conflict]:
        """Yield a picture size that is too large, and keys that a stream cannot have."""
        if self.width_px * self.height_px > MOST_PIXELS:
            yield Conflict(
                "width_px",
                f"a picture has {self.width_px * self.height_px} pixels, more than {MOST_PIXELS}",
                "record smaller pictures",
            )
        if self.is_stream and self.times is not None:
            yield Conflict(
                "times", f"times is {self.times}, a stream has the times of arrival", "write times: null"
            )
        if self.is_stream and self.start_s:
            yield Conflict("start_s", f"start_s is {self.start_s:g}, a stream has no start", "leave it out")
