"""The EDS file of a drive (CiA 306): its product, and its objects with size, access and range.

`canopen` reads EDS files too, but it refuses maxon's own (a DOMAIN without data type) and checks neither access nor
range. Strings, blocks and numbers of more than four bytes are skipped: labrig needs none.
"""

import re
from collections.abc import Mapping
from configparser import Error as ConfigError
from configparser import RawConfigParser, SectionProxy
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from labrig.devices.canopen_objects import Entry
from labrig.errors import InputError
from labrig.input_file import read_file

_CODES = {0x01: "B", 0x02: "b", 0x03: "h", 0x04: "i", 0x05: "B", 0x06: "H", 0x07: "I"}
"""Data type of CiA 301 -> `code` of an `Entry`: BOOLEAN, INTEGER8 to 32, UNSIGNED8 to 32."""

_ACCESS = {"ro": "ro", "const": "ro", "wo": "wo", "rw": "rw", "rwr": "rw", "rww": "rw"}
_DOMAIN = 2
_LISTS = frozenset({8, 9})
"""Object types that have subindices: ARRAY and RECORD."""

_SECTION = re.compile(r"([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?")
_NODE_ID = re.compile(r"\+?\$nodeid\+?")
_MOST_BYTES = 4_000_000
_LONGEST_NAME = 80

_GET_ANOTHER = "use the manufacturer's EDS file for this drive and firmware"


@dataclass(frozen=True)
class Eds:
    """An EDS file.

    Parameters
    ----------
    source : str
        Its name in messages.
    product_name : str
        The manufacturer's name of the drive.
    vendor, product : int
        Required values of 0x1018:01 and :02 in the drive.
    revision : int or None
        Revision that it was written for, 0x1018:03; None if it states none.
    entries : mapping of Entry to Entry
        Every numeric object, by index and subindex; defaults are without the node id.
    unreadable : mapping of Entry to str
        Objects with a malformed description -> what is wrong with it.
    """

    source: str
    product_name: str
    vendor: int
    product: int
    revision: int | None
    entries: Mapping[Entry, Entry]
    unreadable: Mapping[Entry, str] = field(default_factory=dict)

    def find(self, entry: Entry) -> Entry | None:
        """Return an object as this drive has it; None if it has none there.

        Raises
        ------
        InputError
            When its description is malformed.
        """
        if entry in self.unreadable:
            raise InputError(f"{self.source}: object {entry.place} {self.unreadable[entry]}", _GET_ANOTHER)
        return self.entries.get(entry)


def read_eds(path: Path, folder: Path) -> Eds:
    """Read the EDS file that a rig file in `folder` names.

    Raises
    ------
    InputError
        When it is missing, outside that folder, or not an EDS file.
    """
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{path} leaves the folder of the rig file", "put the EDS file beside the rig file")
    if not path.is_file():
        raise InputError(
            f"{path} does not exist",
            "put the manufacturer's EDS file of the drive there, or correct the name",
        )
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(
            f"{path} has {path.stat().st_size} bytes, an EDS file at most {_MOST_BYTES}", _GET_ANOTHER
        )
    try:
        # CiA 306 requires ASCII; manufacturers use other characters in names.
        return parse_eds(read_file(path, _MOST_BYTES).decode("latin-1"), str(path))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", "check its permissions") from error


