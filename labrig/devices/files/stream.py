"""A network stream: a thread receives the pictures and keeps the newest two."""

import time
from collections import deque
from collections.abc import Callable
from threading import Condition, Thread
from typing import Any, Protocol

import cv2
import numpy as np

from labrig.clock import Clock
from labrig.devices.camera import Exposure, Picture
from labrig.devices.camera_settings import Setting
from labrig.errors import CameraError

TIMEOUT_S = 5.0
"""How long a stream may take to open, and to give a picture."""

_QUEUED_PICTURES = 2


class StreamCapture(Protocol):
    """The part of `cv2.VideoCapture` that is used."""

    def read(self) -> tuple[bool, Any]:
        """Return the next picture; False where the stream has ended or timed out."""

    def get(self, propId: int) -> float:
        """Return a property."""

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
        When it does not open within `TIMEOUT_S`.
    """
    if url == address and "***@" in url:
        raise CameraError(
            f"the password of {address} is not known: records do not keep it",
            "write it in the rig file, and name that file with --rig FILE",
        )
    limits = (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, cv2.CAP_PROP_READ_TIMEOUT_MSEC)
    milliseconds = int(1000 * TIMEOUT_S)
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, [word for key in limits for word in (key, milliseconds)])
    if not capture.isOpened():
        raise CameraError(
            f"stream {address} cannot be opened within {TIMEOUT_S:g} s",
            "check address, user and password, and that the sender is running",
        )
    return capture


class StreamSource:
    """Pictures of a stream, timed by their arrival.

    Parameters
    ----------
    capture : StreamCapture
        The open stream; only the thread uses and closes it.
    address : str
        Its name in messages.
    clock : Clock
        Rig time.
    latency_s : float
        The longest time that a picture takes to arrive [s].
    timeout_s : float
        The longest wait for a picture [s].
    monotonic_s : callable
        The computer's monotonic time [s].
    """

    def __init__(
        self,
        capture: StreamCapture,
        address: str,
        clock: Clock,
        *,
        latency_s: float,
        timeout_s: float = TIMEOUT_S,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.description = f"recorded pictures of stream {address}"
        self.exposures = 0
        self.dropped = 0
        self._size = {
            "width_px": capture.get(cv2.CAP_PROP_FRAME_WIDTH),
            "height_px": capture.get(cv2.CAP_PROP_FRAME_HEIGHT),
        }
        self._capture = capture
        self._clock = clock
        self._latency_s = latency_s
        self._timeout_s = timeout_s
        self._monotonic_s = monotonic_s
        self._queue: deque[tuple[float, Picture]] = deque()
        self._changed = Condition()
        self._is_over = False
        self._thread = Thread(target=self._receive, name="labrig stream", daemon=True)
        self._thread.start()

    def set(self, name: str, value: Setting) -> None:
        """Do nothing: a stream has no settings."""

    def get(self, name: str) -> Setting | None:
        """Return the width or height of the pictures."""
        return self._size.get(name) or None

    def read(self) -> Exposure:
        """Return a picture that arrived so long after this call that it was taken after it.

        Raises
        ------
        CameraError
            When no picture arrives in time, or the stream has ended.
        """
        asked_s, asked_rig_s = self._monotonic_s(), self._clock.now_s()
        with self._changed:
            self._changed.wait_for(
                lambda: self._is_over or self._find_newest_since(asked_s) is not None, self._timeout_s
            )
            found, is_over = self._find_newest_since(asked_s), self._is_over
        if found is None:
            how = "has ended" if is_over else f"gave no picture within {self._timeout_s:g} s"
            raise CameraError(f"{self.description}: it {how}, after {self.exposures}", "check the sender")
        arrived_s, image = found
        age_s = self._monotonic_s() - arrived_s
        # Simulated time does not pass during the wait.
        return Exposure(image, max(self._clock.now_s() - age_s, asked_rig_s), self._latency_s)

    def _find_newest_since(self, asked_s: float) -> tuple[float, Picture] | None:
        return next((picture for picture in self._queue if picture[0] >= asked_s + self._latency_s), None)

    def _receive(self) -> None:
        """Keep the newest pictures until the stream ends or is closed; older ones are dropped and counted."""
        while not self._is_over:
            ok, image = self._capture.read()
            with self._changed:
                self._is_over = self._is_over or not ok
                if ok:
                    self.exposures += 1
                    self._queue.append((self._monotonic_s(), np.asarray(image, np.uint8)))
                if len(self._queue) > _QUEUED_PICTURES:
                    self._queue.popleft()
                    self.dropped += 1
                self._changed.notify_all()
        self._capture.release()

    def close(self) -> None:
        """End the thread; a read of the stream may delay that until its timeout."""
        with self._changed:
            self._is_over = True
        self._thread.join(self._timeout_s + 1.0)
