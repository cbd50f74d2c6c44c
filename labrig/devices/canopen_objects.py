"""Objects of any CANopen drive that labrig reads, writes or simulates (CiA 301 and 402): index, type, access, default.

If the standards leave a default or a range to the manufacturer, the value here serves simulated drives only.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

_STRUCTS = {code: struct.Struct("<" + code) for code in "bBhHiI"}
WINDOW_OFF = 0xFFFFFFFF
"""Position window 0x6067 in which target reached means the end of the trajectory, not the position."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One entry of an object dictionary; two are the same where they stand at the same place.

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

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Entry) and (self.index, self.subindex) == (other.index, other.subindex)

    def __hash__(self) -> int:
        return self.index << 8 | self.subindex

    @property
    def place(self) -> str:
        """Return index and subindex as they are written in the specification."""
        return f"0x{self.index:04X}:{self.subindex:02X}"

    @property
    def size(self) -> int:
        """Return the width in bytes."""
        return _STRUCTS[self.code].size

    @property
    def bounds(self) -> tuple[int, int]:
        """Return the lowest and highest value that type and range allow."""
        bits = 8 * self.size
        low, high = (0, 2**bits - 1) if self.code.isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        return (
            low if self.lowest is None else max(low, self.lowest),
            high if self.highest is None else min(high, self.highest),
        )

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
CONSUMER_HEARTBEAT = Entry(0x1016, 1, "consumer heartbeat", "I")
PRODUCER_HEARTBEAT = Entry(0x1017, 0, "producer heartbeat time", "H")
VENDOR_ID = Entry(0x1018, 1, "vendor id", "I", "ro", 0xFB)
PRODUCT_CODE = Entry(0x1018, 2, "product code", "I", "ro", 0x62200000)
REVISION = Entry(0x1018, 3, "revision number", "I", "ro", 0x21220000)
SERIAL_NUMBER = Entry(0x1018, 4, "serial number", "I", "ro")
ABORT_CONNECTION = Entry(0x6007, 0, "abort connection option code", "h", default=1)
CONTROLWORD = Entry(0x6040, 0, "controlword", "H")
STATUSWORD = Entry(0x6041, 0, "statusword", "H", "ro")
SHUTDOWN_OPTION = Entry(0x605B, 0, "shutdown option code", "h")
DISABLE_OPTION = Entry(0x605C, 0, "disable operation option code", "h", default=1)
FAULT_REACTION = Entry(0x605E, 0, "fault reaction option code", "h", default=2)
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
SYNC_ID = Entry(0x1005, 0, "COB-ID SYNC", "I", default=0x80)
GUARD_TIME = Entry(0x100C, 0, "guard time", "H")
LIFE_TIME_FACTOR = Entry(0x100D, 0, "life time factor", "B")
STORE = Entry(0x1010, 1, "store all parameters", "I", default=1)
RESTORE = Entry(0x1011, 1, "restore all default parameters", "I", default=1)
RESTORE_PDO_IDS = Entry(0x1011, 5, "restore default PDO COB-IDs", "I", default=1)
EMERGENCY_ID = Entry(0x1014, 0, "COB-ID EMCY", "I", default=0x80)
CONSUMER_HEARTBEAT_2 = Entry(0x1016, 2, "consumer heartbeat 2", "I")
SDO_REQUEST_ID = Entry(0x1200, 1, "COB-ID SDO client to server", "I", "ro", 0x600)
SDO_RESPONSE_ID = Entry(0x1200, 2, "COB-ID SDO server to client", "I", "ro", 0x580)
ERROR_HISTORY = (LAST_ERROR, *(Entry(0x1003, n, f"error history {n}", "I", "ro") for n in range(2, 6)))
"""Newest first; the code stands in the lower sixteen bits."""
PDO_INVALID = 0x80000000
"""The bit of a COB-ID that switches a PDO or EMCY off."""
RECEIVE_PDO_COB_IDS = tuple(
    Entry(0x1400 + n, 1, f"RxPDO {n + 1} COB-ID", "I", default=0x200 + 0x100 * n) for n in range(4)
)
RPDO_TYPES = tuple(
    Entry(0x1400 + n, 2, f"RxPDO {n + 1} transmission type", "B", default=255) for n in range(4)
)
TRANSMIT_PDO_COB_IDS = tuple(
    Entry(
        0x1800 + n,
        1,
        f"TxPDO {n + 1} COB-ID",
        "I",
        default=0x40000180 + 0x100 * n | (PDO_INVALID if n else 0),
    )
    for n in range(4)
)
TPDO_TYPES = tuple(
    Entry(0x1800 + n, 2, f"TxPDO {n + 1} transmission type", "B", default=255) for n in range(4)
)
TPDO_INHIBITS = tuple(
    Entry(0x1800 + n, 3, f"TxPDO {n + 1} inhibit time [100 us]", "H", default=10) for n in range(4)
)
_RPDO_MAPS = ((0x60400010,), (0x60400010, 0x60600008), (0x60400010, 0x607A0020), (0x60400010, 0x60FF0020))
_TPDO_MAPS = ((0x60410010,), (0x60410010, 0x60610008), (0x60410010, 0x60640020), (0x60410010, 0x606C0020))


def _maps(base: int, name: str, defaults: tuple[tuple[int, ...], ...]) -> tuple[tuple[Entry, ...], ...]:
    """Return, for each PDO, the number of mapped objects and the eight places for them."""
    return tuple(
        (
            Entry(base + n, 0, f"{name} {n + 1} mapped objects", "B", default=len(mapped), highest=8),
            *(
                Entry(base + n, k, f"{name} {n + 1} mapping {k}", "I", default=(*mapped, *[0] * 8)[k - 1])
                for k in range(1, 9)
            ),
        )
        for n, mapped in enumerate(defaults)
    )


RPDO_MAPS = _maps(0x1600, "RxPDO", _RPDO_MAPS)
TPDO_MAPS = _maps(0x1A00, "TxPDO", _TPDO_MAPS)
VELOCITY_SENSOR = Entry(0x6069, 0, "velocity sensor actual", "i", "ro")
VELOCITY_DEMAND = Entry(0x606B, 0, "velocity demand", "i", "ro")
VELOCITY_ACTUAL = Entry(0x606C, 0, "velocity actual", "i", "ro")
CURRENT_ACTUAL = Entry(0x6078, 0, "current actual", "h", "ro")
HOMING_SPEED_SWITCH = Entry(0x6099, 1, "homing speed to switch", "I", default=100, lowest=1, highest=25000)
HOMING_SPEED_INDEX = Entry(0x6099, 2, "homing speed to index", "I", default=10, lowest=1, highest=25000)
HOMING_ACCELERATION = Entry(0x609A, 0, "homing acceleration", "I", default=1000, lowest=1)
MAX_ACCELERATION = Entry(0x60C5, 0, "maximal acceleration", "I", default=0xFFFFFFFF, lowest=1)
TARGET_VELOCITY = Entry(0x60FF, 0, "target velocity", "i")
MOTOR_TYPE = Entry(0x6402, 0, "motor type", "H", default=10)
SUPPORTED_MODES = Entry(0x6502, 0, "supported drive modes", "I", "ro", 0x00000065)


def entries_in(value: object) -> Iterator[Entry]:
    """Yield a value that is an entry, and the entries of one that is a tuple."""
    if isinstance(value, Entry):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from entries_in(part)


STANDARD: tuple[Entry, ...] = tuple(
    entry for value in tuple(globals().values()) for entry in entries_in(value)
)
"""Every entry of this file."""
