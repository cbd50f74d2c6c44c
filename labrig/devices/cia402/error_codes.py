"""The error codes of a CiA 402 drive, with a remedy for each.

The codes are those of CiA 301 and 402; 0x8A80 to 0x8A82 are maxon's. A code that is in neither is
described by its class.
"""

from labrig.devices.error_codes import (
    CHECK_BUS,
    CHECK_SENSOR,
    CHECK_SUPPLY,
    COOL_DOWN,
    FREE_AXIS,
    MOVE_BACK,
    RESET,
    STANDARD_EMERGENCIES,
    Emergency,
)

_HARDWARE = f"{RESET}; if it stays, have it repaired"
_SETTINGS = "check the drive's parameters in its manufacturer's program, then reset the fault"
_MANUAL = "look it up in the manual of the drive"

_TABLE = (
    *STANDARD_EMERGENCIES,
    Emergency(0x1000, 0x01, "generic error", _MANUAL),
    Emergency(0x4210, 0x08, "over-temperature of the drive", COOL_DOWN),
    Emergency(0x4310, 0x08, "over-temperature of the motor", COOL_DOWN),
    Emergency(0x6320, 0x20, "parameter error", _SETTINGS),
    Emergency(0x7121, 0x20, "motor blocked", FREE_AXIS),
    Emergency(0x7305, 0x20, "incremental encoder 1 fault", CHECK_SENSOR),
    Emergency(0x8120, 0x10, "CAN error passive", CHECK_BUS),
    Emergency(0x8140, 0x10, "recovered from bus off", CHECK_BUS),
    Emergency(0x8210, 0x10, "PDO of a wrong length", _SETTINGS),
    Emergency(0x8611, 0x20, "following error: the axis lags behind its profile", FREE_AXIS),
    Emergency(0x8612, 0x20, "reference or position limit", MOVE_BACK),
    Emergency(0x8A80, 0x80, "negative limit switch", MOVE_BACK),
    Emergency(0x8A81, 0x80, "positive limit switch", MOVE_BACK),
    Emergency(0x8A82, 0x80, "software position limit", MOVE_BACK),
)
_EMERGENCIES = {emergency.code: emergency for emergency in _TABLE}
_CLASSES = {
    0x2: (0x02, "current", FREE_AXIS),
    0x3: (0x04, "voltage", CHECK_SUPPLY),
    0x4: (0x08, "temperature", COOL_DOWN),
    0x5: (0x01, "hardware of the drive", _HARDWARE),
    0x6: (0x20, "software of the drive", _SETTINGS),
    0x7: (0x20, "motor, brake or sensor", CHECK_SENSOR),
    0x8: (0x10, "monitoring", CHECK_BUS),
    0x9: (0x01, "external error", _MANUAL),
}
"""First digit of a code -> error register, part of the drive, and remedy."""


def describe_emergency(code: int) -> Emergency:
    """Return what an error code means; a code that no standard lists is described by its class."""
    if code in _EMERGENCIES:
        return _EMERGENCIES[code]
    register, part, remedy = _CLASSES.get(code >> 12, (0x01, "", _MANUAL))
    text = f"an error of the manufacturer ({part})" if part else "an error of the manufacturer"
    return Emergency(code, register, text, f"{_MANUAL}; {remedy}" if remedy != _MANUAL else remedy)
