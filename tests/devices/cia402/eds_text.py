"""EDS files for tests, written from labrig's own table of what an EPOS4 has."""

from collections.abc import Iterable, Mapping
from itertools import groupby

from labrig.devices.canopen_objects import Entry
from labrig.devices.cia402.epos4 import EPOS4

_TYPES = {"b": 0x02, "h": 0x03, "i": 0x04, "B": 0x05, "H": 0x06, "I": 0x07}
EVERY = tuple(EPOS4.entries)

RATED_CURRENT = (
    Entry(0x6073, 0, "max current", "H", default=2000),
    Entry(0x6075, 0, "motor rated current", "I", default=5000),
    Entry(0x6078, 0, "current actual value", "h", "ro", default=-200),
)
"""How a drive of another make tells its current: in thousandths of the rated one."""


def eds_text(
    entries: Iterable[Entry] = EVERY,
    *,
    without: Iterable[int] = (),
    device: Mapping[str, object] | None = None,
) -> str:
    """Return an EDS file of an EPOS4 with these objects, but for those at the indices of `without`."""
    members: dict[str, object] = {
        "VendorNumber": "0xFB",
        "ProductName": EPOS4.product_name,
        "ProductNumber": "0x61500000",
    }
    members |= {"RevisionNumber": "0x01500000", **(device or {})}
    lines = ["[FileInfo]", "EDSVersion=4.0", "", "[DeviceInfo]"]
    lines += [f"{key}={value}" for key, value in members.items() if value is not None]
    left_out = set(without)
    kept = sorted((e for e in entries if e.index not in left_out), key=lambda e: (e.index, e.subindex))
    for index, group in groupby(kept, key=lambda entry: entry.index):
        objects = list(group)
        if objects[0].subindex or len(objects) > 1:
            lines += ["", f"[{index:04X}]", f"SubNumber={len(objects)}", "ObjectType=0x9"]
            for entry in objects:
                lines += _object(f"{index:04X}sub{entry.subindex:X}", entry)
        else:
            lines += _object(f"{index:04X}", objects[0])
    return "\n".join([*lines, "", "[1F50]", "ParameterName=Program", "ObjectType=0x2", "AccessType=wo", ""])


def _object(section: str, entry: Entry) -> list[str]:
    node = "$NODEID+" if entry.index in {0x1014, 0x1200} or entry.index >> 8 in {0x14, 0x18} else ""
    node = node if entry.code == "I" else ""
    limits = [
        f"{key}={value & (1 << 8 * entry.size) - 1:#x}"
        for key, value in (("LowLimit", entry.lowest), ("HighLimit", entry.highest))
        if value is not None
    ]
    return [
        "",
        f"[{section}]",
        f"ParameterName={entry.name}",
        "ObjectType=0x7",
        f"DataType={_TYPES[entry.code]:#x}",
        f"AccessType={'rww' if entry.access == 'rw' else entry.access}",
        f"DefaultValue={node}{entry.default:#x}",
        *limits,
        "PDOMapping=0",
    ]
