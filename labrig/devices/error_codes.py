"""Error codes of CANopen drives: emergencies (EMCY) with a remedy, and SDO abort codes with their meaning."""

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
CHECK_SENSOR = f"check the wiring and the plug of this sensor, then reset the fault; {_POWER_CYCLE}"
FREE_AXIS = "look for what blocks the axis and take it away, then reset the fault"
CHECK_SUPPLY = "check supply voltage, cabling and emergency stop, then reset the fault"
CHECK_BUS = "check CAN wiring, termination and bit rate, then reset the fault"
MOVE_BACK = (
    "find out why the axis came here, then reset the fault; labrig devices jog moves it back, or withdraw with a "
    "needle in tissue"
)
RESET = f"reset the fault; {_POWER_CYCLE}"
COOL_DOWN = "let the drive cool down and find out what overloads it"

STANDARD_EMERGENCIES = (
    Emergency(0x2310, 0x02, "over-current", FREE_AXIS),
    Emergency(0x3210, 0x04, "over-voltage", CHECK_SUPPLY),
    Emergency(0x3220, 0x04, "under-voltage: supply cut or emergency stop", CHECK_SUPPLY),
    Emergency(0x7320, 0x20, "position sensor error", CHECK_SENSOR),
    Emergency(0x8110, 0x10, "CAN overrun, objects lost", CHECK_BUS),
    Emergency(
        0x8130, 0x10, "life guarding or heartbeat of the computer lost", "find out why labrig stopped beating"
    ),
)
"""Errors of CiA 301 and 402 that every drive reports under the same code."""

ABORTS = {
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
    return ABORTS.get(code, "an abort code unknown to labrig")
