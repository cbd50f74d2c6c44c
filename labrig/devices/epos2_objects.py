"""The objects of an EPOS2 that labrig reads, writes or simulates: index, type, access, default.

Numbers follow maxon's firmware specification of the first EPOS generation (798675-03, April 2010), whose
indices every published EPOS2 driver uses; what the EPOS2 may do differently is checked by reading back after
writing. The simulated drive's object dictionary is made from this table, so that a wrong width shows as a
refusal there.
"""

import struct
from dataclasses import dataclass

_STRUCTS = {code: struct.Struct("<" + code) for code in "bBhHiI"}
WINDOW_OFF = 0xFFFFFFFF
"""Position window 0x6067 in which target reached means the end of the trajectory, not the position."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One entry of the object dictionary; there is one of it for each place, compared by identity.

    Parameters
    ----------
    index, subindex : int
        Where it stands.
    name : str
        What it is, in the words of the specification.
    code : str
        Its width and sign as a character of `struct`: b B h H i I.
    access : str
        "rw", or "ro" for what only the drive changes.
    default : int
        Value after power on.
    lowest, highest : int or None
        Range that the drive accepts, where it is narrower than the type.
    """

    index: int
    subindex: int
    name: str
    code: str
    access: str = "rw"
    default: int = 0
    lowest: int | None = None
    highest: int | None = None

    @property
    def place(self) -> str:
        """Return index and subindex as they are written in the specification."""
        return f"0x{self.index:04X}:{self.subindex:02X}"

    @property
    def size(self) -> int:
        """Return the width in bytes."""
        return _STRUCTS[self.code].size

    def pack(self, value: int) -> bytes:
        """Return the bytes of `value`; raises struct.error when it does not fit."""
        return _STRUCTS[self.code].pack(value)

    def unpack(self, data: bytes) -> int:
        """Return the value of `data`; bytes beyond the width are padding."""
        return int(_STRUCTS[self.code].unpack_from(data)[0])


DEVICE_TYPE = Entry(0x1000, 0, "device type", "I", "ro", 0x00020192)
ERROR_REGISTER = Entry(0x1001, 0, "error register", "B", "ro")
ERROR_COUNT = Entry(0x1003, 0, "number of errors", "B", highest=0)
LAST_ERROR = Entry(0x1003, 1, "error history 1", "I", "ro")
VENDOR_ID = Entry(0x1018, 1, "vendor id", "I", "ro", 0xFB)
PRODUCT_CODE = Entry(0x1018, 2, "product code", "I", "ro", 0x62200000)
REVISION = Entry(0x1018, 3, "revision number", "I", "ro", 0x21100000)
SERIAL_NUMBER = Entry(0x1018, 4, "serial number", "I", "ro")
SOFTWARE_VERSION = Entry(0x2003, 1, "software version", "H", "ro", 0x2110)
HARDWARE_VERSION = Entry(0x2003, 2, "hardware version", "H", "ro", 0x6220)
HOME_POSITION = Entry(0x2081, 0, "home position", "i")
ENCODER_PULSES = Entry(0x2210, 1, "encoder pulses per turn", "H", default=500)
CONTROLWORD = Entry(0x6040, 0, "controlword", "H")
STATUSWORD = Entry(0x6041, 0, "statusword", "H", "ro")
MODE = Entry(0x6060, 0, "mode of operation", "b", default=1, lowest=-6, highest=7)
MODE_DISPLAY = Entry(0x6061, 0, "mode of operation display", "b", "ro", 1)
POSITION_DEMAND = Entry(0x6062, 0, "position demand", "i", "ro")
POSITION_ACTUAL = Entry(0x6064, 0, "position actual", "i", "ro")
MAX_FOLLOWING_ERROR = Entry(0x6065, 0, "maximal following error", "I", default=2000)
POSITION_WINDOW = Entry(0x6067, 0, "position window", "I", default=WINDOW_OFF)
POSITION_WINDOW_TIME = Entry(0x6068, 0, "position window time", "H")
TARGET_POSITION = Entry(0x607A, 0, "target position", "i")
HOME_OFFSET = Entry(0x607C, 0, "home offset", "i")
LOWER_LIMIT = Entry(0x607D, 1, "minimal position limit", "i", default=-(2**31))
UPPER_LIMIT = Entry(0x607D, 2, "maximal position limit", "i", default=2**31 - 1)
MAX_PROFILE_VELOCITY = Entry(0x607F, 0, "maximal profile velocity", "I", default=25000, highest=25000)
PROFILE_VELOCITY = Entry(0x6081, 0, "profile velocity", "I", default=1000, lowest=1, highest=25000)
PROFILE_ACCELERATION = Entry(0x6083, 0, "profile acceleration", "I", default=10000, lowest=1)
PROFILE_DECELERATION = Entry(0x6084, 0, "profile deceleration", "I", default=10000, lowest=1)
QUICK_STOP_DECELERATION = Entry(0x6085, 0, "quick stop deceleration", "I", default=10000, lowest=1)
PROFILE_TYPE = Entry(0x6086, 0, "motion profile type", "h", highest=1)
HOMING_METHOD = Entry(0x6098, 0, "homing method", "b", default=7, lowest=-4, highest=35)

NUMBERS: tuple[Entry, ...] = tuple(value for value in tuple(globals().values()) if isinstance(value, Entry))
"""Every numeric entry."""

DEVICE_NAME = (0x1008, 0)
"""Index and subindex of the device's name, a string and so not an `Entry`."""

EPOS2_HARDWARE = {
    0x6120: "EPOS2 Module 36/2",
    0x6220: "EPOS2 24/5",
    0x6320: "EPOS2 50/5",
    0x6420: "EPOS2 70/10",
}
OTHER_HARDWARE = {0x6010: "EPOS 24/1", 0x6210: "EPOS 24/5", 0x6410: "EPOS 70/10", 0x6610: "EPOS MCD"}
"""Hardware version 0x2003:02 without its last digit -> name (libcanepos)."""
