"""The driver `epos2`: maxon EPOS2 over CANopen.

What is decided here
--------------------
- The encoder resolution is compared with the rig file and never written.
- An EPOS2 of an unknown type is refused with its hardware version, unless the rig file names this version: those of the
  24/2 and of others are not published. Its software version still has to be that of an EPOS2.
- A type shows in the product code, whose upper half is the hardware version; a generation in the revision.
- Uncertain until tried on a device: whether 0x2210:01 holds the encoder resolution on every EPOS2; whether the measure
  init state may show bit 14; whether TxPDO 3 carries statusword and position by default and can be switched on while
  the node is operational (if not, SDO does all of it); which objects clear 0x1020 when they are written (it is written
  back after each one that labrig writes); which function each bit of 0x2071:01 has; whether 0x6007 is 1 as it comes,
  and can be written like the COB-IDs of the PDOs while the node is operational (if not, opening says which object to
  set and save in EPOS Studio).
- An EPOS2 has no quick stop option code 0x605A: its quick stop always brakes and holds.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import read_own_eds
from labrig.devices.drives.model import Model, Stated
from labrig.devices.drives.objects import Place

TYPES = {
    0x62200000: "EPOS2 24/5",
    0x61200000: "EPOS2 Module 36/2",
    0x63200000: "EPOS2 50/5",
    0x64200000: "EPOS2 70/10",
}
"""Product code without the last digit of the hardware version -> name (libcanepos, and maxon's EDS file)."""

_REVISIONS = range(0x21000000, 0x22000000)
"""Software versions of an EPOS2, in the upper half; those of the first EPOS generation begin with 0x20."""

_EXECUTION_MASK, _EXECUTION_DEFAULT = Place(0x2071, 4), 0x0008
_SWITCH_BITS = {"negative": 1, "positive": 2}
_LINES = Place(0x2210, 1)
_COUNTS_PER_LINE = 4

_INPUTS = ("negative-limit", "positive-limit", "home", "position-marker", "drive-enable")

Word = Annotated[int, Field(ge=0, lt=2**32)]


class Epos2Axis(AxisDescription):
    """One axis with an EPOS2 of maxon. Lengths are mm, or rad where `unit` is rad.

    `homing_directions` are as maxon defines them: -1 and -3 go in the POSITIVE direction until the current threshold.
    `canopen` has the opposite sign, which would drive an axis the wrong way.
    """

    homing_directions: ClassVar[Mapping[int, int]] = {
        **AxisDescription.homing_directions,
        -1: +1,
        -2: -1,
        -3: +1,
        -4: -1,
    }
    digital_inputs: ClassVar[Mapping[str, int]] = {
        **{name: bit for bit, name in enumerate(_INPUTS)},
        **{f"general-{letter}": bit for bit, letter in enumerate("HGFEDCBA", start=8)},
    }
    """Name of a digital input -> its bit in 0x2071:01, which is its number in 0x2070 (maxon's EposCmd: A is 15)."""

    driver: Literal["epos2"] = "epos2"
    """Kind of drive."""
    hardware_version: Annotated[int, Field(ge=0, lt=2**16)] | None = None
    """Hardware version (0x2003:02) of an EPOS2 whose type labrig does not know by it, as a 24/2: the upper half
    of the product code that labrig devices check states. Its last digit does not matter. null: only known
    types [-]."""
    configuration_fingerprint: tuple[Word, Word] | None = None
    """Date and time in 0x1020 of the drive, which it clears when a parameter is changed; a drive with other
    values is refused. null: not compared [-]."""
    limit_switches: tuple[Literal["negative", "positive"], ...] = ()
    """Limit switches that are wired and must stop the drive. By default it ignores them."""

    def model(self) -> Model:
        """Return what is known of an EPOS2."""
        counts, named = self.counts_per_turn, self.hardware_version
        types = {} if named is None else {(named & 0xFFF0) << 16: f"EPOS2 of hardware version 0x{named:04X}"}
        lines = None if counts is None else round(counts / _COUNTS_PER_LINE)
        switches = sum(_SWITCH_BITS[switch] for switch in set(self.limit_switches))
        return Model(
            read_own_eds("epos2.eds"),
            types | TYPES,
            type_mask=0xFFF00000,
            revisions=_REVISIONS,
            advice="check the node id; if its label says EPOS2, enter its hardware_version into the rig file",
            settings={_EXECUTION_MASK: _EXECUTION_DEFAULT | switches},
            errors="epos2",
            stated=(Stated(_LINES, "counts_per_turn", counts, lines, lambda raw: _COUNTS_PER_LINE * raw),),
            tool="EPOS Studio",
            reset_communication_first=frozenset({0x8120, 0x81FD}),
            current_ma=Place(0x2027),  # the average: it has no ripple of the power stage in it
            current_limit_ma=Place(0x6410, 2),
            following_error=Place(0x20F4),
            motor_speed_limit=Place(0x6410, 4),
            home_position=Place(0x2081),
            home_offset=co.HOME_OFFSET,
            homing_current=Place(0x2080),
            referenced_bit=15,
            inputs=Place(0x2071, 1),
            input_mask=Place(0x2071, 2),
            analog={name: Place(0x207C, n) for n, name in enumerate(self.analog_inputs, 1)},
            fingerprint=(Place(0x1020, 1), Place(0x1020, 2)),
            expected_fingerprint=self.configuration_fingerprint,
        )


DRIVE = Epos2Axis
"""What the entry point names."""
