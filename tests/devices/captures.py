"""Recorded pictures, and a device of OpenCV's that takes pictures in a time of its own, with a queue."""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from labrig.devices.camera import Camera, Picture
from labrig.devices.clocks import SimulatedClock
from labrig.devices.files import FilesCameraDescription
from labrig.devices.uvc.camera import UvcCameraDescription, UvcSource

SIZE_PX = (64, 48)


def draw_numbered_picture(number: int) -> Picture:
    """Return the picture with a number."""
    return np.full(SIZE_PX[::-1], 5 * number, np.uint8)


def number_in(image: Picture) -> int:
    """Return the number of a picture."""
    return round(float(image.mean()) / 5)


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


def uvc_section(**keys: object) -> UvcCameraDescription:
    """Return the section of a camera that takes 24 pictures a second, with changes."""
    size = {"width_px": SIZE_PX[0], "height_px": SIZE_PX[1], "rate_hz": 24.0, "pixel_format": "GREY"}
    controls = {"exposure_us": 5000, "mains_hz": 50, "gain": None, "white_balance_k": None, "focus": None}
    return UvcCameraDescription.model_validate({"driver": "uvc", **size, **controls, **keys})


BEGAN_S = 1000.0
"""What the computer's monotonic clock says when rig time begins [s]."""


@dataclass
class FakeCapture:
    """A camera that fills a queue of buffers at its rate, and gives the oldest, as V4L2 does; and its controls."""

    clock: SimulatedClock = field(default_factory=SimulatedClock)
    queue_length: int = 4
    stamps: bool = True
    stamp_offset_s: float = 0.0  # what the clock of its stamps is ahead of the monotonic one
    tells: dict[int | str, float | None] = field(
        default_factory=dict
    )  # whatever was set; None or 0: it is silent
    shows: Picture | None = None  # its picture; by default each says by its pixels which it is
    _queue: deque[tuple[float, int]] = field(default_factory=deque)
    _taken: tuple[float, int] = (0.0, -1)
    _made: int = 0
    _settings: dict[int | str, float | None] = field(default_factory=dict)

    def monotonic_s(self) -> float:
        """Return the computer's monotonic time [s]."""
        return BEGAN_S + self.clock.now_s()

    def open(self, **keys: object) -> Camera:
        """Open it as OpenCV does, by a section with changes."""
        section = uvc_section(**keys)
        return Camera(UvcSource(self, self, self.clock, section, self.monotonic_s), section, self.clock)

    @property
    def _next_s(self) -> float:
        return BEGAN_S + self._made / 24.0

    def _fill(self) -> None:
        while self._next_s <= self.monotonic_s():
            if len(self._queue) < self.queue_length:
                self._queue.append((self._next_s, self._made))
            self._made += 1

    def grab(self) -> bool:
        """Take the oldest picture, and wait for it where there is none yet."""
        self._fill()
        if not self._queue:
            self.clock.sleep(self._next_s - self.monotonic_s() + 1e-6)
            self._fill()
        self._taken = self._queue.popleft()
        return True

    def retrieve(self) -> tuple[bool, Picture]:
        """Return the picture that was taken; an empty one is none."""
        taken = np.full(SIZE_PX[::-1], self._taken[1] % 251, np.uint8)
        return (True, taken) if self.shows is None else (self.shows.size > 0, self.shows)

    @property
    def exposed_s(self) -> float:
        """When the picture that was taken was exposed, by the monotonic clock [s]."""
        return self._taken[0]

    def get(self, what: int | str) -> float | None:
        """Return the stamp, or what was set."""
        if what == cv2.CAP_PROP_POS_MSEC:
            return 1000 * (self._taken[0] + self.stamp_offset_s) if self.stamps else 0.0
        return self.tells.get(what, self._settings.get(what))

    def set(self, what: int | str, value: float) -> None:
        """Take every setting."""
        self._settings[what] = value

    def release(self) -> None:
        """Nothing is held."""

    close = release
