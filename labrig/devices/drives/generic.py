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

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from labrig.devices.axis_description import AxisDescription, Positive
from labrig.devices.drives import objects as co
from labrig.devices.drives.drive import Homing
from labrig.devices.drives.eds import read_eds, read_own_eds
from labrig.devices.drives.model import STOP_OPTIONS, Model, Stated
from labrig.devices.drives.objects import Place
from labrig.devices.drives.section import ProductSection
from labrig.devices.homing import HOMING_HERE
from labrig.devices.units import AxisScale
from labrig.protocol.model import Model as Section

_UNITS = {
    (exponent & 0xFF) << 24 | code << 8: f"{10.0**exponent:g} {unit}"
    for unit, code in {"rpm": 0xB447, "turns/s": 0xB403, "counts/s": 0xB503, "rpm/s": 0xC003}.items()
    for exponent in range(-9, 10)
}
"""Value of 0x60A9 and 0x60AA -> factor and unit as a rig file has them (CiA 303-2; 0xC0 is maxon's)."""

_HALT_BY_RAMP = 1


PlaceText = Annotated[str, Field(pattern=r"^0x[0-9A-Fa-f]{4}:[0-9A-Fa-f]{2}$")]
"""Index and subindex of an object, such as 0x3001:02."""


class Cia402Homing(Homing):
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
    eds: Annotated[str, Field(min_length=1, max_length=200)] | None
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
            {eds.product: eds.product_name},
            tried=() if eds.revision is None else (eds.revision,),
            settings={co.HALT_OPTION: _HALT_BY_RAMP, co.FOLLOWING_ERROR_TIMEOUT: 0},
            stop_options=STOP_OPTIONS
            | {
                co.ABORT_CONNECTION: self.abort_connection_option,
                co.QUICK_STOP_OPTION: self.quick_stop_option,
            },
            errors="epos4",
            stated=self._list_stated(named),
            current_ma=named.get("current_ma"),
            current_limit_ma=named.get("current_limit_ma"),
            home_position=named.get("home_position"),
            home_here=self.home_here_method,
            referenced_bit=self.referenced_bit,
            analog=self.analog,
            needs=tuple(named.values()),
        )

    def _list_stated(self, named: Mapping[str, Place]) -> tuple[Stated, ...]:
        """Return what the drive must say of its units and its encoder, as this section states it."""
        codes = {text: code for code, text in _UNITS.items()}
        units = {
            "velocity_unit": (co.VELOCITY_UNIT, f"{self.velocity_factor:g} {self.velocity_unit}"),
            "acceleration_unit": (
                co.ACCELERATION_UNIT,
                f"{self.acceleration_factor:g} {self.acceleration_unit}",
            ),
        }
        stated = [Stated(at, key, text, codes.get(text), _UNITS.get) for key, (at, text) in units.items()]
        if "counts_per_turn" in named:
            counts = self.counts_per_turn
            raw = None if counts is None else round(counts)
            stated.append(Stated(named["counts_per_turn"], "counts_per_turn", counts, raw))
        return tuple(stated)


DRIVE = Cia402Axis
"""What the entry point names."""
