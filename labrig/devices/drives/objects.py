"""The objects of CiA 301 and 402 that labrig uses, by their places; a drive's EDS file has their types and ranges."""

from typing import NamedTuple


class Place(NamedTuple):
    """Index and subindex of an object; written as 0x607D:01."""

    index: int  # type: ignore[assignment] # hides a method of tuples that nobody calls
    subindex: int = 0

    def __str__(self) -> str:
        """Return it as manuals write it."""
        return f"0x{self.index:04X}:{self.subindex:02X}"


PDO_INVALID, NO_REMOTE = 0x80000000, 0x40000000
"""Bits of a COB-ID: the PDO is switched off; it cannot be requested."""

WINDOW_OFF = 0xFFFFFFFF
"""Position window 0x6067 in which target reached means the end of the trajectory, not the position."""

DEVICE_TYPE = Place(0x1000)
ERROR_REGISTER = Place(0x1001)
ERROR_COUNT = Place(0x1003)
LAST_ERROR = Place(0x1003, 1)
CONSUMER_HEARTBEAT = Place(0x1016, 1)
PRODUCER_HEARTBEAT = Place(0x1017)
VENDOR_ID, PRODUCT_CODE, REVISION, SERIAL_NUMBER = (Place(0x1018, n) for n in range(1, 5))
REPORT = 2
"""The transmit PDO of labrig's report, counted from 0: it has statusword and position by default."""

TRANSMIT_PDO_COB_IDS = tuple(Place(0x1800 + n, 1) for n in range(4))
REPORT_COB_ID = TRANSMIT_PDO_COB_IDS[REPORT]
TPDO_TYPES = tuple(Place(0x1800 + n, 2) for n in range(4))
TPDO_MAPS = tuple(tuple(Place(0x1A00 + n, k) for k in range(9)) for n in range(4))
ABORT_CONNECTION = Place(0x6007)
ERROR_CODE = Place(0x603F)
CONTROLWORD = Place(0x6040)
STATUSWORD = Place(0x6041)
QUICK_STOP_OPTION = Place(0x605A)
SHUTDOWN_OPTION = Place(0x605B)
DISABLE_OPTION = Place(0x605C)
HALT_OPTION = Place(0x605D)
FAULT_REACTION = Place(0x605E)
MODE = Place(0x6060)
MODE_DISPLAY = Place(0x6061)
POSITION_ACTUAL = Place(0x6064)
MAX_FOLLOWING_ERROR = Place(0x6065)
FOLLOWING_ERROR_TIMEOUT = Place(0x6066)
POSITION_WINDOW = Place(0x6067)
POSITION_WINDOW_TIME = Place(0x6068)
MAX_CURRENT = Place(0x6073)
RATED_CURRENT = Place(0x6075)
TORQUE_ACTUAL = Place(0x6077)
CURRENT_ACTUAL = Place(0x6078)
TARGET_POSITION = Place(0x607A)
HOME_OFFSET = Place(0x607C)
LOWER_LIMIT, UPPER_LIMIT = Place(0x607D, 1), Place(0x607D, 2)
MAX_PROFILE_VELOCITY = Place(0x607F)
PROFILE_VELOCITY = Place(0x6081)
PROFILE_ACCELERATION = Place(0x6083)
PROFILE_DECELERATION = Place(0x6084)
QUICK_STOP_DECELERATION = Place(0x6085)
PROFILE_TYPE = Place(0x6086)
HOMING_METHOD = Place(0x6098)
HOMING_SPEED_SWITCH, HOMING_SPEED_INDEX = Place(0x6099, 1), Place(0x6099, 2)
HOMING_ACCELERATION = Place(0x609A)
VELOCITY_UNIT = Place(0x60A9)
ACCELERATION_UNIT = Place(0x60AA)
MAX_ACCELERATION = Place(0x60C5)
FOLLOWING_ERROR = Place(0x60F4)
DIGITAL_INPUTS = Place(0x60FD)

PROFILE_POSITION, HOMING = 1, 6
"""Modes of operation."""
