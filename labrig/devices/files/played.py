"""Recorded pictures as a source: each look takes the next one, or by their times the one that is due."""

from typing import Protocol

from labrig.clock import Clock
from labrig.devices.camera import Exposure, Picture
from labrig.devices.camera_settings import Setting
from labrig.errors import CameraError

_MICROSECOND_S = 1e-6
_LONGEST_GAP_S = 5.0
"""The longest that a picture is waited for; a network stream is given as long."""


class Reel(Protocol):
    """Recorded pictures in their order, each taken once.

    Attributes
    ----------
    words : str
        What they are, for messages.
    passed : int
        Pictures that were taken or passed over.
    """

    words: str
    passed: int

    def size_px(self) -> tuple[int, int]:
        """Return width and height of a picture."""

    def take(self, from_s: float) -> tuple[Picture, float | None] | None:
        """Return the next picture that is not older than this [s after the first], and its time; None at the end."""

    def close(self) -> None:
        """Let go of the file."""


class PlayedSource:
    """Pictures of a reel, in the rig's time from the first look on.

    Parameters
    ----------
    reel : Reel
        The pictures.
    clock : Clock
        Rig time.
    start_s : float
        Time of the first look, since the first picture [s].
    """

    def __init__(self, reel: Reel, clock: Clock, start_s: float) -> None:
        self._reel = reel
        self._clock = clock
        self._start_s = start_s
        self._zero_s: float | None = None
        self._last_s: float | None = None
        self._size = dict(zip(("width_px", "height_px"), map(float, reel.size_px()), strict=True))

    @property
    def words(self) -> str:
        """What is played."""
        return self._reel.words

    @property
    def exposures(self) -> int:
        """Pictures taken or passed over."""
        return self._reel.passed

    def set(self, name: str, value: Setting) -> None:
        """Nothing can be set: the pictures were taken."""

    def get(self, name: str) -> Setting | None:
        """Return what the pictures have."""
        return self._size.get(name)

    def read(self) -> Exposure:
        """Return the next picture, that of now or later where they have times.

        Raises
        ------
        CameraError
            When there is none left, or the next is of seconds later.
        """
        now_s = self._clock.now_s()
        if self._zero_s is None:
            self._zero_s = now_s - self._start_s
        from_s = now_s - self._zero_s - _MICROSECOND_S
        taken = self._reel.take(from_s)
        if taken is None:
            raise CameraError(
                f"the pictures have ended: {self._reel.words}, {self._reel.passed} taken or passed over{self._until()}",
                "record more of them, or ask for fewer: labrig check PROTOCOL says how many a run takes",
            )
        image, self._last_s = taken
        if self._last_s is None:
            return Exposure(image)
        if self._last_s - from_s > _LONGEST_GAP_S:
            raise CameraError(
                f"{self._reel.words}: the next picture is of {self._last_s:.3f} s, one of {from_s:.3f} s was asked for",
                f"pictures are waited for at most {_LONGEST_GAP_S:g} s",
            )
        return Exposure(image, self._zero_s + self._last_s, t_bound_s=0.0)

    def _until(self) -> str:
        return "" if self._last_s is None else f", the last one taken of {self._last_s:.3f} s"

    def close(self) -> None:
        """Let go of the file."""
        self._reel.close()
