"""A network stream of recorded pictures, timed by their arrival."""

import time
from collections.abc import Callable
from typing import Any, Protocol

import cv2
import numpy as np

from labrig.devices.stream_source import STREAM_TIMEOUT_S, Dropped, Received
from labrig.errors import CameraError


class StreamCapture(Protocol):
    """The part of `cv2.VideoCapture` that is used."""

    def read(self) -> tuple[bool, Any]:
        """Return the next picture; False where the stream has ended or timed out."""

    def release(self) -> None:
        """Close the stream."""


def open_stream(url: str, address: str) -> cv2.VideoCapture:
    """Open a stream with FFmpeg and nothing else.

    Parameters
    ----------
    url, address : str
        The stream with its password, and its name in messages.

    Raises
    ------
    CameraError
        When it does not open within `STREAM_TIMEOUT_S`.
    """
    if url == address and "***@" in url:
        raise CameraError(
            f"the password of {address} is not known: records do not keep it",
            "write it in the rig file, and name that file with --rig FILE",
        )
    limits = (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, cv2.CAP_PROP_READ_TIMEOUT_MSEC)
    milliseconds = int(1000 * STREAM_TIMEOUT_S)
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, [word for key in limits for word in (key, milliseconds)])
    if not capture.isOpened():
        raise CameraError(
            f"stream {address} cannot be opened within {STREAM_TIMEOUT_S:g} s",
            "check address, user and password, and that the sender is running",
        )
    return capture


class ArrivingPictures:
    """The pictures of a stream, each with the time of its arrival.

    Parameters
    ----------
    capture : StreamCapture
        The open stream.
    address : str
        Its name in messages.
    monotonic_s : callable
        The computer's monotonic time [s].
    """

    def __init__(
        self, capture: StreamCapture, address: str, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        self.description = f"recorded pictures of stream {address}"
        self._capture = capture
        self._monotonic_s = monotonic_s

    def receive(self) -> Received | Dropped:
        """Wait for the next picture. Raises `CameraError` when the stream has ended or timed out."""
        ok, image = self._capture.read()
        if not ok:
            raise CameraError("it has ended", "check the sender")
        return Received(self._monotonic_s(), np.asarray(image, np.uint8))

    def close(self) -> None:
        """Close the stream."""
        self._capture.release()
