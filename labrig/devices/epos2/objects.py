"""The objects of an EPOS2 that are in no standard: index, type, access, range, default.

Index, type and access, and range and default where it states them, are those of maxon's EDS file of the EPOS2 70/10
with software 0x2122 (March 2011). The other ranges follow maxon's firmware specification of the first EPOS generation
(798675-03, April 2010). Reading back after writing shows whether a drive differs. The object dictionary of the
simulated drive is made from this table and the standard one; it refuses a wrong width.
"""

from labrig.devices.canopen_objects import STANDARD, Entry, entries_in

CONFIGURATION_DATE = Entry(0x1020, 1, "verify configuration: date", "I")
CONFIGURATION_TIME = Entry(0x1020, 2, "verify configuration: time", "I")
SOFTWARE_VERSION = Entry(0x2003, 1, "software version", "H", "ro", 0x2122)
HARDWARE_VERSION = Entry(0x2003, 2, "hardware version", "H", "ro", 0x6220)
VERSIONS = (
    Entry(0x2003, 3, "application number", "H", "ro"),
    Entry(0x2003, 4, "application version", "H", "ro"),
    Entry(0x2003, 5, "base sector version", "H", "ro"),
)
LIMIT_EXECUTION_MASK = Entry(0x2071, 4, "digital input execution mask", "H", default=0x0008)
CURRENT_THRESHOLD = Entry(0x2080, 0, "current threshold homing", "H", default=500)
HOME_POSITION = Entry(0x2081, 0, "home position", "i")
ENCODER_PULSES = Entry(0x2210, 1, "encoder pulses per turn", "I", default=500, lowest=16, highest=2_500_000)
NODE_ID = Entry(0x2000, 0, "node id", "B", default=1, lowest=1, highest=127)
CAN_BITRATE = Entry(0x2001, 0, "CAN bit rate", "H", highest=7)
MISCELLANEOUS = Entry(0x2008, 0, "miscellaneous configuration", "H")
ENCODER_COUNTER = Entry(0x2020, 0, "encoder counter", "I", "ro")
CURRENT_AVERAGE = Entry(0x2027, 0, "current, averaged", "h", "ro")
VELOCITY_AVERAGE = Entry(0x2028, 0, "velocity, averaged", "i", "ro")
INPUTS = tuple(
    Entry(0x2070, n, f"configuration of digital input {n}", "H", default=kind, highest=15)
    for n, kind in enumerate((15, 14, 13, 2, 1, 0, 9, 8, 7), start=1)
)
INPUT_STATE = Entry(0x2071, 1, "digital inputs, state", "H", "ro")
INPUT_MASK = Entry(0x2071, 2, "digital inputs, mask", "H", default=0xE387)
INPUT_POLARITY = Entry(0x2071, 3, "digital inputs, polarity", "H")
ANALOG_INPUTS = tuple(Entry(0x207C, n, f"analog input {n} [mV]", "h", "ro") for n in (1, 2))
FOLLOWING_ERROR_ACTUAL = Entry(0x20F4, 0, "following error actual", "h", "ro")
SENSOR_TYPE = Entry(0x2210, 2, "position sensor type", "H", default=1)
POSITION_OFFSET = Entry(0x2210, 3, "absolute position offset", "H")
SENSOR_POLARITY = Entry(0x2210, 4, "position sensor polarity", "H", highest=3)
POSITION_NOTATION = Entry(0x6089, 0, "position notation index", "b", lowest=0, highest=0)
CURRENT_SETTING = Entry(0x2030, 0, "current mode setting value", "h")
POSITION_SETTING = Entry(0x2062, 0, "position mode setting value", "i")
VELOCITY_SETTING = Entry(0x206B, 0, "velocity mode setting value", "i")
CURRENT_GAINS = (
    Entry(0x60F6, 1, "current P-gain", "h", default=300),
    Entry(0x60F6, 2, "current I-gain", "h", default=100),
)
VELOCITY_GAINS = (
    Entry(0x60F9, 1, "velocity P-gain", "h", default=1000),
    Entry(0x60F9, 2, "velocity I-gain", "h", default=100),
    Entry(0x60F9, 4, "velocity feed-forward of the velocity controller", "H"),
    Entry(0x60F9, 5, "acceleration feed-forward of the velocity controller", "H"),
)
POSITION_GAINS = (
    Entry(0x60FB, 1, "position P-gain", "h", default=150),
    Entry(0x60FB, 2, "position I-gain", "h", default=10),
    Entry(0x60FB, 3, "position D-gain", "h", default=200),
    Entry(0x60FB, 4, "velocity feed-forward of the position controller", "H"),
    Entry(0x60FB, 5, "acceleration feed-forward of the position controller", "H"),
)
CONTINUOUS_CURRENT = Entry(0x6410, 1, "continuous current limit", "H", default=5000, highest=5000)
POLE_PAIRS = Entry(0x6410, 3, "pole pairs", "B", default=1, lowest=1)
MAX_MOTOR_SPEED = Entry(0x6410, 4, "maximal motor speed", "I", default=25000, lowest=1)
THERMAL_TIME = Entry(
    0x6410, 5, "thermal time constant of the winding", "H", default=40, lowest=1, highest=5400
)
MAX_CURRENT = Entry(0x6410, 2, "output current limit", "H", default=10000, highest=10000)
NUMBERS: tuple[Entry, ...] = tuple(
    {
        entry.place: entry for value in (STANDARD, *tuple(globals().values())) for entry in entries_in(value)
    }.values()
)
"""Every numeric entry, including those of the standards."""

EPOS2_HARDWARE = {
    0x6120: "EPOS2 Module 36/2",
    0x6220: "EPOS2 24/5",
    0x6320: "EPOS2 50/5",
    0x6420: "EPOS2 70/10",
}
OTHER_HARDWARE = {0x6010: "EPOS 24/1", 0x6210: "EPOS 24/5", 0x6410: "EPOS 70/10", 0x6610: "EPOS MCD"}
"""Hardware version 0x2003:02 without its last digit -> name (libcanepos, and maxon's EDS file of the EPOS2 70/10)."""

EPOS2_SOFTWARE = range(0x2100, 0x2200)
"""Software versions 0x2003:01 of an EPOS2; those of the first EPOS generation begin with 0x20."""

TRIED_SOFTWARE = frozenset({0x2110, 0x2122})
"""Versions whose objects are known: by the driver of IRI (CEpos2), and by maxon's EDS file."""
