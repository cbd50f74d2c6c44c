"""Reading EDS files, and the files that are refused."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.devices.canopen_objects import Entry
from labrig.devices.cia402.eds import parse_eds, read_eds
from labrig.devices.cia402.epos4 import EPOS4
from labrig.errors import InputError
from tests.devices.cia402.eds_text import eds_text


def _facts(entry: Entry) -> tuple[object, ...]:
    return (entry.index, entry.subindex, entry.name, entry.code, entry.access, entry.default, *entry.bounds)


def test_a_file_written_from_the_table_reads_back_as_the_table() -> None:
    """Index, width, access, default without node id, and range; a DOMAIN without data type is skipped."""
    eds = parse_eds(eds_text(), "drive.eds")
    assert (eds.vendor, eds.product, eds.revision) == (EPOS4.vendor, EPOS4.product, EPOS4.revision)
    assert sorted(map(_facts, eds.entries.values())) == sorted(map(_facts, EPOS4.entries.values()))
    assert eds.unreadable == {}


def test_numbers_are_read_as_manufacturers_write_them() -> None:
    """Two's complement limits, leading zeros, blanks, comments, upper and lower case, compact arrays."""
    text = (
        "; a comment\n[DEVICEINFO]\nvendornumber = 0x2F ; Nanotec\nProductNumber=010\n"
        "[607d]\nObjectType=8\n[607DSub1]\nDataType=0x0004\nAccessType=RW\nLowLimit=0x80000000\nHighLimit=-1\n"
        "[1003]\nParameterName=errors\nObjectType=0x08\nDataType=7\nAccessType=ro\nCompactSubObj=3\n"
        "[1800sub1]\nDataType=7\nAccessType=rw\nDefaultValue=0x180 + $NodeID\n"
        "[1008]\nDataType=9\nAccessType=const\n[6041]\nDataType=6\nAccessType=const\n"
    )
    eds = parse_eds("\xef\xbb\xbf" + text, "odd.eds")
    assert (eds.vendor, eds.product, eds.revision) == (0x2F, 10, None)
    lower = eds.find(Entry(0x607D, 1, "", "I"))
    assert lower is not None
    assert lower.bounds == (-(2**31), -1)
    assert [entry.subindex for entry in eds.entries if entry.index == 0x1003] == [0, 1, 2, 3]
    sent = eds.find(Entry(0x1800, 1, "", "I"))
    assert sent is not None
    assert sent.default == 0x180
    assert eds.find(Entry(0x1008, 0, "", "I")) is None


REFUSED = {
    "no section": ("VendorNumber=1\n", "is not an EDS file"),
    "bytes": ("\x7fELF\x00\x01", "is not an EDS file"),
    "a YAML file": ("axes:\n  insertion: {}\n", "is not an EDS file"),
    "a section twice": ("[DeviceInfo]\n[6040]\nDataType=6\n[6040]\nDataType=7\n", "is not an EDS file"),
    "no device": ("[6040]\nDataType=6\nAccessType=rw\n", "no section [DeviceInfo]"),
    "no vendor": (eds_text(device={"VendorNumber": None}), "has no VendorNumber"),
    "no product": (eds_text(device={"ProductNumber": ""}), "has no ProductNumber"),
}


@pytest.mark.parametrize(("text", "words"), REFUSED.values(), ids=REFUSED)
def test_a_file_that_is_not_an_eds_is_refused(text: str, words: str) -> None:
    """Each error has a reason and the file to use."""
    with pytest.raises(InputError) as refusal:
        parse_eds(text, "drive.eds")
    assert words in refusal.value.message
    assert "drive.eds" in refusal.value.message
    assert "EDS file" in refusal.value.hint


@pytest.mark.parametrize(
    ("line", "words"),
    [("DataType=six", "has DataType six"), ("DataType=6", "has AccessType none"), ("", "has DataType none")],
)
def test_a_malformed_object_is_named_when_it_is_used(line: str, words: str) -> None:
    """A malformed object that labrig does not use is no reason to refuse the file."""
    eds = parse_eds(eds_text(without=[0x6040]) + f"\n[6040]\n{line}\n", "drive.eds")
    assert eds.find(Entry(0x6041, 0, "", "H")) is not None
    with pytest.raises(InputError, match=f"drive.eds: object 0x6040:00 {words}"):
        eds.find(Entry(0x6040, 0, "", "H"))


def test_a_file_is_read_from_the_folder_of_the_rig_file(tmp_path: Path) -> None:
    """A link that leaves it, a file that is too large and a missing one are refused."""
    folder = tmp_path / "rig"
    folder.mkdir()
    outside = tmp_path / "outside.eds"
    outside.write_text(eds_text())
    (folder / "link.eds").symlink_to(outside)
    with pytest.raises(InputError, match="leaves the folder of the rig file"):
        read_eds(folder / "link.eds", folder)
    with pytest.raises(InputError, match="does not exist"):
        read_eds(folder / "none.eds", folder)
    with pytest.raises(InputError, match="does not exist"):
        read_eds(folder / ".", folder)
    (folder / "large.eds").write_bytes(b";" * 4_000_001)
    with pytest.raises(InputError, match="4000001 bytes"):
        read_eds(folder / "large.eds", folder)
    (folder / "here.eds").write_text(eds_text())
    assert read_eds(folder / "here.eds", folder).product == EPOS4.product


@given(st.text(max_size=400) | st.binary(max_size=400).map(lambda data: data.decode("latin-1")))
def test_no_file_ends_in_a_traceback(text: str) -> None:
    """Any content is read or refused."""
    for whole in (text, eds_text(()) + text):
        try:
            parse_eds(whole, "any.eds")
        except InputError:
            continue
