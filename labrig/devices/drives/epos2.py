"""The driver `epos2`: maxon EPOS2 over CANopen.

What is decided here
--------------------
- The encoder resolution is compared with the rig file and never written.
- An EPOS2 of an unknown type is refused with its hardware version, unless the rig file names this version: those of the
  24/2 and of others are not published. Its software version still has to be that of an EPOS2.
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

from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Homing
from labrig.devices.drives.eds import read_own_eds
from labrig.devices.drives.model import Model, Stated
from labrig.devices.drives.objects import Place
from labrig.devices.drives.section import ProductSection
from labrig.devices.homing import HOMING_HERE
from labrig.devices.simulated.kinds import Behaviour, be_epos2
from labrig.devices.units import AxisScale

HARDWARE = {
    0x6120: "EPOS2 Module 36/2",
    0x6220: "EPOS2 24/5",
    0x6320: "EPOS2 50/5",
    0x6420: "EPOS2 70/10",
}
"""Hardware version 0x2003:02 without its last digit -> name (libcanepos, and maxon's EDS file of the EPOS2 70/10)."""

_SOFTWARE = range(0x2100, 0x2200)
"""Software versions 0x2003:01 of an EPOS2; those of the first EPOS generation begin with 0x20."""

_TRIED_SOFTWARE = (0x2110, 0x2122)
"""Versions whose objects are known: by the driver of IRI (CEpos2), and by maxon's EDS file."""

_BY_ITS_VERSION = (
    "it is used because the rig file names its hardware version: check that its label says EPOS2"
)
_EXECUTION_DEFAULT = 0x0008
_SWITCH_BITS = {"negative": 1, "positive": 2}

HOMING_DIRECTIONS = {1: -1, 2: +1, 17: -1, 18: +1, -1: +1, -2: -1, -3: +1, -4: -1, HOMING_HERE: 0}
"""Homing method -> sign of the motor's speed during its search, as maxon defines it: -1 and -3 go in the POSITIVE
direction until the current threshold. `canopen` has the opposite sign, which would drive an axis the wrong way."""

_INPUTS = ("negative-limit", "positive-limit", "home", "position-marker", "drive-enable")
_ANALOG_INPUTS = {f"analog-{n}": Place(0x207C, n) for n in (1, 2)}
_GENERAL_INPUTS = {f"general-{letter}": bit for bit, letter in enumerate("HGFEDCBA", start=8)}

Word = Annotated[int, Field(ge=0, lt=2**32)]


class Epos2Homing(Homing):
    """Homing of an axis."""

    method: Literal[35, -1, -2, -3, -4, 1, 2, 17, 18] = 35
    """maxon's homing method. 35: home is the present position, on confirmation. By current, to the stop in
    the motor's positive direction: -1, -3; in its negative direction: -2, -4; -1 and -2 then go to the
    index. 1, 2, 17, 18: to a limit switch."""
    current_threshold_ma: Annotated[int, Field(ge=1, le=65535)] = 500
    """Motor current that counts as having reached the stop [mA]."""


class Epos2Axis(ProductSection):
    """One axis with an EPOS2 of maxon. Lengths are mm, or rad where `unit` is rad."""

    factory_settings: ClassVar[Mapping[str, object]] = {"encoder_pulses_per_turn": 500}
    homing_directions = HOMING_DIRECTIONS
    needed = ("encoder_pulses_per_turn", *ProductSection.needed)
    where_to_find: ClassVar[Mapping[str, str]] = {
        "encoder_pulses_per_turn": "lines of the encoder on the motor: data sheet, or 0x2210:01 in EPOS Studio",
        **ProductSection.where_to_find,
    }
    digital_inputs: ClassVar[Mapping[str, int]] = {
        **{name: bit for bit, name in enumerate(_INPUTS)},
        **_GENERAL_INPUTS,
    }
    """Name of a digital input -> its bit in 0x2071:01, which is its number in 0x2070 (maxon's EposCmd: A is 15)."""

    driver: Literal["epos2"] = "epos2"
    """Kind of drive."""
    encoder_pulses_per_turn: Annotated[int, Field(ge=16, le=2_500_000)] | None
    """Encoder lines per turn of the motor; a quadcount is a quarter of a line. null: unknown [-]."""
    hardware_version: Annotated[int, Field(ge=0, lt=2**16)] | None = None
    """Hardware version (0x2003:02) of an EPOS2 whose type labrig does not know by it, as a 24/2: labrig
    devices check states it. A drive with another one is refused. null: only known types [-]."""
    homing: Epos2Homing = Field(default_factory=Epos2Homing)
    """How the axis gets its reference."""
    configuration_fingerprint: tuple[Word, Word] | None = None
    """Date and time in 0x1020 of the drive, which it clears when a parameter is changed; a drive with other
    values is refused. null: not compared [-]."""
    limit_switches: tuple[Literal["negative", "positive"], ...] = ()
    """Limit switches that are wired and must stop the drive. By default it ignores them."""

    @property
    def analog_inputs(self) -> tuple[str, ...]:
        """Names of the analog inputs of the drive."""
        return tuple(_ANALOG_INPUTS)

    def find_behaviour(self) -> Behaviour:
        """Return how an EPOS2 24/5 behaves."""
        return be_epos2(self)

    def scale_of(self, gear_ratio: float, travel_per_turn: float) -> AxisScale:
        """Return the conversion to quadcounts (quarters of an encoder line) and rpm."""
        quadcounts = 4 * (self.encoder_pulses_per_turn or 0)
        return AxisScale(quadcounts, gear_ratio, travel_per_turn, self.reversed)

    def homing_current_ma(self, method: int) -> int | None:
        """Return the current at which a method finds its stop [mA]; None for a method without a current."""
        return self.homing.current_threshold_ma if method < 0 else None

    def model(self) -> Model:
        """Return what is known of an EPOS2."""
        pulses, named = self.encoder_pulses_per_turn, self.hardware_version
        name = None if named is None else HARDWARE.get(named & 0xFFF0)
        switches = sum(_SWITCH_BITS[switch] for switch in set(self.limit_switches))
        return Model(
            read_own_eds("epos2.eds"),
            HARDWARE if named is None else {named: name or "EPOS2 of a type unknown to labrig"},
            versions=_SOFTWARE,
            tried=_TRIED_SOFTWARE,
            type_name="hardware_version",
            type_at=Place(0x2003, 2),
            type_mask=0xFFF0 if named is None else 0xFFFF,
            version_name="software_version",
            version_at=Place(0x2003, 1),
            advice="check the node id; if its label says EPOS2, enter its hardware_version into the rig file",
            doubt="" if named is None or name else _BY_ITS_VERSION,
            settings={Place(0x2071, 4): _EXECUTION_DEFAULT | switches},
            errors="epos2",
            stated=(Stated(Place(0x2210, 1), "encoder_pulses_per_turn", pulses, pulses),),
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
            analog=_ANALOG_INPUTS,
            fingerprint=(Place(0x1020, 1), Place(0x1020, 2)),
            expected_fingerprint=self.configuration_fingerprint,
            sent_names=("sent_quadcounts", "sent_rpm"),
        )


DRIVE = Epos2Axis
"""What the entry point names."""
