"""A USB camera as a kind of camera."""

from typing import Literal

import cv2

from labrig.devices.camera import CameraContext, ControlledCameraDescription
from labrig.devices.uvc.source import UvcSource
from labrig.devices.uvc.v4l2 import V4l2Controls
from labrig.errors import CameraError


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
                "it may be used by another program, or be no camera; try another number",
            )
        return UvcSource(
            capture,
            controls,
            context.clock,
            exposure_s=self.longest_exposure_s,
            rate_hz=self.rate_hz,
        )


CAMERA = UvcCameraDescription
"""What the entry point names."""
