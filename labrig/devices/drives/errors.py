"""Error codes of CANopen drives: emergencies (EMCY) with a remedy, and SDO abort codes with their meaning."""

from collections.abc import Mapping
from csv import DictReader
from dataclasses import dataclass
from importlib.resources import files
from io import StringIO

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
_REMEDIES = {
    "sensor": f"check the wiring and the plug of this sensor, then reset the fault; {_POWER_CYCLE}",
    "free": "look for what blocks the axis and take it away, then reset the fault",
    "supply": "check supply voltage, cabling and emergency stop, then reset the fault",
    "bus": "check CAN wiring, termination and bit rate, then reset the fault",
    "move_back": "find out why the axis came here, then reset the fault; labrig devices jog moves it back, or withdraw "
    "with a needle in tissue",
    "reset": f"reset the fault; {_POWER_CYCLE}",
    "repair": f"reset the fault; {_POWER_CYCLE}; if it stays, have it repaired",
    "cool": "let the drive cool down and find out what overloads it",
    "settings": "check the drive's parameters in its manufacturer's program, then reset the fault",
    "manual": "look it up in the manual of the drive",
}
"""Short name in `errors.csv` -> what to do."""


def _read_table(maker: str) -> Mapping[int, Emergency]:
    """Return the errors of a maker, or those of CiA 301 and 402 for the empty name."""
    text = files("labrig.devices.drives").joinpath("errors.csv").read_text("utf-8")
    rows = [row for row in DictReader(StringIO(text)) if row["maker"] == maker]
    remedies = [_REMEDIES.get(row["remedy"], row["remedy"]) for row in rows]
    return {
        int(row["code"], 16): Emergency(int(row["code"], 16), row["text"], remedy)
        for row, remedy in zip(rows, remedies, strict=True)
    }


STANDARD_ERRORS, EPOS2_ERRORS, EPOS4_ERRORS = map(_read_table, ("", "epos2", "epos4"))
"""Errors of CiA 301 and 402, and those of two products that no standard has."""

_ABORTS_OF_MAXON = {
    0x0F00FFB9: "wrong CAN id",
    0x0F00FFBC: "not in service mode",
    0x0F00FFBE: "wrong password",
    0x0F00FFBF: "illegal command",
    0x0F00FFC0: "wrong NMT state",
}

_CLASSES = {
    0x2: ("current", "free"),
    0x3: ("voltage", "supply"),
    0x4: ("temperature", "cool"),
    0x5: ("hardware of the drive", "repair"),
    0x6: ("software of the drive", "settings"),
    0x7: ("motor, brake or sensor", "sensor"),
    0x8: ("monitoring", "bus"),
    0x9: ("external error", "manual"),
}
"""First digit of a code -> part of the drive, and short name of a remedy."""


def describe_emergency(code: int, of_maker: Mapping[int, Emergency]) -> Emergency:
    """Return what an error code means; a code that is in no table is called unknown, with its class."""
    found = of_maker.get(code) or STANDARD_ERRORS.get(code)
    if found is not None:
        return found
    part, remedy = _CLASSES.get(code >> 12, ("", "manual"))
    manual = _REMEDIES["manual"]
    return Emergency(
        code,
        "unknown to labrig" + (f" ({part})" if part else ""),
        manual if remedy == "manual" else f"{manual}; {_REMEDIES[remedy]}",
    )


def describe_abort(code: int) -> str:
    """Return what an SDO abort code means, in the words of CiA 301."""
    known: Mapping[int, str] = {**SdoAbortedError.CODES, **_ABORTS_OF_MAXON}
    return known.get(code, "an abort code unknown to labrig")
