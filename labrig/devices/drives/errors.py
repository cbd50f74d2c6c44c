"""Error codes of CANopen drives: emergencies (EMCY) with a remedy, and SDO abort codes with their meaning."""

from collections.abc import Mapping
from dataclasses import dataclass

from canopen.sdo.exceptions import SdoAbortedError


@dataclass(frozen=True)
class Emergency:
    """One error code of the drive.

    `text` says what happened, and `remedy` what to do.
    """

    code: int
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


def _table(*rows: tuple[int, str, str]) -> Mapping[int, Emergency]:
    return {row[0]: Emergency(*row) for row in rows}


STANDARD_ERRORS = _table(
    (0x1000, "generic error", _SETTINGS),
    (0x2310, "over-current", _FREE),
    (0x3210, "over-voltage", _SUPPLY),
    (0x3220, "under-voltage: supply cut or emergency stop", _SUPPLY),
    (0x4210, "over-temperature of the drive", _COOL),
    (0x4310, "over-temperature of the motor", _COOL),
    (0x5113, "logic supply voltage too low", _SUPPLY),
    (0x6100, "internal software error", _RESET),
    (0x6320, "software parameter error: on an EPOS2, a target too far for so low a velocity", _SETTINGS),
    (0x7121, "motor blocked", _FREE),
    (0x7305, "incremental encoder 1 fault", _SENSOR),
    (0x7320, "position sensor error", _SENSOR),
    (0x8110, "CAN overrun, objects lost", _BUS),
    (0x8120, "CAN passive mode", _BUS),
    (0x8130, "life guarding or heartbeat of the computer lost", "find out why labrig stopped beating"),
    (0x8140, "recovered from bus off", _BUS),
    (0x8150, "CAN transmit COB-ID collision", "give every node its own node id and PDO COB-IDs"),
    (0x8210, "CAN PDO of a wrong length", _BUS),
    (0x8611, "following error: the axis did not keep up with its profile", _FREE),
    (0x8612, "reference or position limit", _MOVE_BACK),
)
"""Errors of CiA 301 and 402."""

EPOS4_ERRORS = _table(
    (0x8A80, "negative limit switch", _MOVE_BACK),
    (0x8A81, "positive limit switch", _MOVE_BACK),
    (0x8A82, "software position limit", _MOVE_BACK),
)

EPOS2_ERRORS = _table(
    (0x5114, "output stage supply voltage too low", _SUPPLY),
    (0x8111, "CAN overrun", _BUS),
    (0x81FD, "CAN bus off", _BUS),
    (0x81FE, "CAN receive queue overflow", _BUS),
    (0x81FF, "CAN transmit queue overflow", _BUS),
    (0xFF01, "Hall sensor error", _SENSOR),
    (0xFF02, "encoder index error", _SENSOR),
    (0xFF03, "encoder resolution error", _SENSOR),
    (0xFF04, "Hall sensor not found", _SENSOR),
    (0xFF06, "negative limit switch reached", _MOVE_BACK),
    (0xFF07, "positive limit switch reached", _MOVE_BACK),
    (0xFF08, "Hall angle detection error", _SENSOR),
    (0xFF09, "software position limit exceeded", _MOVE_BACK),
    (0xFF0A, "position sensor breach", _SENSOR),
    (0xFF0B, "system overloaded", _SETTINGS),
    (0xFF0C, "interpolated position mode error", _SETTINGS),
    (0xFF0D, "auto-tuning identification error", _SETTINGS),
    (0xFF0F, "gear scaling factor error", _SETTINGS),
    (0xFF10, "controller gain error", _SETTINGS),
    (0xFF11, "main sensor direction error", _SENSOR),
    (0xFF12, "auxiliary sensor direction error", _SENSOR),
)
"""Those of an EPOS2 that no standard has."""

_ABORTS_OF_MAXON = {
    0x0F00FFB9: "wrong CAN id",
    0x0F00FFBC: "not in service mode",
    0x0F00FFBE: "wrong password",
    0x0F00FFBF: "illegal command",
    0x0F00FFC0: "wrong NMT state",
}

_CLASSES = {
    0x2: ("current", _FREE),
    0x3: ("voltage", _SUPPLY),
    0x4: ("temperature", _COOL),
    0x5: ("hardware of the drive", f"{_RESET}; if it stays, have it repaired"),
    0x6: ("software of the drive", _SETTINGS),
    0x7: ("motor, brake or sensor", _SENSOR),
    0x8: ("monitoring", _BUS),
    0x9: ("external error", _MANUAL),
}
"""First digit of a code -> part of the drive, and remedy."""


def describe_emergency(code: int, of_maker: Mapping[int, Emergency]) -> Emergency:
    """Return what an error code means; a code that is in no table is called unknown, with its class."""
    found = of_maker.get(code) or STANDARD_ERRORS.get(code)
    if found is not None:
        return found
    part, remedy = _CLASSES.get(code >> 12, ("", ""))
    return Emergency(
        code,
        "unknown to labrig" + (f" ({part})" if part else ""),
        f"{_MANUAL}; {remedy}" if remedy not in {"", _MANUAL} else _MANUAL,
    )


def describe_abort(code: int) -> str:
    """Return what an SDO abort code means, in the words of CiA 301."""
    known: Mapping[int, str] = {**SdoAbortedError.CODES, **_ABORTS_OF_MAXON}
    return known.get(code, "an abort code unknown to labrig")
