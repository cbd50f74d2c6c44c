"""The objects of a maxon EPOS4 Module 50/5, software 0x0150, from which simulated drives are made.

This is our own table of index, type, access, default and range, as maxon's EDS file of December 2018 states them, for
the objects that labrig, motion and process data use. An EPOS4 has no 0x6067, 0x6068, 0x6078, 0x607C, 0x1020, 0x100C.
"""

from collections.abc import Iterator

from labrig.devices.canopen_objects import PDO_INVALID, Entry
from labrig.devices.cia402.eds import Eds

_WITHOUT_REMOTE = 0x40000000
_MAPPED_OBJECTS = 12
_RECEIVE_MAPS = ((0x60400010,), (0x60400010, 0x60600008), (0x60400010, 0x607A0020), (0x60400010, 0x60FF0020))
_TRANSMIT_MAPS = ((0x60410010,), (0x60410010, 0x60610008), (0x60410010, 0x60640020), (0x60410010, 0x606C0020))


def _process_data() -> Iterator[Entry]:
    for n, (received, sent) in enumerate(zip(_RECEIVE_MAPS, _TRANSMIT_MAPS, strict=True)):
        number = n + 1
        yield Entry(0x1400 + n, 1, f"RxPDO {number} COB-ID", "I", default=0x200 + 0x100 * n)
        yield Entry(0x1400 + n, 2, f"RxPDO {number} transmission type", "B", default=255)
        off = PDO_INVALID if n else 0
        cob_id = off | _WITHOUT_REMOTE | 0x180 + 0x100 * n
        yield Entry(0x1800 + n, 1, f"TxPDO {number} COB-ID", "I", default=cob_id)
        yield Entry(0x1800 + n, 2, f"TxPDO {number} transmission type", "B", default=255)
        yield Entry(0x1800 + n, 3, f"TxPDO {number} inhibit time [100 us]", "H", default=10)
        yield from _mapping(0x1600 + n, f"RxPDO {number}", received)
        yield from _mapping(0x1A00 + n, f"TxPDO {number}", sent)


def _mapping(index: int, name: str, mapped: tuple[int, ...]) -> Iterator[Entry]:
    yield Entry(index, 0, f"{name} mapped objects", "B", default=len(mapped), highest=_MAPPED_OBJECTS)
    for k in range(_MAPPED_OBJECTS):
        yield Entry(index, k + 1, f"{name} mapping {k + 1}", "I", default=mapped[k] if k < len(mapped) else 0)


