"""Recorded pictures, and a device of OpenCV's that takes pictures in a time of its own, with a queue."""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from labrig.devices.camera import Picture
from labrig.devices.clocks import SimulatedClock
from labrig.devices.files import FilesCameraDescription
from labrig.devices.uvc.camera import UvcCameraDescription, UvcSource

SIZE_PX = (64, 48)


def draw_numbered_picture(number: int) -> Picture:
    """Return the picture with a number."""
    picture = np.full(SIZE_PX[::-1], 10 + 5 * number, np.uint8)
    picture[:8] = 0
    return picture


def number_in(image: Picture) -> int:
    """Return the number of a picture."""
    return round((float(image[-8:].mean()) - 10) / 5)


def write_pictures(folder: Path, count: int) -> Path:
    """Write pictures 1.png, 2.png, ... into a new folder."""
    folder.mkdir()
    for number in range(count):
        cv2.imwrite(str(folder / f"{number + 1}.png"), draw_numbered_picture(number))
    return folder


def files_section(source: str, **keys: object) -> FilesCameraDescription:
    """Return the section of recorded pictures."""
    size = {"width_px": SIZE_PX[0], "height_px": SIZE_PX[1], "rate_hz": 20.0}
    return FilesCameraDescription.model_validate({"driver": "files", "source": source, **size, **keys})


def uvc_section() -> UvcCameraDescription:
    """Return the section of a camera that takes 24 pictures a second."""
    size = {"width_px": SIZE_PX[0], "height_px": SIZE_PX[1], "rate_hz": 24.0, "pixel_format": "GREY"}
    lacks = dict.fromkeys(("gain", "white_balance_k", "focus"))
    return UvcCameraDescription.model_validate(
        {"driver": "uvc", **size, **lacks, "exposure_us": 5000, "mains_hz": 50}
    )


BEGAN_S = 1000.0
"""What the computer's monotonic clock says when rig time begins [s]."""


@dataclass
class FakeCapture:
    """A camera that fills a queue of buffers at its rate, and gives the oldest, as V4L2 does.

    Attributes
    ----------
    stamp_offset_s : float
        What the clock of its stamps is ahead of the monotonic one [s].
    stamps : bool
        Whether it stamps its pictures at all.
    """

    clock: SimulatedClock = field(default_factory=SimulatedClock)
    rate_hz: float = 24.0
    queue_length: int = 4
    stamp_offset_s: float = 0.0
    stamps: bool = True
    _queue: deque[tuple[float, int]] = field(default_factory=deque)
    _taken: tuple[float, int] = (0.0, -1)
    _next_s: float = BEGAN_S
    _made: int = 0
    _properties: dict[int, float] = field(default_factory=dict)

    def monotonic_s(self) -> float:
        """Return the computer's monotonic time [s]."""
        return BEGAN_S + self.clock.now_s()

    def open(self, section: UvcCameraDescription | None = None, lacks: str = "") -> UvcSource:
        """Open it as OpenCV does, with controls that lack at most one."""
        controls = FakeControls(lacks=lacks)
        return UvcSource(self, controls, self.clock, section or uvc_section(), self.monotonic_s)

    def _fill(self) -> None:
        while self._next_s <= self.monotonic_s():
            if len(self._queue) < self.queue_length:
                self._queue.append((self._next_s, self._made))
            self._made += 1
            self._next_s += 1 / self.rate_hz

    def grab(self) -> bool:
        """Take the oldest picture, and wait for it where there is none yet."""
        self._fill()
        if not self._queue:
            self.clock.sleep(self._next_s - self.monotonic_s() + 1e-6)
            self._fill()
        self._taken = self._queue.popleft()
        return True

    def retrieve(self) -> tuple[bool, Picture]:
        """Return the picture that was taken, whose pixels say which it is."""
        return True, np.full(SIZE_PX[::-1], self._taken[1] % 251, np.uint8)

    @property
    def exposed_s(self) -> float:
        """When the picture that was taken was exposed, by the monotonic clock [s]."""
        return self._taken[0]

    def get(self, propId: int) -> float:
        """Return the stamp, or what was set."""
        if propId == cv2.CAP_PROP_POS_MSEC:
            return 1000 * (self._taken[0] + self.stamp_offset_s) if self.stamps else 0.0
        return self._properties.get(propId, 0.0)

    def set(self, propId: int, value: float) -> bool:
        """Take every setting."""
        self._properties[propId] = value
        return True

    def release(self) -> None:
        """Nothing is held."""


@dataclass
class FakeControls:
    """Controls that take every setting, except for one that the camera lacks."""

    values: dict[str, float] = field(default_factory=dict)
    lacks: str = ""

    def set(self, name: str, value: float) -> None:
        """Take it."""
        if name != self.lacks:
            self.values[name] = value

    def get(self, name: str) -> float | None:
        """Tell it."""
        return self.values.get(name)

    def close(self) -> None:
        """Nothing is held."""
