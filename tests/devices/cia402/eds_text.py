"""EDS files for tests, made from labrig's own of an EPOS4 by taking objects out, changing them and adding some."""

import re
from collections.abc import Iterable, Mapping
from importlib.resources import files

_TYPES = {"b": 2, "h": 3, "i": 4, "B": 5, "H": 6, "I": 7}
_OWN = files("labrig.devices.drives").joinpath("epos4.eds").read_text("ascii")
_SECTION = re.compile(r"^\[([0-9A-F]{4})(?:sub[0-9A-F]+)?\]\n(?:[^\[\n].*\n|\n)*", re.MULTILINE)


def entry(
    place: str, code: str, access: str = "rw", default: int = 0, low: int | None = None, name: str = "added"
) -> str:
    """Return the section of an object: 6085, or 1018sub1; `code` is its type as in `struct`."""
    lines = [
        f"[{place}]",
        f"ParameterName={name}",
        "ObjectType=0x7",
        f"DataType={_TYPES[code]}",
        f"AccessType={access}",
        f"DefaultValue={default}",
        *([] if low is None else [f"LowLimit={low}"]),
        "",
    ]
    return "\n".join(lines)


RATED_CURRENT = (
    entry("6073", "H", default=2000, name="max current"),
    entry("6075", "I", default=5000, name="motor rated current"),
    entry("6078", "h", "ro", name="current actual value"),
)
"""How a drive of another make tells its current: in thousandths of the rated one."""

HOME = (entry("607C", "i", name="home offset"),)
WINDOW = (entry("6067", "I", default=0xFFFFFFFF), entry("6068", "H"))


def eds_text(*added: str, without: Iterable[int] = (), device: Mapping[str, object] | None = None) -> str:
    """Return the EDS file of an EPOS4 with other members of its device and objects, without those at some indices.

    A member of None is left out. A block without a type is there too, as in maxon's files.
    """
    gone = set(without) | {int(text[1:5], 16) for text in added}
    text = _SECTION.sub(lambda found: "" if int(found[1], 16) in gone else found[0], _OWN)
    for key, value in (device or {}).items():
        text = re.sub(rf"^{key}=.*\n", "" if value is None else f"{key}={value}\n", text, flags=re.MULTILINE)
    block = "[1F50]\nParameterName=Program\nObjectType=0x2\nAccessType=wo\n"
    return "\n".join([text, *added, block])
