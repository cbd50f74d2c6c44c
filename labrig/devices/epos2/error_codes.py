"""What the error codes of an EPOS2 mean, with what to do about them."""

from labrig.devices.error_codes import Emergency

_WIRING = "check the wiring and the plug of this sensor, then power the drive off and on"
_MECHANICS = "free the axis and look for what blocks it, then power the drive off and on"
_SUPPLY = "check supply voltage and cabling, then power the drive off and on"
_BUS = "check CAN wiring, termination and bit rate, then power the drive off and on"
_SETTINGS = "check the drive's parameters in maxon's EPOS Studio, then power the drive off and on"
_LIMIT = "find out why the axis came here; move it back by hand with the power off"
_HEAT = "let the drive cool down and find out what overloads it"

_TABLE = (
    Emergency(0x1000, 0x01, "generic error", _SETTINGS),
    Emergency(0x2310, 0x02, "over-current", _MECHANICS),
    Emergency(0x3210, 0x04, "over-voltage", _SUPPLY),
    Emergency(0x3220, 0x04, "under-voltage: supply cut or emergency stop", _SUPPLY),
    Emergency(0x4210, 0x08, "over-temperature", _HEAT),
    Emergency(0x5113, 0x04, "logic supply voltage too low", _SUPPLY),
    Emergency(0x5114, 0x04, "output stage supply voltage too low", _SUPPLY),
    Emergency(0x6100, 0x20, "internal software error", "power the drive off and on"),
    Emergency(0x6320, 0x20, "software parameter error: target too far for so low a velocity", _SETTINGS),
    Emergency(0x7320, 0x20, "position sensor error", _WIRING),
    Emergency(0x8110, 0x10, "CAN overrun, objects lost", _BUS),
    Emergency(0x8111, 0x10, "CAN overrun", _BUS),
    Emergency(0x8120, 0x10, "CAN passive mode", _BUS),
    Emergency(
        0x8130, 0x10, "life guarding or heartbeat of the computer lost", "find out why labrig stopped beating"
    ),
    Emergency(
        0x8150, 0x10, "CAN transmit COB-ID collision", "give every node its own node id and PDO COB-IDs"
    ),
    Emergency(0x81FD, 0x10, "CAN bus off", _BUS),
    Emergency(0x81FE, 0x10, "CAN receive queue overflow", _BUS),
    Emergency(0x81FF, 0x10, "CAN transmit queue overflow", _BUS),
    Emergency(0x8210, 0x10, "CAN PDO of a wrong length", _BUS),
    Emergency(0x8611, 0x20, "following error: the axis did not keep up with its profile", _MECHANICS),
    Emergency(0xFF01, 0x80, "Hall sensor error", _WIRING),
    Emergency(0xFF02, 0x80, "encoder index error", _WIRING),
    Emergency(0xFF03, 0x80, "encoder resolution error", _WIRING),
    Emergency(0xFF04, 0x80, "Hall sensor not found", _WIRING),
    Emergency(0xFF06, 0x80, "negative limit switch reached", _LIMIT),
    Emergency(0xFF07, 0x80, "positive limit switch reached", _LIMIT),
    Emergency(0xFF08, 0x80, "Hall angle detection error", _WIRING),
    Emergency(0xFF09, 0x80, "software position limit exceeded", _LIMIT),
    Emergency(0xFF0A, 0x80, "position sensor breach", _WIRING),
    Emergency(0xFF0B, 0x20, "system overloaded", _SETTINGS),
    Emergency(0xFF0C, 0x80, "interpolated position mode error", _SETTINGS),
    Emergency(0xFF0D, 0x80, "auto-tuning identification error", _SETTINGS),
    Emergency(0xFF0F, 0x80, "gear scaling factor error", _SETTINGS),
    Emergency(0xFF10, 0x80, "controller gain error", _SETTINGS),
    Emergency(0xFF11, 0x80, "main sensor direction error", _WIRING),
    Emergency(0xFF12, 0x80, "auxiliary sensor direction error", _WIRING),
)
EMERGENCIES = {emergency.code: emergency for emergency in _TABLE}


def describe_emergency(code: int) -> Emergency:
    """Return what an error code means; one that no document lists is named as such."""
    unknown = Emergency(code, 0x01, "unknown to labrig", "look it up in maxon's EPOS2 Firmware Specification")
    return EMERGENCIES.get(code, unknown)
