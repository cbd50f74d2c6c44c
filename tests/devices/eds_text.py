"""EDS files made from labrig's own of an EPOS4 by taking out, changing and adding objects; sections that name them."""

import re
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path

from labrig.devices.drives.generic import DRIVE, Cia402Axis

_TYPES = {"b": 2, "h": 3, "i": 4, "B": 5, "H": 6, "I": 7}
_OWN = files("labrig.devices.drives").joinpath("epos4.eds").read_text("ascii")
_SECTION = re.compile(r"^\[([0-9A-F]{4})(?:sub[0-9A-F]+)?\]\n(?:[^\[\n].*\n|\n)*", re.MULTILINE)


def entry(
    place: str, code: str, access: str = "rw", default: int = 0, low: int | None = None, name: str = "added"
) -> str:
    """Return the section of an object: 6085, or 1018sub1; `code` is its type as in `struct`."""
    lines = f"ParameterName={name} ObjectType=0x7 DataType={_TYPES[code]} AccessType={access} DefaultValue={default}"
    bound = "" if low is None else f" LowLimit={low}"
    return "\n".join([f"[{place}]", *f"{lines}{bound}".split(), ""])


RATED_CURRENT = (
    entry("6073", "H", default=2000, name="max_current"),
    entry("6075", "I", default=5000, name="rated_current"),
    entry("6078", "h", "ro", name="current"),
)
"""How a drive of another make tells its current: in thousandths of the rated one."""

HOME = (entry("607C", "i", name="home_offset"),)
WINDOW = (entry("6067", "I", default=0xFFFFFFFF), entry("6068", "H"))


def eds_text(*added: str, without: Iterable[int] = (), device: Mapping[str, object] | None = None) -> str:
    """Return the EDS file of an EPOS4 with other members of its device and objects, without those at some indices.

    A member of None is left out. A block without a type is there too, as in maxon's files.
    """
    gone = set(without) | {int(text[1:5], 16) for text in added}
    text = _SECTION.sub(lambda found: "" if int(found[1], 16) in gone else found[0], _OWN)
    for key, value in (device or {}).items():
        text = re.sub(rf"^{key}=.*\n", "" if value is None else f"{key}={value}\n", text, flags=re.MULTILINE)
    return "\n".join([text, *added, "[1F50]\nParameterName=Program\nObjectType=0x2\nAccessType=wo\n"])


_OF_MAXON = (0x3000, 0x3001, 0x30B0, 0x30B1, 0x30D1, 0x603F, 0x60A8, 0x60A9, 0x60AA)


def section_of(folder: Path, text: str | None = None, **changes: object) -> Cia402Axis:
    """Return the example section with an EDS file of its own in `folder`, and with changes."""
    (folder / "drive.eds").write_text(eds_text() if text is None else text, encoding="ascii")
    values = DRIVE.example(1).model_dump() | {"eds": "drive.eds"} | changes
    return Cia402Axis.model_validate(values, strict=False).placed_in(folder)


def other_make(folder: Path) -> Cia402Axis:
    """Return the section of a drive of another make: the profile's own objects, and none of maxon's."""
    device = {"VendorNumber": "0x2F", "ProductName": "a drive of another make", "ProductNumber": 7}
    return section_of(
        folder,
        eds_text(*RATED_CURRENT, *HOME, *WINDOW, without=_OF_MAXON, device=device),
        velocity_unit="counts/s",
        acceleration_unit="counts/s^2",
        quick_stop_option=2,
        home_here_method=35,
        referenced_bit=None,
        objects={"home_position": "0x607C:00"},
    )