@lru_cache(maxsize=8)
def parse_eds(text: str, source: str) -> Eds:
    """Parse the text of an EDS file. Raises `InputError` if it is not one."""
    parser = RawConfigParser(delimiters=("=",), comment_prefixes=(";", "#"), inline_comment_prefixes=(";",))
    try:
        parser.read_string(text.removeprefix("\xef\xbb\xbf"), source)
    except ConfigError as error:
        why = " ".join(str(error).split())[:200]
        raise InputError(f"{source} is not an EDS file: {why}", _GET_ANOTHER) from error
    sections = {name.lower(): parser[name] for name in parser.sections()}
    if "deviceinfo" not in sections:
        raise InputError(f"{source} is not an EDS file: it has no section [DeviceInfo]", _GET_ANOTHER)
    entries: dict[Entry, Entry] = {}
    unreadable: dict[Entry, str] = {}
    for name, section in sections.items():
        found = _SECTION.fullmatch(name)
        if found is not None:
            _add_objects(int(found[1], 16), found[2], section, entries, unreadable)
    info = sections["deviceinfo"]
    return Eds(
        source,
        _strip(info.get("productname", "")) or "unnamed drive",
        _require_identity(info, "VendorNumber", "0x1018:01", source),
        _require_identity(info, "ProductNumber", "0x1018:02", source),
        _parse_number(info.get("revisionnumber", "")),
        entries,
        unreadable,
    )


def _add_objects(
    index: int,
    subindex: str | None,
    section: SectionProxy,
    entries: dict[Entry, Entry],
    unreadable: dict[Entry, str],
) -> None:
    """Add the object that a section describes, or the objects of a compact list."""
    first = Entry(index, int(subindex or "0", 16), "", "B")
    try:
        kind = _require_number(section, "ObjectType", 7)
        count = _require_number(section, "CompactSubObj", 0) if kind in _LISTS else 0
        if kind == _DOMAIN or (kind in _LISTS and not count):
            return
        found = _parse_entry(index, first.subindex, section)
        if not count:
            entries.update({} if found is None else {found: found})
            return
        entries[first] = Entry(index, 0, "number of entries", "B", "ro", min(count, 254))
        for number in range(1, min(count, 254) + 1):
            part = _parse_entry(index, number, section)
            entries.update({} if part is None else {part: part})
    except ValueError as error:
        unreadable[first] = str(error)


def _parse_entry(index: int, subindex: int, section: SectionProxy) -> Entry | None:
    """Return the object that a section describes; None if it is not a number. Raises `ValueError`."""
    code = _CODES.get(_require_number(section, "DataType"))
    if code is None:
        return None
    access = _ACCESS.get(section.get("accesstype", "").strip().lower())
    if access is None:
        raise ValueError(f"has AccessType {_strip(section.get('accesstype', '')) or 'none'}")
    return Entry(
        index,
        subindex,
        _strip(section.get("parametername", "")) or "unnamed",
        code,
        access,
        _decode_sign(_parse_number(section.get("defaultvalue", "")), code) or 0,
        _decode_sign(_parse_number(section.get("lowlimit", "")), code),
        _decode_sign(_parse_number(section.get("highlimit", "")), code),
    )


def _require_number(section: SectionProxy, key: str, default: int | None = None) -> int:
    text = section.get(key.lower(), "").strip()
    number = _parse_number(text)
    if number is None and (text or default is None):
        raise ValueError(f"has {key} {_strip(text) or 'none'}, expected a number")
    return default if number is None and default is not None else number or 0


def _parse_number(text: str) -> int | None:
    """Return a number of an EDS file, without its node id; None if it cannot be read."""
    digits = _NODE_ID.sub("", text.strip().lower().replace(" ", ""))
    try:
        return int(digits, 0)
    except ValueError:
        return int(digits) if digits.isdecimal() else None


def _decode_sign(number: int | None, code: str) -> int | None:
    """Return a number that may be written as the two's complement of a negative one."""
    bits = 8 * Entry(0, 0, "", code).size
    if number is None or code.isupper() or number < 1 << (bits - 1):
        return number
    return number - (1 << bits)


def _require_identity(info: SectionProxy, key: str, place: str, source: str) -> int:
    """Return a number that identifies the drive of the file. Raises `InputError`."""
    number = _parse_number(info.get(key.lower(), ""))
    if number is None:
        raise InputError(
            f"{source} has no {key} in [DeviceInfo], so its drive is unknown",
            f"{_GET_ANOTHER}; the drive reports its own in {place}",
        )
    return number


def _strip(text: str) -> str:
    return "".join(character for character in text.strip() if character.isprintable())[:_LONGEST_NAME]
