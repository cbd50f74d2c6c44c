"""Error codes of CANopen drives, of `errors.csv` and `remedies.csv`: emergencies (EMCY) and SDO abort codes.

A row of `errors.csv` is of a maker, of CiA 301 and 402, of a class (the first digit of a code) or an SDO abort; its
remedy is the name of one in `remedies.csv`, or the text itself.
"""

from csv import DictReader
from importlib.resources import files
from io import StringIO

from canopen.sdo.exceptions import SdoAbortedError


def _read_rows(name: str) -> list[dict[str, str]]:
    return list(DictReader(StringIO(files("labrig.devices.drives").joinpath(name).read_text("utf-8"))))


_REMEDIES = {row["name"]: row["remedy"] for row in _read_rows("remedies.csv")}
ERRORS = {
    (row["table"], int(row["code"], 16)): (row["text"], _REMEDIES.get(row["remedy"], row["remedy"]))
    for row in _read_rows("errors.csv")
}
"""Table and code -> what happened, and what to do."""


def describe_emergency(code: int, maker: str) -> tuple[str, str]:
    """Return what an error code means, and what to do; a code that is in no table is called unknown, with its class."""
    found = ERRORS.get((maker, code)) or ERRORS.get(("cia402", code))
    if found is not None:
        return found
    part, remedy = ERRORS.get(("class", code >> 12), ("", ""))
    manual = _REMEDIES["manual"]
    return "unknown to labrig" + (f" ({part})" if part else ""), f"{manual}; {remedy}" if remedy else manual


def describe_abort(code: int) -> str:
    """Return what an SDO abort code means, in the words of CiA 301."""
    text, _ = ERRORS.get(("sdo-abort", code), (SdoAbortedError.CODES.get(code), ""))
    return text or "an abort code unknown to labrig"
