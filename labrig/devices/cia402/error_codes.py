"""What the error codes of a CiA 402 drive mean, with what to do about them.

Codes are those of CiA 301 and 402; 0x8A80 to 0x8A82 are maxon's. One that stands in neither is told by its class.
"""

from labrig.devices.error_codes import Emergency

_MECHANICS = "free the axis and look for what blocks it, then power the drive off and on"
_SUPPLY = "check supply voltage and cabling, then power the drive off and on"
_HEAT = "let the drive cool down and find out what overloads it"
_HARDWARE = "power the drive off and on; if it stays, have it repaired"
_SETTINGS = "check the drive's parameters in its manufacturer's program, then power it off and on"
_SENSOR = "check the wiring and the plug of this sensor, then power the drive off and on"
_BUS = "check CAN wiring, termination and bit rate, then power the drive off and on"
_LIMIT = "find out why the axis came here; move it back by hand with the power off"
_MANUAL = "look it up in the manual of the drive"

_TABLE = (
    Emergency(0x1000, 0x01, "generic error", _MANUAL),
    Emergency(0x2310, 0x02, "over-current", _MECHANICS),
    Emergency(0x3210, 0x04, "over-voltage", _SUPPLY),
    Emergency(0x3220, 0x04, "under-voltage: supply cut or emergency stop", _SUPPLY),
    Emergency(0x4210, 0x08, "over-temperature of the drive", _HEAT),
    Emergency(0x4310, 0x08, "over-temperature of the motor", _HEAT),
    Emergency(0x6320, 0x20, "parameter error", _SETTINGS),
    Emergency(0x7121, 0x20, "motor blocked", _MECHANICS),
    Emergency(0x7305, 0x20, "incremental encoder 1 fault", _SENSOR),
    Emergency(0x7320, 0x20, "position sensor error", _SENSOR),
    Emergency(0x8110, 0x10, "CAN overrun, objects lost", _BUS),
    Emergency(0x8120, 0x10, "CAN error passive", _BUS),
    Emergency(
        0x8130, 0x10, "life guarding or heartbeat of the computer lost", "find out why labrig stopped beating"
    ),
    Emergency(0x8140, 0x10, "recovered from bus off", _BUS),
    Emergency(0x8210, 0x10, "PDO of a wrong length", _SETTINGS),
    Emergency(0x8611, 0x20, "following error: the axis lags behind its profile", _MECHANICS),
    Emergency(0x8612, 0x20, "reference or position limit", _LIMIT),
    Emergency(0x8A80, 0x80, "negative limit switch", _LIMIT),
    Emergency(0x8A81, 0x80, "positive limit switch", _LIMIT),
    Emergency(0x8A82, 0x80, "software position limit", _LIMIT),
)
_CODES = {emergency.code: emergency for emergency in _TABLE}
_CLASSES = {
    0x2: (0x02, "current", _MECHANICS),
    0x3: (0x04, "voltage", _SUPPLY),
    0x4: (0x08, "temperature", _HEAT),
    0x5: (0x01, "hardware of the drive", _HARDWARE),
    0x6: (0x20, "software of the drive", _SETTINGS),
    0x7: (0x20, "motor, brake or sensor", _SENSOR),
    0x8: (0x10, "monitoring", _BUS),
    0x9: (0x01, "external error", _MANUAL),
}
"""First digit of a code -> error register, which part it is about, and what to do."""


def describe_emergency(code: int) -> Emergency:
    """Return what an error code means; one that no standard lists is told by its class."""
    if code in _CODES:
        return _CODES[code]
    register, part, remedy = _CLASSES.get(code >> 12, (0x01, "", _MANUAL))
    text = f"an error of the manufacturer ({part})" if part else "an error of the manufacturer"
    return Emergency(code, register, text, f"{_MANUAL}; {remedy}" if remedy != _MANUAL else remedy)
