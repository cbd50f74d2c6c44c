"""The error codes of an EPOS2, with a remedy for each."""

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

_SETTINGS = "check the drive's parameters in maxon's EPOS Studio, then reset the fault"

_TABLE = (
    *STANDARD_EMERGENCIES,
    Emergency(0x1000, 0x01, "generic error", _SETTINGS),
    Emergency(0x4210, 0x08, "over-temperature", COOL_DOWN),
    Emergency(0x5113, 0x04, "logic supply voltage too low", CHECK_SUPPLY),
    Emergency(0x5114, 0x04, "output stage supply voltage too low", CHECK_SUPPLY),
    Emergency(0x6100, 0x20, "internal software error", RESET),
    Emergency(0x6320, 0x20, "software parameter error: target too far for so low a velocity", _SETTINGS),
    Emergency(0x8111, 0x10, "CAN overrun", CHECK_BUS),
    Emergency(0x8120, 0x10, "CAN passive mode", CHECK_BUS),
    Emergency(
        0x8150, 0x10, "CAN transmit COB-ID collision", "give every node its own node id and PDO COB-IDs"
    ),
    Emergency(0x81FD, 0x10, "CAN bus off", CHECK_BUS),
    Emergency(0x81FE, 0x10, "CAN receive queue overflow", CHECK_BUS),
    Emergency(0x81FF, 0x10, "CAN transmit queue overflow", CHECK_BUS),
    Emergency(0x8210, 0x10, "CAN PDO of a wrong length", CHECK_BUS),
    Emergency(0x8611, 0x20, "following error: the axis did not keep up with its profile", FREE_AXIS),
    Emergency(0xFF01, 0x80, "Hall sensor error", CHECK_SENSOR),
    Emergency(0xFF02, 0x80, "encoder index error", CHECK_SENSOR),
    Emergency(0xFF03, 0x80, "encoder resolution error", CHECK_SENSOR),
    Emergency(0xFF04, 0x80, "Hall sensor not found", CHECK_SENSOR),
    Emergency(0xFF06, 0x80, "negative limit switch reached", MOVE_BACK),
    Emergency(0xFF07, 0x80, "positive limit switch reached", MOVE_BACK),
    Emergency(0xFF08, 0x80, "Hall angle detection error", CHECK_SENSOR),
    Emergency(0xFF09, 0x80, "software position limit exceeded", MOVE_BACK),
    Emergency(0xFF0A, 0x80, "position sensor breach", CHECK_SENSOR),
    Emergency(0xFF0B, 0x20, "system overloaded", _SETTINGS),
    Emergency(0xFF0C, 0x80, "interpolated position mode error", _SETTINGS),
    Emergency(0xFF0D, 0x80, "auto-tuning identification error", _SETTINGS),
    Emergency(0xFF0F, 0x80, "gear scaling factor error", _SETTINGS),
    Emergency(0xFF10, 0x80, "controller gain error", _SETTINGS),
    Emergency(0xFF11, 0x80, "main sensor direction error", CHECK_SENSOR),
    Emergency(0xFF12, 0x80, "auxiliary sensor direction error", CHECK_SENSOR),
)
_EMERGENCIES = {emergency.code: emergency for emergency in _TABLE}


def describe_emergency(code: int) -> Emergency:
    """Return what an error code means; a code that no document lists is called unknown."""
    unknown = Emergency(code, 0x01, "unknown to labrig", "look it up in maxon's EPOS2 Firmware Specification")
    return _EMERGENCIES.get(code, unknown)
