"""Camera controls of Linux (Video4Linux2) through ioctl.

OpenCV sets some of these controls too, but it rescales them, switches automatic modes back on between calls, and
reports what it requested instead of what the camera does. The numbers are those of linux/videodev2.h and
v4l2-controls.h.
"""

import fcntl
import os
import struct
from dataclasses import dataclass

from labrig.errors import CameraError

_CONTROL = struct.Struct("=Ii")


def _encode_read_write(number: int) -> int:
    """Return the request code _IOWR('V', number, struct v4l2_control)."""
    return 3 << 30 | _CONTROL.size << 16 | ord("V") << 8 | number


GET_CONTROL = _encode_read_write(27)
SET_CONTROL = _encode_read_write(28)

_USER = 0x00980900
_CAMERA = 0x009A0900


@dataclass(frozen=True)
class Control:
    """One control: its id, units of the setting per step, the automatic mode that must be off first, and its menu."""

    identifier: int
    units_per_step: int = 1
    automatic: int | None = None
    manual: int = 0
    menu: tuple[int, ...] = ()


CONTROLS = {
    "exposure_us": Control(_CAMERA + 2, units_per_step=100, automatic=_CAMERA + 1, manual=1),
    "gain": Control(_USER + 19, automatic=_USER + 18),
    "white_balance_k": Control(_USER + 26, automatic=_USER + 12),
    "focus": Control(_CAMERA + 10, automatic=_CAMERA + 12),
    "mains_hz": Control(_USER + 24, menu=(0, 50, 60)),
}
"""Setting of the rig file -> control."""


class V4l2Controls:
    """The controls of one device file.

    Parameters
    ----------
    device : str
        Such as /dev/video0.

    Raises
    ------
    CameraError
        When the device cannot be opened.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        try:
            self._handle = os.open(device, os.O_RDWR | os.O_NONBLOCK)
        except OSError as error:
            raise CameraError(
                f"camera {device} cannot be opened: {error.strerror}",
                "plug it in; ls /dev/video* shows which there are; membership of group video is needed",
            ) from error

    def set(self, name: str, value: float) -> None:
        """Switch the automatic mode of a setting off, and set its value.

        A control that ignores the value keeps its own, which the camera's readback shows.

        Raises
        ------
        CameraError
            When the device refuses the control.
        """
        control = CONTROLS[name]
        if control.automatic is not None and self._request(GET_CONTROL, control.automatic, 0) is not None:
            self._request(SET_CONTROL, control.automatic, control.manual)
        menu = control.menu
        step = menu.index(int(value)) if menu else int(value) // control.units_per_step
        if self._request(SET_CONTROL, control.identifier, step) is None:
            raise CameraError(
                f"camera {self._device} does not accept {name} = {value:g}",
                f"write camera.{name}: null if it has no such control; v4l2-ctl --list-ctrls lists its controls",
            )

    def get(self, name: str) -> float | None:
        """Return the value of a setting that the camera reports; None if it reports none."""
        control = CONTROLS[name]
        step = self._request(GET_CONTROL, control.identifier, 0)
        if step is None:
            return None
        if control.menu:
            return control.menu[step] if 0 <= step < len(control.menu) else None
        return step * control.units_per_step

    def close(self) -> None:
        """Close the device file."""
        os.close(self._handle)

    def _request(self, request: int, identifier: int, value: int) -> int | None:
        """Return the value of the control after the request; None if the device refuses it."""
        try:
            answer = fcntl.ioctl(self._handle, request, _CONTROL.pack(identifier, value))
        except OSError:
            return None
        return int(_CONTROL.unpack(answer)[1])
