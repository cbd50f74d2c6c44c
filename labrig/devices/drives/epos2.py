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

from labrig.devices.axis_description import HomingDescription
from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Identity
from labrig.devices.drives.eds import read_own_eds
from labrig.devices.drives.errors import EPOS2_ERRORS
from labrig.devices.drives.model import Asked, Model, Stated
from labrig.devices.drives.objects import Place
from labrig.devices.drives.section import ProductSection
from labrig.devices.homing import HOMING_HERE
from labrig.devices.simulated.cia402 import Behaviour
from labrig.devices.simulated.kinds import be_epos2
from labrig.devices.units import AxisScale
from labrig.errors import DriveError

CONFIGURATION = (Place(0x1020, 1), Place(0x1020, 2))
SOFTWARE_VERSION, HARDWARE_VERSION = Place(0x2003, 1), Place(0x2003, 2)
CURRENT_AVERAGE = Place(0x2027)
INPUT_STATE, INPUT_MASK, LIMIT_EXECUTION_MASK = Place(0x2071, 1), Place(0x2071, 2), Place(0x2071, 4)
ANALOG_INPUTS = {f"analog-{n}": Place(0x207C, n) for n in (1, 2)}
CURRENT_THRESHOLD = Place(0x2080)
HOME_POSITION = Place(0x2081)
FOLLOWING_ERROR_ACTUAL = Place(0x20F4)
ENCODER_PULSES = Place(0x2210, 1)
CURRENT_LIMIT, MAX_MOTOR_SPEED = Place(0x6410, 2), Place(0x6410, 4)

VENDOR, DEVICE_TYPE = 0xFB, 0x00020192
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

_UNKNOWN_MODEL = "EPOS2 of a type unknown to labrig"
_EXECUTION_DEFAULT = 0x0008
_SWITCH_BITS = {"negative": 1, "positive": 2}
_BY_CURRENT = frozenset({-1, -2, -3, -4})
"""Homing methods that run into a mechanical stop."""

HOMING_DIRECTIONS = {
    1: -1,  # negative limit switch and index
    2: +1,  # positive limit switch and index
    17: -1,  # negative limit switch
    18: +1,  # positive limit switch
    -1: +1,  # current threshold, positive speed, and index
    -2: -1,  # current threshold, negative speed, and index
    -3: +1,  # current threshold, positive speed
    -4: -1,  # current threshold, negative speed
    HOMING_HERE: 0,
}
"""Homing method -> sign of the motor's speed during its search, as maxon defines it: -1 and -3 go in the POSITIVE
direction until the current threshold. `canopen` has the opposite sign, which would drive an axis the wrong way."""

_INPUTS = ("negative-limit", "positive-limit", "home", "position-marker", "drive-enable")
_GENERAL_INPUTS = {f"general-{letter}": bit for bit, letter in enumerate("HGFEDCBA", start=8)}

Word = Annotated[int, Field(ge=0, lt=2**32)]


