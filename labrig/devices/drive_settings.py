"""What a drive must be set to for an axis of the rig file, and the fingerprint of that (0x1020)."""

import zlib
from collections.abc import Mapping

from labrig.devices import epos2_objects as od
from labrig.devices.rig_file import AxisDescription, HeartbeatDescription

MAX_RPM = 25_000
_SWITCH_BITS = {"negative": 1, "positive": 2}


def drive_settings(axis: AxisDescription, heartbeat: HeartbeatDescription) -> dict[od.Entry, int]:
    """Return the settings of the drive of an axis, in quadcounts and rpm.

    Raises
    ------
    InputError
        When gear, lead or encoder are unknown.
    """
    scale = axis.scale()
    acceleration = scale.to_rpm_per_s(axis.acceleration)
    switches = sum(_SWITCH_BITS[one] for one in set(axis.limit_switches))
    return {
        od.MAX_FOLLOWING_ERROR: scale.to_distance_quadcounts(axis.max_following_error),
        od.POSITION_WINDOW: scale.to_distance_quadcounts(axis.position_window),
        od.POSITION_WINDOW_TIME: axis.position_window_time_ms,
        od.MAX_PROFILE_VELOCITY: min(MAX_RPM, scale.to_rpm(axis.max_speed)),
        od.PROFILE_ACCELERATION: acceleration,
        od.PROFILE_DECELERATION: acceleration,
        od.QUICK_STOP_DECELERATION: scale.to_rpm_per_s(axis.quick_stop_deceleration),
        od.PROFILE_TYPE: 0,
        od.LIMIT_EXECUTION_MASK: od.LIMIT_EXECUTION_MASK.default | switches,
        od.CONSUMER_HEARTBEAT: heartbeat.computer_node_id << 16 | heartbeat.timeout_ms,
    }


def fingerprint(settings: Mapping[od.Entry, int]) -> tuple[int, int]:
    """Return what date and time of 0x1020 hold for these settings; the drive clears both when one is changed."""
    text = ";".join(f"{entry.place}={value}" for entry, value in settings.items())
    return zlib.crc32(text.encode()), len(settings)
