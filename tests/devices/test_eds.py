"""Reading EDS files, and the files that are refused."""

from pathlib import Path

import pytest

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
from tests.devices.eds_text import eds_text

OWN = read_own_eds("epos4.eds")


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


def _with_object(lines: str) -> str:
    return eds_text(without=[0x6040]) + f"\n[6040]\nParameterName=x\n{lines}\n"


REFUSED = {
    "no section": ("VendorNumber=1\n", ""),
    "bytes": ("\x7fELF\x00\x01", ""),
    "a YAML file": ("axes:\n  insertion: {}\n", ""),
    "a section twice": ("[DeviceInfo]\n[6040]\nDataType=6\n[6040]\nDataType=7\n", ""),
    "no device": ("[6040]\nDataType=6\nAccessType=rw\n", ""),
    "no vendor": (eds_text(device={"VendorNumber": None}), "VendorNumber"),
    "no product": (eds_text(device={"ProductNumber": ""}), ""),
    "a type that is no number": (_with_object("DataType=six\nAccessType=rw"), "six"),
    "no access": (_with_object("DataType=6"), ""),
    "no type": (_with_object(""), ""),
}


@pytest.mark.parametrize(("text", "words"), REFUSED.values(), ids=REFUSED)
def test_a_file_that_is_not_an_eds_is_refused(text: str, words: str) -> None:
    """Each error has a reason and the file to use; no file is used in part."""
    with pytest.raises(InputError, match=rf"drive\.eds is not an EDS file: .*{words}") as refusal:
        parse_eds(text, "drive.eds")
    assert "EDS file" in refusal.value.hint


def test_a_file_is_read_from_the_folder_of_the_rig_file(tmp_path: Path) -> None:
    """A link that leaves it, a file that is too large and a missing one are refused."""
    folder = tmp_path / "rig"
    folder.mkdir()
    outside = tmp_path / "outside.eds"
    outside.write_text(eds_text())
    (folder / "link.eds").symlink_to(outside)
    (folder / "large.eds").write_bytes(b";" * 4_000_001)
    for name, words in (
        ("link.eds", "leaves the folder of the rig file"),
        ("none.eds", "No such file"),
        (".", "Is a directory"),
        ("large.eds", "4000001 bytes"),
    ):
        with pytest.raises(InputError, match=words):
            read_eds(folder / name, folder)
    (folder / "here.eds").write_text(eds_text())
    assert read_eds(folder / "here.eds", folder).product == OWN.product