_OBJECTS = (
    Entry(0x1000, 0, "device type", "I", "ro"),
    Entry(0x1001, 0, "error register", "B", "ro"),
    Entry(0x1003, 0, "number of errors", "B"),
    *(Entry(0x1003, n, f"error history {n}", "I", "ro") for n in range(1, 6)),
    Entry(0x1005, 0, "COB-ID SYNC", "I", "ro", 0x80, 0x80, 0x80),
    Entry(0x1010, 1, "store all parameters", "I", default=1),
    Entry(0x1011, 1, "restore all default parameters", "I", default=1),
    Entry(0x1014, 0, "COB-ID EMCY", "I", "ro", 0x80),
    Entry(0x1016, 1, "consumer heartbeat", "I"),
    Entry(0x1016, 2, "consumer heartbeat 2", "I"),
    Entry(0x1017, 0, "producer heartbeat time", "H"),
    *(Entry(0x1018, n, name, "I", "ro") for n, name in enumerate(("vendor id", "product code"), start=1)),
    *(Entry(0x1018, n, name, "I", "ro") for n, name in enumerate(("revision", "serial number"), start=3)),
    Entry(0x1200, 1, "COB-ID SDO client to server", "I", "ro", 0x600),
    Entry(0x1200, 2, "COB-ID SDO server to client", "I", "ro", 0x580),
    Entry(0x2000, 0, "node id", "B", default=1),
    Entry(0x3000, 5, "main sensor resolution", "I", "ro"),
    Entry(0x3001, 1, "nominal current [mA]", "I", default=5000, lowest=0, highest=5000),
    Entry(0x3001, 2, "output current limit [mA]", "I", default=15000, lowest=0, highest=15000),
    Entry(0x30B0, 0, "home position", "i"),
    Entry(0x30B1, 0, "home offset move distance", "i"),
    Entry(0x30D1, 1, "current actual value averaged [mA]", "i", "ro"),
    Entry(0x30D1, 2, "current actual value [mA]", "i", "ro"),
    Entry(0x3160, 1, "analog input 1 [mV]", "h", "ro"),
    Entry(0x3160, 2, "analog input 2 [mV]", "h", "ro"),
    Entry(0x6007, 0, "abort connection option code", "h", default=3),
    Entry(0x603F, 0, "error code", "H", "ro"),
    Entry(0x6040, 0, "controlword", "H"),
    Entry(0x6041, 0, "statusword", "H", "ro"),
    Entry(0x605A, 0, "quick stop option code", "h", default=6),
    Entry(0x605B, 0, "shutdown option code", "h"),
    Entry(0x605C, 0, "disable operation option code", "h", default=1),
    Entry(0x605E, 0, "fault reaction option code", "h", default=2),
    Entry(0x6060, 0, "mode of operation", "b", default=1),
    Entry(0x6061, 0, "mode of operation display", "b", "ro"),
    Entry(0x6062, 0, "position demand", "i", "ro"),
    Entry(0x6064, 0, "position actual", "i", "ro"),
    Entry(0x6065, 0, "following error window", "I", default=2000),
    Entry(0x6066, 0, "following error timeout", "H", lowest=0, highest=0),
    Entry(0x606B, 0, "velocity demand", "i", "ro"),
    Entry(0x606C, 0, "velocity actual", "i", "ro"),
    Entry(0x607A, 0, "target position", "i"),
    Entry(0x607D, 1, "minimal position limit", "i"),
    Entry(0x607D, 2, "maximal position limit", "i"),
    Entry(0x607F, 0, "maximal profile velocity", "I", default=50000),
    Entry(0x6080, 0, "maximal motor speed", "I", default=50000),
    Entry(0x6081, 0, "profile velocity", "I", default=1000),
    Entry(0x6083, 0, "profile acceleration", "I", default=10000, lowest=1),
    Entry(0x6084, 0, "profile deceleration", "I", default=10000, lowest=1),
    Entry(0x6085, 0, "quick stop deceleration", "I", default=10000, lowest=1),
    Entry(0x6086, 0, "motion profile type", "h"),
    Entry(0x6098, 0, "homing method", "b", default=7),
    Entry(0x6099, 1, "homing speed to switch", "I", default=100),
    Entry(0x6099, 2, "homing speed to index", "I", default=10),
    Entry(0x609A, 0, "homing acceleration", "I", default=1000, lowest=1),
    Entry(0x60A8, 0, "SI unit of position", "I", default=0x00B50000, lowest=0x00B50000, highest=0x00B50000),
    Entry(0x60A9, 0, "SI unit of velocity", "I", default=0x00B44700),
    Entry(
        0x60AA, 0, "SI unit of acceleration", "I", default=0x00C00300, lowest=0x00C00300, highest=0x00C00300
    ),
    Entry(0x60C5, 0, "maximal acceleration", "I", default=0xFFFFFFFF, lowest=1),
    Entry(0x60F4, 0, "following error actual", "i", "ro"),
    Entry(0x60FD, 0, "digital inputs", "I", "ro"),
    Entry(0x60FF, 0, "target velocity", "i"),
    Entry(0x6402, 0, "motor type", "H", default=10),
    Entry(0x6502, 0, "supported drive modes", "I", "ro"),
    *_process_data(),
)

EPOS4 = Eds(
    "the EPOS4 that labrig knows",
    "EPOS4 Module 50/5",
    vendor=0xFB,
    product=0x61500000,
    revision=0x01500000,
    entries={entry: entry for entry in _OBJECTS},
)
