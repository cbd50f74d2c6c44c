"""Recorded pictures as a source: each read takes the next picture, or the one whose time has come."""

from typing import Protocol

from labrig.clock import Clock
from labrig.devices.camera import Exposure, Picture
from labrig.devices.camera_settings import Setting
from labrig.errors import CameraError

_MICROSECOND_S = 1e-6
_LONGEST_GAP_S = 5.0
"""The longest wait for a picture; a network stream gets the same."""


class RecordedPictures(Protocol):
    """Recorded pictures in order, each taken once.

    Attributes
    ----------
    description : str
        Their name in messages.
    passed : int
        Number of pictures taken or skipped.
    """

    description: str
    passed: int

    def size_px(self) -> tuple[int, int]:
        """Return width and height of a picture."""

    def take(self, from_s: float) -> tuple[Picture, float | None] | None:
        """Return the next picture not older than `from_s` [s after the first], and its time; None at the end."""

    def close(self) -> None:
        """Close the file."""


class PlaybackSource:
    """Recorded pictures, played in rig time from the first read on.

    Parameters
    ----------
    pictures : RecordedPictures
        The pictures.
    clock : Clock
        Rig time.
    start_s : float
        Time of the first read, counted from the first picture [s].
    """

    def __init__(self, pictures: RecordedPictures, clock: Clock, start_s: float) -> None:
        self._pictures = pictures
        self._clock = clock
        self._start_s = start_s
        self._zero_s: float | None = None
        self._last_s: float | None = None
        self._size = dict(zip(("width_px", "height_px"), map(float, pictures.size_px()), strict=True))

    @property
    def description(self) -> str:
        """The name of the pictures in messages."""
        return self._pictures.description

    @property
    def exposures(self) -> int:
        """Number of pictures taken or skipped."""
        return self._pictures.passed

    def set(self, name: str, value: Setting) -> None:
        """Do nothing: recorded pictures have no settings."""

    def get(self, name: str) -> Setting | None:
        """Return the width or height of the pictures."""
        return self._size.get(name)

    def read(self) -> Exposure:
        """Return the next picture; if they have times, the first one not older than now.

        Raises
        ------
        CameraError
            When no picture is left, or the next one is too much later.
        """
        now_s = self._clock.now_s()
        if self._zero_s is None:
            self._zero_s = now_s - self._start_s
        from_s = now_s - self._zero_s - _MICROSECOND_S
        taken = self._pictures.take(from_s)
        if taken is None:
            raise CameraError(
                f"the pictures have ended: {self.description}, {self.exposures} taken or skipped{self._format_end()}",
                "record more pictures, or take fewer: labrig check PROTOCOL says how many a run takes",
            )
        image, self._last_s = taken
        if self._last_s is None:
            return Exposure(image)
        if self._last_s - from_s > _LONGEST_GAP_S:
            raise CameraError(
                f"{self.description}: the next picture is at {self._last_s:.3f} s, {from_s:.3f} s was requested",
                f"labrig waits at most {_LONGEST_GAP_S:g} s for a picture",
            )
        return Exposure(image, self._zero_s + self._last_s, t_bound_s=0.0)

    def _format_end(self) -> str:
        return "" if self._last_s is None else f", the last one taken at {self._last_s:.3f} s"

    def close(self) -> None:
        """Close the file."""
        self._pictures.close()
