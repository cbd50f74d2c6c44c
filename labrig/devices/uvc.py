"""A USB video class camera on Linux: pictures through OpenCV, controls through Video4Linux2."""

import cv2
import numpy as np

from labrig.devices.camera import Picture, Setting
from labrig.devices.v4l2 import CONTROLS, V4l2Controls
from labrig.errors import CameraError

_PROPERTIES = {
    "pixel_format": cv2.CAP_PROP_FOURCC,
    "width_px": cv2.CAP_PROP_FRAME_WIDTH,
    "height_px": cv2.CAP_PROP_FRAME_HEIGHT,
    "rate_hz": cv2.CAP_PROP_FPS,
}
_QUEUED_PICTURES = 4
"""Pictures that the driver may have ready from before; they are thrown away for one that is new."""


class UvcSource:
    """Pictures of one device file.

    Parameters
    ----------
    device : str
        Such as /dev/video0.

    Raises
    ------
    CameraError
        When there is no such device, or it is no camera.
    """

    exposures_a_picture = _QUEUED_PICTURES + 1

    def __init__(self, device: str) -> None:
        self._device = device
        # Opened first: it fails with a reason, where OpenCV prints to stderr and says no.
        self._controls = V4l2Controls(device)
        self._capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            self._controls.close()
            raise CameraError(
                f"{device} gives no pictures",
                "it may be used by another program, or be no camera; try another number",
            )

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
            return self._controls.get(name)
        value = self._capture.get(_PROPERTIES[name])
        if name == "pixel_format":
            return int(value).to_bytes(4, "little", signed=False).decode("ascii", "replace")
        return value if value > 0 else None

    def read(self) -> Picture | None:
        """Return a picture that was exposed after this call; None when the camera gives none."""
        for _ in range(_QUEUED_PICTURES):
            if not self._capture.grab():
                return None
        ok, image = self._capture.read()
        return np.asarray(image, np.uint8) if ok else None

    def close(self) -> None:
        """Let go of the device."""
        self._capture.release()
        self._controls.close()
