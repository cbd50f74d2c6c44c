"""Error codes of CANopen drives: emergencies (EMCY) with a remedy, and SDO abort codes with their meaning."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Emergency:
    """One error code of the drive.

    `text` says what happened and `remedy` what to do; `register` is its bit in the error register 0x1001.
    """

    code: int
    register: int
    text: str
    remedy: str

    def __str__(self) -> str:
        """Return code and text."""
        return f"error 0x{self.code:04X}, {self.text}"


_POWER_CYCLE = "if it comes back, and with no needle in tissue, power the drive off and on"
_SENSOR = f"check the wiring and the plug of this sensor, then reset the fault; {_POWER_CYCLE}"
_FREE = "look for what blocks the axis and take it away, then reset the fault"
_SUPPLY = "check supply voltage, cabling and emergency stop, then reset the fault"
_BUS = "check CAN wiring, termination and bit rate, then reset the fault"
_MOVE_BACK = (
    "find out why the axis came here, then reset the fault; labrig devices jog moves it back, or withdraw with a "
    "needle in tissue"
)
_RESET = f"reset the fault; {_POWER_CYCLE}"
_COOL = "let the drive cool down and find out what overloads it"
_SETTINGS = "check the drive's parameters in its manufacturer's program, then reset the fault"
_MANUAL = "look it up in the manual of the drive"


def _table(*rows: tuple[int, int, str, str]) -> Mapping[int, Emergency]:
    return {row[0]: Emergency(*row) for row in rows}


STANDARD_ERRORS = _table(
    (0x1000, 0x01, "generic error", _SETTINGS),
    (0x2310, 0x02, "over-current", _FREE),
    (0x3210, 0x04, "over-voltage", _SUPPLY),
    (0x3220, 0x04, "under-voltage: supply cut or emergency stop", _SUPPLY),
    (0x4210, 0x08, "over-temperature of the drive", _COOL),
    (0x4310, 0x08, "over-temperature of the motor", _COOL),
    (0x5113, 0x04, "logic supply voltage too low", _SUPPLY),
    (0x6100, 0x20, "internal software error", _RESET),
    (
        0x6320,
        0x20,
        "software parameter error: on an EPOS2, a target too far for so low a velocity",
        _SETTINGS,
    ),
    (0x7121, 0x20, "motor blocked", _FREE),
    (0x7305, 0x20, "incremental encoder 1 fault", _SENSOR),
    (0x7320, 0x20, "position sensor error", _SENSOR),
    (0x8110, 0x10, "CAN overrun, objects lost", _BUS),
    (0x8120, 0x10, "CAN passive mode", _BUS),
    (0x8130, 0x10, "life guarding or heartbeat of the computer lost", "find out why labrig stopped beating"),
    (0x8140, 0x10, "recovered from bus off", _BUS),
    (0x8150, 0x10, "CAN transmit COB-ID collision", "give every node its own node id and PDO COB-IDs"),
    (0x8210, 0x10, "CAN PDO of a wrong length", _BUS),
    (0x8611, 0x20, "following error: the axis did not keep up with its profile", _FREE),
    (0x8612, 0x20, "reference or position limit", _MOVE_BACK),
)
"""Errors of CiA 301 and 402."""

EPOS4_ERRORS = _table(
    (0x8A80, 0x80, "negative limit switch", _MOVE_BACK),
    (0x8A81, 0x80, "positive limit switch", _MOVE_BACK),
    (0x8A82, 0x80, "software position limit", _MOVE_BACK),
)

EPOS2_ERRORS = _table(
    (0x5114, 0x04, "output stage supply voltage too low", _SUPPLY),
    (0x8111, 0x10, "CAN overrun", _BUS),
    (0x81FD, 0x10, "CAN bus off", _BUS),
    (0x81FE, 0x10, "CAN receive queue overflow", _BUS),
    (0x81FF, 0x10, "CAN transmit queue overflow", _BUS),
    (0xFF01, 0x80, "Hall sensor error", _SENSOR),
    (0xFF02, 0x80, "encoder index error", _SENSOR),
    (0xFF03, 0x80, "encoder resolution error", _SENSOR),
    (0xFF04, 0x80, "Hall sensor not found", _SENSOR),
    (0xFF06, 0x80, "negative limit switch reached", _MOVE_BACK),
    (0xFF07, 0x80, "positive limit switch reached", _MOVE_BACK),
    (0xFF08, 0x80, "Hall angle detection error", _SENSOR),
    (0xFF09, 0x80, "software position limit exceeded", _MOVE_BACK),
    (0xFF0A, 0x80, "position sensor breach", _SENSOR),
    (0xFF0B, 0x20, "system overloaded", _SETTINGS),
    (0xFF0C, 0x80, "interpolated position mode error", _SETTINGS),
    (0xFF0D, 0x80, "auto-tuning identification error", _SETTINGS),
    (0xFF0F, 0x80, "gear scaling factor error", _SETTINGS),
    (0xFF10, 0x80, "controller gain error", _SETTINGS),
    (0xFF11, 0x80, "main sensor direction error", _SENSOR),
    (0xFF12, 0x80, "auxiliary sensor direction error", _SENSOR),
)
"""Those of an EPOS2 that no standard has."""

_CLASSES = {
    0x2: (0x02, "current", _FREE),
    0x3: (0x04, "voltage", _SUPPLY),
    0x4: (0x08, "temperature", _COOL),
    0x5: (0x01, "hardware of the drive", f"{_RESET}; if it stays, have it repaired"),
    0x6: (0x20, "software of the drive", _SETTINGS),
    0x7: (0x20, "motor, brake or sensor", _SENSOR),
    0x8: (0x10, "monitoring", _BUS),
    0x9: (0x01, "external error", _MANUAL),
}
"""First digit of a code -> error register, part of the drive, and remedy."""


def describe_emergency(code: int, of_maker: Mapping[int, Emergency]) -> Emergency:
    """Return what an error code means; a code that is in no table is called unknown, with its class."""
    found = of_maker.get(code) or STANDARD_ERRORS.get(code)
    if found is not None:
        return found
    register, part, remedy = _CLASSES.get(code >> 12, (0x01, "", ""))
    return Emergency(
        code,
        register,
        "unknown to labrig" + (f" ({part})" if part else ""),
        f"{_MANUAL}; {remedy}" if remedy not in {"", _MANUAL} else _MANUAL,
    )


_ABORTS = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "SDO protocol timed out",
    0x05040001: "command specifier unknown",
    0x05040005: "out of memory",
    0x06010000: "access not supported",
    0x06010001: "the object can only be written",
    0x06010002: "the object can only be read",
    0x06020000: "the object does not exist",
    0x06040041: "the object cannot be mapped to a PDO",
    0x06040042: "the mapped objects exceed the length of a PDO",
    0x06040043: "parameters are incompatible",
    0x06040047: "internal incompatibility",
    0x06060000: "hardware error",
    0x06070010: "the length of the data does not match the object",
    0x06070012: "the data is too long",
    0x06070013: "the data is too short",
    0x06090011: "the subindex does not exist",
    0x06090030: "the value is out of range",
    0x06090031: "the value is too high",
    0x06090032: "the value is too low",
    0x06090036: "maximum below minimum",
    0x08000000: "general error",
    0x08000020: "the data cannot be stored",
    0x08000021: "the data cannot be stored because of local control",
    0x08000022: "wrong device state",
    0x0F00FFB9: "wrong CAN id",
    0x0F00FFBC: "not in service mode",
    0x0F00FFBE: "wrong password",
    0x0F00FFBF: "illegal command",
    0x0F00FFC0: "wrong NMT state",
}


def describe_abort(code: int) -> str:
    """Return what an SDO abort code means."""
    return _ABORTS.get(code, "an abort code unknown to labrig")