class Epos2Homing(HomingDescription):
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
    count_unit = "quadcounts"
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
        return tuple(ANALOG_INPUTS)

    def find_behaviour(self) -> Behaviour:
        """Return how an EPOS2 24/5 behaves."""
        return be_epos2(self)

    def scale_of(self, gear_ratio: float, travel_per_turn: float) -> AxisScale:
        """Return the conversion to quadcounts (quarters of an encoder line) and rpm."""
        quadcounts = 4 * (self.encoder_pulses_per_turn or 0)
        return AxisScale(quadcounts, gear_ratio, travel_per_turn, self.reversed)

    def homing_current_ma(self, method: int) -> int | None:
        """Return the current at which a method finds its stop [mA]; None for a method without a current."""
        return self.homing.current_threshold_ma if method in _BY_CURRENT else None

    def model(self) -> Model:
        """Return what is known of an EPOS2."""
        pulses = self.encoder_pulses_per_turn
        switches = sum(_SWITCH_BITS[switch] for switch in set(self.limit_switches))
        return Model(
            read_own_eds("epos2.eds"),
            self._identify,
            settings={LIMIT_EXECUTION_MASK: _EXECUTION_DEFAULT | switches},
            errors=EPOS2_ERRORS,
            stated=(Stated(ENCODER_PULSES, "encoder_pulses_per_turn", pulses, pulses),),
            tool="EPOS Studio",
            passing=frozenset({0x0133, 0x4133, 0x4123}),  # measure init, refresh
            reset_communication_first=frozenset({0x8120, 0x81FD}),
            current_ma=CURRENT_AVERAGE,  # it has no ripple of the power stage in it
            current_limit_ma=CURRENT_LIMIT,
            following_error=FOLLOWING_ERROR_ACTUAL,
            motor_speed_limit=MAX_MOTOR_SPEED,
            home_position=HOME_POSITION,
            home_offset=co.HOME_OFFSET,
            homing_current=CURRENT_THRESHOLD,
            referenced_bit=15,
            inputs=INPUT_STATE,
            input_mask=INPUT_MASK,
            analog=ANALOG_INPUTS,
            fingerprint=CONFIGURATION,
            expected_fingerprint=self.configuration_fingerprint,
            sent_names=("sent_quadcounts", "sent_rpm"),
        )

    def _identify(self, drive: Asked) -> Identity:
        """Return the identity of an EPOS2; with other software than was tried, it says so.

        Raises `DriveError` for another product: other generations have other objects and signs.
        """
        vendor, device_type = drive.upload(co.VENDOR_ID), drive.upload(co.DEVICE_TYPE)
        if (vendor, device_type) != (VENDOR, DEVICE_TYPE):
            raise _refuse(drive, f"vendor 0x{vendor:X}, device type 0x{device_type:08X}")
        hardware, software = drive.upload(HARDWARE_VERSION), drive.upload(SOFTWARE_VERSION)
        model = self._name_model(drive, hardware)
        if software not in _SOFTWARE:
            low, high = _SOFTWARE[0], _SOFTWARE[-1]
            raise _refuse(
                drive, f"software version 0x{software:04X}, an EPOS2 has 0x{low:04X} to 0x{high:04X}"
            )
        doubt = ""
        if model == _UNKNOWN_MODEL:
            doubt = (
                "it is used because the rig file names its hardware version: check that its label says EPOS2"
            )
        elif software not in _TRIED_SOFTWARE:
            tried = " and ".join(f"0x{version:04X}" for version in _TRIED_SOFTWARE)
            doubt = f"labrig knows the objects of software {tried}"
        versions = {"hardware_version": hardware, "software_version": software}
        return Identity(model, drive.upload(co.SERIAL_NUMBER), versions, doubt)

    def _name_model(self, drive: Asked, hardware: int) -> str:
        """Return the name of the type by its hardware version. Raises `DriveError` for one that is not expected."""
        expected, kind = self.hardware_version, hardware & 0xFFF0
        if expected is not None and hardware != expected:
            raise DriveError(
                f"{drive.name} has hardware version 0x{hardware:04X}, the rig file says 0x{expected:04X}",
                "check the node id and hardware_version in the rig file, and the label of the drive",
            )
        if kind not in HARDWARE and expected is None:
            raise _refuse(
                drive,
                f"hardware version 0x{hardware:04X}, unknown to labrig",
                f"; if its label says EPOS2, set hardware_version: 0x{hardware:04X} for this axis in the rig file",
            )
        return HARDWARE.get(kind, _UNKNOWN_MODEL)


def _refuse(drive: Asked, found: str, way_out: str = "") -> DriveError:
    known = ", ".join(f"{name} (0x{version:04X})" for version, name in HARDWARE.items())
    return DriveError(
        f"{drive.name} is not an EPOS2 that labrig knows: {found}",
        f"check the node id in the rig file and the drive itself; known by 0x2003:02 are {known}{way_out}",
    )


DRIVE = Epos2Axis
"""What the entry point names."""
