"""The EDS file of a drive (CiA 306), read by `canopen`: its product, and its objects with type, access and range.

Strings, blocks and numbers of more than four bytes are left out: labrig needs none.
"""

from collections.abc import Iterable, Iterator, Mapping
from configparser import RawConfigParser
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from io import StringIO
from pathlib import Path
from struct import Struct

from canopen.objectdictionary import ObjectDictionary, ODVariable, datatypes, import_od

from labrig.devices.drives.objects import Place
from labrig.errors import InputError
from labrig.input_file import read_file

_NUMBERS = frozenset({datatypes.BOOLEAN, datatypes.INTEGER8, datatypes.INTEGER16, datatypes.INTEGER32})
_NUMBERS |= {datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32}
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
    objects : mapping of Place to ODVariable
        Every number of at most four bytes; defaults are without the node id.
    """

    source: str
    product_name: str
    vendor: int
    product: int
    revision: int | None
    objects: Mapping[Place, ODVariable]


def count_bytes(variable: ODVariable) -> int:
    """Return the width of an object."""
    return len(variable) // 8


def make_form(variables: Iterable[ODVariable]) -> Struct:
    """Return the form in which a PDO carries objects."""
    codes = (each.STRUCT_TYPES[each.data_type or datatypes.UNSIGNED8].format[-1:] for each in variables)
    return Struct("<" + "".join(codes))


def find_bounds(variable: ODVariable) -> tuple[int, int]:
    """Return the lowest and highest value that type and range of an object allow."""
    bits, signed = len(variable), variable.data_type in datatypes.SIGNED_TYPES
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    return (
        low if variable.min is None else max(low, variable.min),
        high if variable.max is None else min(high, variable.max),
    )


def find_default(variable: ODVariable) -> int:
    """Return the value after power on, without the node id; it may be written as two's complement."""
    low, high = find_bounds(variable)
    value = variable.default or 0
    return value - (1 << len(variable)) if value > high and low < 0 else value


def read_own_eds(name: str) -> Eds:
    """Return an EDS file that labrig brings."""
    return parse_eds(files("labrig.devices.drives").joinpath(name).read_text("ascii"), name)


def read_eds(path: Path, folder: Path) -> Eds:
    """Read the EDS file that a rig file in `folder` names.

    Raises
    ------
    InputError
        When it is missing, outside that folder, or not an EDS file.
    """
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{path} leaves the folder of the rig file", "put the EDS file beside the rig file")
    try:
        # CiA 306 requires ASCII; manufacturers use other characters in names.
        return parse_eds(read_file(path, _MOST_BYTES).decode("latin-1"), str(path))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", _GET_ANOTHER) from error


@lru_cache(maxsize=8)
def parse_eds(text: str, source: str) -> Eds:
    """Parse the text of an EDS file. Raises `InputError` if it is not one."""
    try:
        parser = _parse_sections(text.removeprefix("\xef\xbb\xbf"))
        info = {key: int(parser["DeviceInfo"][key], 0) for key in ("VendorNumber", "ProductNumber")}
        found = _import(parser)
        objects = {Place(each.index, each.subindex): each for each in _list_numbers(found)}
    except Exception as error:
        why = " ".join(str(error).split())[:200]
        raise InputError(
            f"{source} is not an EDS file: {type(error).__name__}: {why}", _GET_ANOTHER
        ) from error
    device = found.device_information
    name = "".join(filter(str.isprintable, device.product_name or ""))[:_LONGEST_NAME]
    return Eds(
        source,
        name or "unnamed drive",
        info["VendorNumber"],
        info["ProductNumber"],
        device.revision_number,
        objects,
    )


def _parse_sections(text: str) -> RawConfigParser:
    parser = RawConfigParser(inline_comment_prefixes=(";",))
    parser.optionxform = str  # type: ignore[assignment, method-assign] # keys keep their case, as canopen wants them
    parser.read_string(text)
    return parser


def _import(parser: RawConfigParser) -> ObjectDictionary:
    """Return the object dictionary; a block without a type, as maxon's files have them, is one of type DOMAIN."""
    for name in parser.sections():
        section = parser[name]
        if section.get("ObjectType", "").strip() in {"2", "0x2", "0x02"} and not section.get("DataType"):
            section["DataType"] = f"{datatypes.DOMAIN:#x}"
    text = StringIO()
    parser.write(text)
    text.seek(0)
    text.name = ".eds"  # tells canopen the format
    return import_od(text, node_id=0)


def _list_numbers(found: ObjectDictionary) -> Iterator[ODVariable]:
    for item in found.values():
        members = [item] if isinstance(item, ODVariable) else item.values()
        yield from (variable for variable in members if variable.data_type in _NUMBERS)
