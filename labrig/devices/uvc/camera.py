"""A USB camera as a kind of camera, and its pictures, each with the time that the kernel gave its buffer.

uvcvideo stamps a buffer with CLOCK_MONOTONIC when the camera begins to send it, which is while or just after the sensor
was exposed; so the time is known to a period of the camera. A driver that stamps by another clock is found out by its
first picture. Pictures are then timed by the call: some had been queued from before and are thrown away, so that the
exposure lies anywhere between the call and its return, 0.2 s at 24 pictures a second.
"""

import time
from collections.abc import Callable
from typing import Any, Literal

import cv2
import numpy as np

from labrig.clock import Clock
from labrig.devices.camera import CameraContext, ControlledCameraDescription, Exposure, Setting
from labrig.devices.uvc.v4l2 import CONTROLS, V4l2Controls
from labrig.errors import CameraError

_PROPERTIES = {
    "pixel_format": cv2.CAP_PROP_FOURCC,
    "width_px": cv2.CAP_PROP_FRAME_WIDTH,
    "height_px": cv2.CAP_PROP_FRAME_HEIGHT,
    "rate_hz": cv2.CAP_PROP_FPS,
}
_QUEUED_PICTURES = 4
"""Pictures that the driver may have ready from before; they are thrown away for one that is new."""

_BEFORE_OPENING_S = 1.0
"""A picture may have been taken while the device was being opened."""


class UvcSource:
    """Pictures of one device.

    Parameters
    ----------
    capture : cv2.VideoCapture
        The opened device.
    controls : V4l2Controls
        Its controls.
    clock : Clock
        Rig time.
    section : ControlledCameraDescription
        Its section of the rig file, which says how long a picture is exposed at most.
    monotonic_s : callable
        CLOCK_MONOTONIC [s].
    """

    def __init__(
        self,
        capture: Any,
        controls: Any,
        clock: Clock,
        section: ControlledCameraDescription,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._capture = capture
        self._controls = controls
        self._clock = clock
        self._exposure_s = section.longest_exposure_s
        self._bound_s = max(self._exposure_s, 1 / section.rate_hz)
        self._monotonic_s = monotonic_s
        self._last_stamp_s = monotonic_s() - _BEFORE_OPENING_S
        self._is_stamped = True
        self._is_open = True

    def set(self, name: str, value: Setting) -> None:
        """Ask the camera for a setting. Raises `CameraError` when it has no such setting."""
        if name in CONTROLS and not isinstance(value, str):
            self._controls.set(name, value)
            return
        number = float(cv2.VideoWriter.fourcc(*value)) if isinstance(value, str) else value
        self._capture.set(_PROPERTIES[name], number)

    def get(self, name: str) -> Setting | None:
        """Return the value that the camera uses; None where it does not tell."""
        if name in CONTROLS:
            told: float | None = self._controls.get(name)
            return told
        value: float = self._capture.get(_PROPERTIES[name])
        if name == "pixel_format":
            return int(value).to_bytes(4, "little", signed=False).decode("ascii", "replace")
        return value if value > 0 else None

    def read(self) -> Exposure | None:
        """Return a picture whose exposure began after this call; None when the camera gives none.

        Raises
        ------
        CameraError
            When every picture is older by its stamp, as many as the driver may have had ready.
        """
        asked_s = self._monotonic_s()
        stamp_s: float | None = None
        # One more may have been exposed when the call came.
        for _ in range(_QUEUED_PICTURES + 2):
            if not self._capture.grab():
                return None
            stamp_s = self._read_stamp_s()
            if stamp_s is not None and stamp_s - self._exposure_s >= asked_s:
                break
        else:
            if stamp_s is not None:
                raise CameraError(
                    f"the camera gave {_QUEUED_PICTURES + 2} pictures, each older than its command; the exposure of "
                    f"the last one began {asked_s - (stamp_s - self._exposure_s):.3f} s before it",
                    "unplug the camera and plug it in again",
                )
        ok, image = self._capture.retrieve()
        if not ok:
            return None
        picture, now_s = np.asarray(image, np.uint8), self._monotonic_s()
        if stamp_s is not None:
            return Exposure(picture, self._clock.now_s() - (now_s - stamp_s), self._bound_s)
        half_s = 0.5 * (now_s - asked_s)
        return Exposure(picture, self._clock.now_s() - half_s, half_s)

    def _read_stamp_s(self) -> float | None:
        """Return the kernel's time of the picture that was taken; None once one cannot be of the monotonic clock."""
        stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        self._is_stamped = self._is_stamped and self._last_stamp_s < stamp_s <= self._monotonic_s()
        self._last_stamp_s = stamp_s
        return stamp_s if self._is_stamped else None

    def close(self) -> None:
        """Let go of the device."""
        if self._is_open:
            self._is_open = False
            self._capture.release()
            self._controls.close()


class UvcCameraDescription(ControlledCameraDescription):
    """A USB camera. A control that it does not have is null."""

    driver: Literal["uvc"]
    """uvc: a USB camera."""

    def open(self, context: CameraContext) -> UvcSource:
        """Open a device file.

        Raises
        ------
        CameraError
            When there is no such device, or it is not a camera.
        """
        # Opened first: it fails with a reason, where OpenCV prints to stderr and says no.
        controls = V4l2Controls(self.device)
        capture = cv2.VideoCapture(self.device, cv2.CAP_V4L2)
        if not capture.isOpened():
            controls.close()
            raise CameraError(
                f"{self.device} gives no pictures",
                "another program may use it, or it is no camera: ls /dev/video* shows which there are",
            )
        return UvcSource(capture, controls, context.clock, self)


CAMERA = UvcCameraDescription
"""What the entry point names."""
