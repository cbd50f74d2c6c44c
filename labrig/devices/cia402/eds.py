"""What a drive's EDS file (CiA 306) says: whose it is, and which objects it has, of which size, access and range.

`canopen` reads such files too; it refuses maxon's own (a DOMAIN without data type), and checks no access and no range.
Strings, blocks and numbers of more than four bytes are left out: labrig asks for none.
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

_CODES = {0x01: "B", 0x02: "b", 0x03: "h", 0x04: "i", 0x05: "B", 0x06: "H", 0x07: "I"}
"""Data type of CiA 301 -> width and sign as `Entry` has them: BOOLEAN, INTEGER8 to 32, UNSIGNED8 to 32."""

_ACCESS = {"ro": "ro", "const": "ro", "wo": "wo", "rw": "rw", "rwr": "rw", "rww": "rw"}
_DOMAIN = 2
_LISTS = frozenset({8, 9})
"""Object types that have subindices: ARRAY and RECORD."""

_SECTION = re.compile(r"([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?")
_NODE_ID = re.compile(r"\+?\$nodeid\+?")
_MOST_BYTES = 4_000_000
_LONGEST_NAME = 80

_GET_ANOTHER = "take the EDS file that the drive's manufacturer gives for this drive and firmware"


@dataclass(frozen=True)
class Eds:
    """An EDS file.

    Parameters
    ----------
    source : str
        What messages call it.
    product_name : str
        What the manufacturer calls the drive.
    vendor, product : int
        What the drive has to say in 0x1018:01 and :02.
    revision : int or None
        Revision that it was written for, 0x1018:03; None where it says none.
    entries : mapping of Entry to Entry
        Every numeric object, by its place; defaults are without the node id.
    unreadable : mapping of Entry to str
        Objects whose description makes no sense -> why.
    """

    source: str
    product_name: str
    vendor: int
    product: int
    revision: int | None
    entries: Mapping[Entry, Entry]
    unreadable: Mapping[Entry, str] = field(default_factory=dict)

    def find(self, entry: Entry) -> Entry | None:
        """Return an object as this drive has it; None where it has none at this place.

        Raises
        ------
        InputError
            When its description makes no sense.
        """
        if entry in self.unreadable:
            raise InputError(f"{self.source}: object {entry.place} {self.unreadable[entry]}", _GET_ANOTHER)
        return self.entries.get(entry)


def read_eds(path: Path, folder: Path) -> Eds:
    """Read the EDS file that a rig file in `folder` names.

    Raises
    ------
    InputError
        When it is missing, stands outside of that folder, or is no EDS.
    """
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{path} leaves the folder of the rig file", "put the EDS file beside the rig file")
    if not path.is_file():
        raise InputError(
            f"{path} does not exist",
            "put the EDS file of the drive, from its manufacturer, there; or correct the name",
        )
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(
            f"{path} has {path.stat().st_size} bytes, an EDS file at most {_MOST_BYTES}", _GET_ANOTHER
        )
    try:
        # CiA 306 has ASCII; what manufacturers write beyond it stands in names.
        return parse_eds(path.read_bytes().decode("latin-1"), str(path))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", "check its permissions") from error


@lru_cache(maxsize=8)
def parse_eds(text: str, source: str) -> Eds:
    """Return what the text of an EDS file says. Raises `InputError` when it is none."""
    parser = RawConfigParser(delimiters=("=",), comment_prefixes=(";", "#"), inline_comment_prefixes=(";",))
    try:
        parser.read_string(text.removeprefix("\xef\xbb\xbf"), source)
    except ConfigError as error:
        why = " ".join(str(error).split())[:200]
        raise InputError(f"{source} is no EDS file: {why}", _GET_ANOTHER) from error
    sections = {name.lower(): parser[name] for name in parser.sections()}
    if "deviceinfo" not in sections:
        raise InputError(f"{source} is no EDS file: it has no section [DeviceInfo]", _GET_ANOTHER)
    entries: dict[Entry, Entry] = {}
    unreadable: dict[Entry, str] = {}
    for name, section in sections.items():
        found = _SECTION.fullmatch(name)
        if found is not None:
            _take(int(found[1], 16), found[2], section, entries, unreadable)
    info = sections["deviceinfo"]
    return Eds(
        source,
        _plain(info.get("productname", "")) or "unnamed drive",
        _identity(info, "VendorNumber", "0x1018:01", source),
        _identity(info, "ProductNumber", "0x1018:02", source),
        _number(info.get("revisionnumber", "")),
        entries,
        unreadable,
    )


def _take(
    index: int,
    subindex: str | None,
    section: SectionProxy,
    entries: dict[Entry, Entry],
    unreadable: dict[Entry, str],
) -> None:
    """Take the object that a section describes, or the list of them that a compact one does."""
    first = Entry(index, int(subindex or "0", 16), "", "B")
    try:
        kind = _required(section, "ObjectType", 7)
        count = _required(section, "CompactSubObj", 0) if kind in _LISTS else 0
        if kind == _DOMAIN or (kind in _LISTS and not count):
            return
        found = _entry(index, first.subindex, section)
        if not count:
            entries.update({} if found is None else {found: found})
            return
        entries[first] = Entry(index, 0, "number of entries", "B", "ro", min(count, 254))
        for each in range(1, min(count, 254) + 1):
            part = _entry(index, each, section)
            entries.update({} if part is None else {part: part})
    except ValueError as error:
        unreadable[first] = str(error)


def _entry(index: int, subindex: int, section: SectionProxy) -> Entry | None:
    """Return the object that a section describes; None for one that is no number. Raises `ValueError`."""
    code = _CODES.get(_required(section, "DataType"))
    if code is None:
        return None
    access = _ACCESS.get(section.get("accesstype", "").strip().lower())
    if access is None:
        raise ValueError(f"has AccessType {_plain(section.get('accesstype', '')) or 'none'}")
    return Entry(
        index,
        subindex,
        _plain(section.get("parametername", "")) or "unnamed",
        code,
        access,
        _signed(_number(section.get("defaultvalue", "")), code) or 0,
        _signed(_number(section.get("lowlimit", "")), code),
        _signed(_number(section.get("highlimit", "")), code),
    )


def _required(section: SectionProxy, key: str, default: int | None = None) -> int:
    text = section.get(key.lower(), "").strip()
    number = _number(text)
    if number is None and (text or default is None):
        raise ValueError(f"has {key} {_plain(text) or 'none'}, expected a number")
    return default if number is None and default is not None else number or 0


def _number(text: str) -> int | None:
    """Return a number as an EDS writes it, its node id left out; None where there is none that can be read."""
    digits = _NODE_ID.sub("", text.strip().lower().replace(" ", ""))
    try:
        return int(digits, 0)
    except ValueError:
        return int(digits) if digits.isdecimal() else None


def _signed(number: int | None, code: str) -> int | None:
    """Return a number that may be written as the bits of a negative one."""
    bits = 8 * Entry(0, 0, "", code).size
    if number is None or code.isupper() or number < 1 << (bits - 1):
        return number
    return number - (1 << bits)


def _identity(info: SectionProxy, key: str, place: str, source: str) -> int:
    """Return a number by which the file is told from that of another drive. Raises `InputError`."""
    number = _number(info.get(key.lower(), ""))
    if number is None:
        raise InputError(
            f"{source} does not say {key} in [DeviceInfo], so that nobody can tell whose it is",
            f"{_GET_ANOTHER}; the drive says its own in {place}",
        )
    return number


def _plain(text: str) -> str:
    return "".join(character for character in text.strip() if character.isprintable())[:_LONGEST_NAME]
