"""A video file, with the times of its pictures."""

from pathlib import Path

import cv2
import numpy as np

from labrig.devices.camera import Picture
from labrig.errors import CameraError
from labrig.input_file import open_file

_HEAD_BYTES = 4096


class VideoFile:
    """The pictures of a video file, each taken once.

    Parameters
    ----------
    path : Path
        The file: a regular file, not a list of other files.
    rate_hz : float or None
        Rate of the pictures; None takes the times in the file.

    Raises
    ------
    CameraError
        When it is missing or not a video.
    """

    def __init__(self, path: Path, rate_hz: float | None) -> None:
        _require_video(path)
        self._capture = cv2.VideoCapture(str(path.resolve()), cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            raise CameraError(
                f"{path} is not a video that OpenCV can open", "convert it to MJPEG in .avi, or to .mp4"
            )
        self.description = f"recorded pictures of video {path}"
        self.passed = 0
        self._path = path
        self._rate_hz = rate_hz
        self._last_s = -1.0

    def size_px(self) -> tuple[int, int]:
        """Return width and height of a picture."""
        return (
            int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )

    def take(self, from_s: float) -> tuple[Picture, float | None] | None:
        """Return the next picture at `from_s` or later, and its time; None after the last."""
        while self._capture.grab():
            time_s = self._read_time_s()
            self.passed += 1
            if time_s >= from_s:
                ok, image = self._capture.retrieve()
                return (np.asarray(image, np.uint8), time_s) if ok else None
        return None

    def _read_time_s(self) -> float:
        if self._rate_hz is not None:
            return self.passed / self._rate_hz
        time_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        if time_s <= self._last_s:
            raise CameraError(
                f"picture {self.passed} of {self._path} is at {time_s:.6f} s, not later than the one before it",
                "write times: rate, and the rate of the camera as rate_hz",
            )
        self._last_s = time_s
        return time_s

    def close(self) -> None:
        """Close the file."""
        self._capture.release()


def _require_video(path: Path) -> None:
    """Refuse a file that is not regular, and lists of other files, which are text. Raises `CameraError`."""
    try:
        with open_file(path) as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise CameraError(f"{path} cannot be read: {error.strerror}", "check camera.source") from error
    if b"\0" not in head:
        raise CameraError(f"{path} is text or empty, expected a video", "name the video itself, not a list")
