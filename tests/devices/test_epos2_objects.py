"""labrig's EDS file of an EPOS2 against a real drive's: type, access, range, default.

`epos2_objects.csv` has index, subindex, type, access, range and default of the EPOS2 70/10 with software 0x2122, as
maxon's EDS file of March 2011 states them (in public: Pejman712/CRF, MaxonEPOS2.eds); empty where it states nothing.
"""

import csv
from pathlib import Path

from canopen.objectdictionary import ODVariable, datatypes

from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import find_bounds, find_default, read_own_eds
from labrig.devices.drives.objects import Place
from tests.devices import epos2_places as od

TYPES = {
    f"{sign}{bits}": getattr(datatypes, f"{kind}{bits}")
    for sign, kind in (("U", "UNSIGNED"), ("I", "INTEGER"))
    for bits in (8, 16, 32)
}
OBJECTS = read_own_eds("epos2.eds").objects
NARROWED = {
    *(Place(0x2000), Place(0x2210, 4), co.MODE, co.PROFILE_VELOCITY, co.PROFILE_TYPE),
    *(Place(0x2070, n) for n in range(1, 10)),
    *(co.PROFILE_ACCELERATION, co.PROFILE_DECELERATION, co.QUICK_STOP_DECELERATION, co.HOMING_ACCELERATION),
    *(co.HOMING_METHOD, co.HOMING_SPEED_SWITCH, co.HOMING_SPEED_INDEX, co.MAX_ACCELERATION),
    *(Place(0x6089), Place(0x6410, 3), od.MAX_MOTOR_SPEED),
}
"""Objects whose range is that of the firmware specification of the first generation: the EDS file states none."""

LEFT_OUT = {0x1011}
"""Indices of which labrig's file has less: restoring defaults is not simulated."""


def _number(text: str) -> int | None:
    """Return a number of the table, without its node id; None for an empty place."""
    return int(text.partition("+")[0], 0) if text else None


def _read_table() -> dict[Place, dict[str, str]]:
    with Path(__file__).with_name("epos2_objects.csv").open(encoding="utf-8", newline="") as file:
        return {Place(int(row["index"], 16), int(row["subindex"])): row for row in csv.DictReader(file)}


TABLE = _read_table()


def test_every_object_is_that_of_a_real_drive() -> None:
    """With its width, sign, access, range and default; none is in the file that a real drive does not have."""
    for place, found in OBJECTS.items():
        row = TABLE[place]
        assert found.data_type == TYPES[row["type"]], place
        assert found.access_type == row["access"].replace("const", "ro"), place
        stated = ODVariable("", *place)
        stated.data_type = found.data_type
        stated.min, stated.max = _number(row["low"]), _number(row["high"])
        is_narrowed = (stated.min, stated.max) == (None, None) and place in NARROWED
        assert (find_bounds(found) != find_bounds(stated)) is is_narrowed, place
        assert not row["default"] or find_default(found) == _number(row["default"]), place
    kept = {place.index for place in OBJECTS} - LEFT_OUT
    assert {place for place in TABLE if place.index in kept and TABLE[place]["default"]} <= OBJECTS.keys()
