"""The driver `cia402`: any CiA 402 drive in profile position mode; its EDS file states which objects it has.

What is decided here
--------------------
- Object widths are those of the EDS file, and a value out of an object's range is refused before it is sent.
- Units are compared if the drive reports them (0x60A9, 0x60AA) and never written; the same holds for counts per turn.
- Bit 15 of the statusword is manufacturer-specific: a reference counts after reopening only if the section names the
  bit that reports it.
- Home has position zero unless the section names the object for another position: makers differ in the sign of 0x607C.
- Uncertain until tried on a device: whether both limits at 0 switch the limits of an EPOS4 off, as its EDS file has
  them.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from labrig.devices.axis_description import AxisDescription, HomingDescription, Positive
from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Identity
from labrig.devices.drives.eds import Eds, read_eds, read_own_eds
from labrig.devices.drives.errors import EPOS4_ERRORS
from labrig.devices.drives.model import STOP_OPTIONS, Asked, Model, Stated
from labrig.devices.drives.objects import Place
from labrig.devices.drives.section import ProductSection
from labrig.devices.homing import HOMING_HERE
from labrig.devices.units import AxisScale
from labrig.errors import DriveError, InputError
from labrig.protocol.model import Conflict
from labrig.protocol.model import Model as Section

_PROFILE = 402
_NEEDED_MODES = 0x21
"""Bits of 0x6502 for profile position and homing."""

_WRITTEN = (
    co.CONSUMER_HEARTBEAT,
    co.PRODUCER_HEARTBEAT,
    co.CONTROLWORD,
    co.MODE,
    co.TARGET_POSITION,
    co.PROFILE_VELOCITY,
    co.PROFILE_ACCELERATION,
    co.QUICK_STOP_DECELERATION,
    co.HOMING_METHOD,
)
_READ = (
    co.DEVICE_TYPE,
    co.ERROR_REGISTER,
    co.VENDOR_ID,
    co.PRODUCT_CODE,
    co.STATUSWORD,
    co.POSITION_ACTUAL,
)
"""These and `_WRITTEN` are required: profile position mode, homing, and the stop on a lost heartbeat."""

UNIT_CODES = {"rpm": 0xB447, "turns/s": 0xB403, "counts/s": 0xB503, "rpm/s": 0xC003}
"""Unit in a rig file -> numerator and denominator of 0x60A9 and 0x60AA (CiA 303-2; 0xC0 is maxon's)."""

_HALT_BY_RAMP = 1


def _check_name(name: str) -> str:
    if not name.isprintable() or name != name.strip():
        raise ValueError("a name cannot start or end with a space, or contain a control character")
    parts = name.replace("\\", "/").split("/")
    if not all(parts) or ".." in parts or ":" in name:
        raise ValueError("the file must be in the folder of the rig file or below it")
    return name


PlaceText = Annotated[str, Field(pattern=r"^0x[0-9A-Fa-f]{4}:[0-9A-Fa-f]{2}$")]
"""Index and subindex of an object, such as 0x3001:02."""


class Cia402Homing(HomingDescription):
    """Homing of an axis."""

    method: Literal[35, 1, 2, 17, 18] = 35
    """Homing method of CiA 402. 35: home is the present position, on confirmation. 17, 18: to the negative or
    positive limit switch. 1, 2: the same, then to the index."""


class ObjectsOfMaker(Section):
    """Objects of the manufacturer, such as 0x3001:02; labrig uses those that are named."""

    home_position: PlaceText | None = None
    """Counter value at home: 0x30B0:00 of an EPOS4, 0x607C:00 of many others. null: zero, and homing.position
    must be 0."""
    counts_per_turn: PlaceText | None = None
    """Counts per turn of the motor, compared with counts_per_turn: 0x3000:05 of an EPOS4. null: not compared."""
    current_ma: PlaceText | None = None
    """Motor current [mA]: 0x30D1:01 of an EPOS4. null: 0x6078 or 0x6077, and 0x6075, if the drive has them."""
    current_limit_ma: PlaceText | None = None
    """Output current limit [mA]: 0x3001:02 of an EPOS4. null: 0x6073 and 0x6075, if the drive has them."""

    analog_1: PlaceText | None = None
    """Analog input 1 [mV]: 0x3160:01 of an EPOS4. null: the drive has none that labrig reads."""
    analog_2: PlaceText | None = None
    """Analog input 2 [mV]: 0x3160:02 of an EPOS4. null: the drive has none that labrig reads."""

    def places(self) -> dict[str, Place]:
        """Return the objects that are named, by their keys."""
        named: dict[str, str | None] = self.model_dump()
        return {key: Place(int(at[2:6], 16), int(at[7:], 16)) for key, at in named.items() if at is not None}


class Cia402Axis(ProductSection):
    """One axis with any CiA 402 drive in profile position mode. Lengths are mm, or rad where `unit` is rad."""

    homing_directions: ClassVar[Mapping[int, int]] = {HOMING_HERE: 0, 1: -1, 2: +1, 17: -1, 18: +1}
    needed: ClassVar[tuple[str, ...]] = ("counts_per_turn", *AxisDescription.needed)
    where_to_find: ClassVar[Mapping[str, str]] = {
        "counts_per_turn": "counts of 0x6064 per turn of the motor: four per encoder line, unless the drive scales",
        **AxisDescription.where_to_find,
    }
    factory_settings: ClassVar[Mapping[str, object]] = {
        "driver": "cia402",
        "eds": None,
        "counts_per_turn": 2000.0,
        "velocity_unit": "rpm",
        "acceleration_unit": "rpm/s",
        "referenced_bit": 15,
        "objects": {
            "home_position": "0x30B0:00",
            "counts_per_turn": "0x3000:05",
            "current_ma": "0x30D1:01",
            "current_limit_ma": "0x3001:02",
        },
    }
    digital_inputs: ClassVar[Mapping[str, int]] = {
        "negative-limit": 0,
        "positive-limit": 1,
        "home": 2,
        **{f"general-{bit - 15}": bit for bit in range(16, 24)},
    }

    driver: Literal["cia402"]
    """cia402: any CiA 402 drive over CANopen."""
    eds: Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_check_name)] | None
    """EDS file of the drive, in the folder of the rig file or below. Sizes and access of the objects come
    from it, and the drive must be of its product. null: a maxon EPOS4 Module 50/5, as labrig knows it."""
    counts_per_turn: Positive | None
    """Counts of the position (0x6064) per turn of the motor. null: unknown [-]."""
    velocity_unit: Literal["rpm", "turns/s", "counts/s"]
    """Unit of velocities in the drive (0x6081), of the motor."""
    velocity_factor: Positive = 1.0
    """Size of one unit of 0x6081 in velocity_unit: 0.001 for thousandths of rpm [-]."""
    acceleration_unit: Literal["rpm/s", "turns/s^2", "counts/s^2"]
    """Unit of accelerations in the drive (0x6083), of the motor."""
    acceleration_factor: Positive = 1.0
    """Size of one unit of 0x6083 in acceleration_unit [-]."""
    homing: Cia402Homing = Field(default_factory=Cia402Homing)
    """How the axis gets its reference."""
    home_here_method: Literal[35, 37] = 37
    """The drive's number for homing at the present position; 35 in older drives [-]."""
    referenced_bit: Literal[8, 14, 15] | None = None
    """Bit of the statusword that is set while the drive has its reference: 15 of maxon. null: the drive does
    not report it, and every run asks for zero [-]."""
    quick_stop_option: Literal[2, 6] = 6
    """0x605A. 2: brake and switch power off; 6: brake and hold [-]."""
    abort_connection_option: Literal[1, 3] = 1
    """0x6007, what the drive does when the computer's heartbeat stops. 1: a fault, which must be reset; 3: a
    quick stop [-]."""
    following_error_timeout_ms: Annotated[int, Field(ge=0, le=65535)] = 0
    """How long an axis may lag by more than max_following_error (0x6066) [ms]."""
    objects: ObjectsOfMaker = Field(default_factory=ObjectsOfMaker)
    """Objects of the manufacturer that labrig may use."""

    @property
    def files(self) -> dict[str, Path]:
        """The EDS file, if it is not labrig's own."""
        return {} if self.eds is None else {"eds": self._folder / self.eds}

    @property
    def analog(self) -> dict[str, Place]:
        """The analog inputs whose objects are named."""
        named = self.objects.places()
        return {f"analog-{n}": named[f"analog_{n}"] for n in (1, 2) if f"analog_{n}" in named}

    @property
    def analog_inputs(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(self.analog)

    @property
    def speed_unit(self) -> str:
        """Unit of speeds in the drive."""
        unit = f"{self.velocity_unit} of the motor"
        return unit if self.velocity_factor == 1 else f"x {self.velocity_factor:g} {unit}"

    def scale_of(self, gear_ratio: float, travel_per_turn: float) -> AxisScale:
        """Return the conversion to counts and to the stated units of velocity and acceleration."""
        counts = self.counts_per_turn or 0.0
        speeds = {"rpm": 60.0, "turns/s": 1.0, "counts/s": counts}
        accelerations = {"rpm/s": 60.0, "turns/s^2": 1.0, "counts/s^2": counts}
        return AxisScale(
            counts,
            gear_ratio,
            travel_per_turn,
            self.reversed,
            speed_units=speeds[self.velocity_unit] / self.velocity_factor,
            acceleration_units=accelerations[self.acceleration_unit] / self.acceleration_factor,
        )

    def model(self) -> Model:
        """Return what the EDS file and this section tell of the drive. Raises `InputError`."""
        path, named = self.files.get("eds"), self.objects.places()
        eds = read_own_eds("epos4.eds") if path is None else read_eds(path, self._folder)
        return Model(
            eds,
            partial(_identify, eds),
            settings={
                co.HALT_OPTION: _HALT_BY_RAMP,
                co.FOLLOWING_ERROR_TIMEOUT: self.following_error_timeout_ms,
            },
            stop_options=STOP_OPTIONS
            | {
                co.ABORT_CONNECTION: self.abort_connection_option,
                co.QUICK_STOP_OPTION: self.quick_stop_option,
            },
            errors=EPOS4_ERRORS,
            stated=self._list_stated(named),
            current_ma=named.get("current_ma"),
            current_limit_ma=named.get("current_limit_ma"),
            home_position=named.get("home_position"),
            home_here=self.home_here_method,
            referenced_bit=self.referenced_bit,
            analog=self.analog,
        )

    def _list_stated(self, named: Mapping[str, Place]) -> tuple[Stated, ...]:
        """Return what the drive must say of its units and its encoder, as this section states it."""
        units = (
            (co.VELOCITY_UNIT, "velocity_unit", self.velocity_unit, self.velocity_factor),
            (co.ACCELERATION_UNIT, "acceleration_unit", self.acceleration_unit, self.acceleration_factor),
        )
        stated = [
            Stated(place, key, f"{factor:g} {unit}", _write_unit(unit, factor), _name_unit)
            for place, key, unit, factor in units
        ]
        if "counts_per_turn" in named:
            counts = self.counts_per_turn
            raw = None if counts is None else round(counts)
            stated.append(Stated(named["counts_per_turn"], "counts_per_turn", counts, raw))
        return tuple(stated)

    def conflicts(self) -> Iterable[Conflict]:
        """Yield conflicts, also of a homing that no CiA 402 drive can do."""
        yield from super().conflicts()
        if self.homing.offset:
            yield Conflict(
                "homing.offset",
                f"homing.offset is {self.homing.offset:g}, CiA 402 has no distance off a switch",
                "write 0, and jog after homing",
            )
        if self.homing.position and self.objects.home_position is None:
            yield Conflict(
                "homing.position",
                f"homing.position is {self.homing.position:g}, and the object for it in the drive is not named",
                "name it in objects.home_position, or write 0",
            )

    def problems(self) -> Iterator[Conflict]:
        """Yield objects that the EDS file lacks for this section; without one, what may be wrong with any drive."""
        with suppress(InputError):
            if lacking := [*_find_lacking(self.model(), self.objects.places())]:
                yield from lacking
                return
        yield from super().problems()


def _find_lacking(model: Model, named: Mapping[str, Place]) -> Iterator[Conflict]:
    """Yield each required or named object that the drive lacks, or of which it refuses the access that is needed."""
    standard = read_own_eds("epos4.eds").objects
    for place in (*_READ, *_WRITTEN):
        found, needs_write = model.eds.objects.get(place), place in _WRITTEN
        if found is not None and (found.writable if needs_write else found.readable):
            continue
        lack = f"does not allow to {'write' if needs_write else 'read'} object" if found else "has no object"
        yield Conflict(
            "eds",
            f"{model.eds.source} {lack} {place} ({standard[place].name})",
            "labrig needs it in every drive: use the EDS file of this drive, or another drive",
        )
    for key, place in named.items():
        if not model.has(place):
            yield Conflict(
                f"objects.{key}",
                f"{model.eds.source} has no object {place}",
                "correct it with the manual of the drive, or leave it out",
            )


def _name_unit(value: int) -> str | None:
    """Return factor and unit in a value of 0x60A9 or 0x60AA, as a rig file has them; None for an unknown unit."""
    unit = next((unit for unit, code in UNIT_CODES.items() if code == value >> 8 & 0xFFFF), None)
    exponent = int.from_bytes(bytes([value >> 24 & 0xFF]), signed=True)
    return None if unit is None else f"{10.0**exponent:g} {unit}"


def _write_unit(unit: str, factor: float) -> int | None:
    """Return the value of 0x60A9 or 0x60AA for a unit; None for one without a code."""
    exponent = round(math.log10(factor))
    if unit not in UNIT_CODES or not math.isclose(10.0**exponent, factor):
        return None
    return (exponent & 0xFF) << 24 | UNIT_CODES[unit] << 8


def _identify(eds: Eds, drive: Asked) -> Identity:
    """Return the identity of a drive. Raises `DriveError` for another product than that of the EDS file."""
    device_type, modes = drive.upload(co.DEVICE_TYPE), drive.find(co.SUPPORTED_MODES)
    vendor, product = drive.upload(co.VENDOR_ID), drive.upload(co.PRODUCT_CODE)
    if device_type & 0xFFFF != _PROFILE:
        raise DriveError(
            f"{drive.name} has device type 0x{device_type:08X} ({co.DEVICE_TYPE}), expected a CiA 402 drive",
            "check the node id in the rig file",
        )
    if (vendor, product) != (eds.vendor, eds.product):
        raise DriveError(
            f"{drive.name} has vendor 0x{vendor:08X}, product 0x{product:08X}; {eds.source} is for vendor "
            f"0x{eds.vendor:08X}, product 0x{eds.product:08X} ({eds.product_name})",
            "name the EDS file of this drive in the rig file, or check its node id",
        )
    if modes is not None and modes & _NEEDED_MODES != _NEEDED_MODES:
        raise DriveError(
            f"{drive.name} lacks profile position or homing mode ({co.SUPPORTED_MODES} is 0x{modes:08X})",
            "use another drive",
        )
    found, doubt = {"vendor_id": vendor, "product_code": product}, ""
    revision = drive.find(co.REVISION)
    if revision is not None:
        found["revision_number"] = revision
        if eds.revision not in {None, revision}:
            doubt = f"its EDS file is for revision 0x{eds.revision:08X}: ranges and defaults may differ"
    return Identity(eds.product_name, drive.find(co.SERIAL_NUMBER), found, doubt)


DRIVE = Cia402Axis
"""What the entry point names."""
