"""EDS files: how they are read, which are refused, and labrig's own of an EPOS2 against a real drive's.

`epos2_objects.csv` has index, subindex, type, access, range and default of the EPOS2 70/10 with software 0x2122, as
maxon's EDS file of March 2011 states them (in public: Pejman712/CRF, MaxonEPOS2.eds); empty where it states nothing.
"""

import csv
from pathlib import Path

import pytest
from canopen.objectdictionary import ODVariable, datatypes

from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import (
    count_bytes,
    find_bounds,
    find_default,
    parse_eds,
    read_eds,
    read_own_eds,
)
from labrig.devices.drives.objects import Place
from labrig.errors import InputError
from tests.devices import epos2_places as od
from tests.devices.eds_text import eds_text

OWN, EPOS2 = read_own_eds("epos4.eds"), read_own_eds("epos2.eds").objects


def test_objects_have_width_access_default_and_range() -> None:
    """Defaults are without the node id; a block without a type, as maxon's files have it, is left out."""
    eds = parse_eds(eds_text(), "drive.eds")
    assert (eds.vendor, eds.product, eds.revision) == (OWN.vendor, OWN.product, OWN.revision)
    assert eds.objects.keys() == OWN.objects.keys()
    sent = eds.objects[co.TRANSMIT_PDO_COB_IDS[0]]
    assert (count_bytes(sent), sent.writable, find_default(sent)) == (4, True, 0x40000180)
    assert find_bounds(eds.objects[co.FOLLOWING_ERROR_TIMEOUT]) == (0, 0)
    assert not eds.objects[co.STATUSWORD].writable


def test_numbers_are_read_as_manufacturers_write_them() -> None:
    """Two's complement, blanks, comments, upper and lower case, strings, a byte order mark."""
    text = (
        "; a comment\n[DeviceInfo]\nVendorNumber = 0x2F ; Nanotec\nProductNumber=10\n"
        "[607d]\nParameterName=limits\nObjectType=8\n"
        "[607dsub1]\nParameterName=low\nDataType=0x0004\nAccessType=RW\nLowLimit=0x80000000\nHighLimit=0xFFFFFFFF\n"
        "DefaultValue=0xFFFFFFFE\n"
        "[1008]\nParameterName=name\nDataType=9\nAccessType=const\n"
    )
    eds = parse_eds("\xef\xbb\xbf" + text, "odd.eds")
    assert (eds.vendor, eds.product, eds.revision) == (0x2F, 10, None)
    lower = eds.objects[co.LOWER_LIMIT]
    assert (find_bounds(lower), find_default(lower)) == ((-(2**31), -1), -2)
    assert Place(0x1008) not in eds.objects


WITHOUT_TYPE = eds_text(without=[0x6040]) + "\n[6040]\nParameterName=x\n"
REFUSED = {
    "no section": ("VendorNumber=1\n", ""),
    "bytes": ("\x7fELF\x00\x01", ""),
    "a YAML file": ("axes:\n  insertion: {}\n", ""),
    "a section twice": ("[DeviceInfo]\n[6040]\nDataType=6\n[6040]\nDataType=7\n", ""),
    "no device": ("[6040]\nDataType=6\nAccessType=rw\n", ""),
    "no vendor": (eds_text(device={"VendorNumber": None}), "VendorNumber"),
    "no product": (eds_text(device={"ProductNumber": ""}), ""),
    "a type that is no number": (f"{WITHOUT_TYPE}DataType=six\nAccessType=rw\n", "six"),
    "no access": (f"{WITHOUT_TYPE}DataType=6\n", ""),
    "no type": (WITHOUT_TYPE, ""),
}


@pytest.mark.parametrize(("text", "words"), REFUSED.values(), ids=REFUSED)
def test_a_file_that_is_not_an_eds_is_refused(text: str, words: str) -> None:
    """Each error has a reason and the file to use; no file is used in part."""
    with pytest.raises(InputError, match=rf"drive\.eds is not an EDS file: .*{words}") as refusal:
        parse_eds(text, "drive.eds")
    assert "EDS file" in refusal.value.hint


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("link.eds", "leaves the folder of the rig file"), ("none.eds", "No such file"),
        (".", "Is a directory"), ("large.eds", "4000001 bytes"),
    ],
)  # fmt: skip
def test_a_file_is_read_from_the_folder_of_the_rig_file(tmp_path: Path, name: str, words: str) -> None:
    """A link that leaves it, a file that is too large and a missing one are refused."""
    folder = tmp_path / "rig"
    folder.mkdir()
    for path in (tmp_path / "outside.eds", folder / "here.eds"):
        path.write_text(eds_text())
    (folder / "link.eds").symlink_to(tmp_path / "outside.eds")
    (folder / "large.eds").write_bytes(b";" * 4_000_001)
    with pytest.raises(InputError, match=words):
        read_eds(folder / name, folder)
    assert read_eds(folder / "here.eds", folder).product == OWN.product


TYPES = {
    f"{sign}{bits}": getattr(datatypes, f"{kind}{bits}")
    for sign, kind in (("U", "UNSIGNED"), ("I", "INTEGER"))
    for bits in (8, 16, 32)
}
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


with Path(__file__).with_name("epos2_objects.csv").open(encoding="utf-8", newline="") as _file:
    TABLE = {Place(int(row["index"], 16), int(row["subindex"])): row for row in csv.DictReader(_file)}


def test_every_object_is_that_of_a_real_drive() -> None:
    """With its width, sign, access, range and default; none is in the file that a real drive does not have."""
    for place, found in EPOS2.items():
        row = TABLE[place]
        assert found.data_type == TYPES[row["type"]], place
        assert found.access_type == row["access"].replace("const", "ro"), place
        stated = ODVariable("", *place)
        stated.data_type = found.data_type
        stated.min, stated.max = _number(row["low"]), _number(row["high"])
        is_narrowed = (stated.min, stated.max) == (None, None) and place in NARROWED
        assert (find_bounds(found) != find_bounds(stated)) is is_narrowed, place
        assert not row["default"] or find_default(found) == _number(row["default"]), place
    kept = {place.index for place in EPOS2} - LEFT_OUT
    assert {place for place in TABLE if place.index in kept and TABLE[place]["default"]} <= EPOS2.keys()
