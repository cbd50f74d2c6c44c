"""Where the bus and the camera of a rig file are served: ports of this computer, which no other one reaches."""

from dataclasses import dataclass
from urllib.parse import urlsplit

from labrig.devices.rig_file import RigDescription
from labrig.errors import InputError

LOCAL_HOST = "127.0.0.1"
_CAN_PORT, _CAMERA_PORT = 29536, 29537
"""Ports that a hint proposes; no service is registered for them."""


@dataclass(frozen=True)
class LocalPorts:
    """TCP ports of bus and camera."""

    can: int
    camera: int


def find_local_ports(rig: RigDescription) -> LocalPorts:
    """Return the ports that a rig file names.

    Raises
    ------
    InputError
        When its bus or camera is elsewhere, so that serving would not reach the labrig that opens this rig, or would
        put simulated drives on the bus of real ones.
    """
    can = _find_port(rig.can.channel, "socket") if rig.can.interface == "slcan" else None
    camera = _find_port(rig.camera.address, "http") if rig.camera.driver == "mjpeg" else None
    wrong = [
        f"{key} is {place or 'null'}"
        for key, place, port in (
            ("can", f"{rig.can.interface} {rig.can.channel}".strip(), can),
            ("camera", f"{rig.camera.driver} {rig.camera.address}".strip(), camera),
        )
        if port is None
    ]
    if can is None or camera is None:
        raise InputError(f"rig {rig.name} is not served: {', '.join(wrong)}", _make_hint(rig))
    if can == camera:
        raise InputError(f"bus and camera have the same port, {can}", "write another port in camera.source")
    return LocalPorts(can, camera)


def _find_port(url: str, scheme: str) -> int | None:
    """Return the port of a URL of this computer; None for any other."""
    try:
        parts = urlsplit(url)
        is_local = (parts.scheme, parts.hostname) == (scheme, LOCAL_HOST)
        return (parts.port or None) if is_local else None
    except ValueError:  # a port that is not a number
        return None


def _make_hint(rig: RigDescription) -> str:
    camera = rig.camera
    return (
        "rehearse with a copy of the rig file that says "
        f"can: {{interface: slcan, channel: 'socket://{LOCAL_HOST}:{_CAN_PORT}', options: {{sleep_after_open: 0}}}}, "
        f"camera: {{driver: mjpeg, source: 'http://{LOCAL_HOST}:{_CAMERA_PORT}/', width_px: {camera.width_px}, "
        f"height_px: {camera.height_px}, rate_hz: 10, stamp_error_s: 0.005}} and names a state_file and calibration "
        "files of its own"
    )
