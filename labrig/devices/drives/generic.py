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
from dataclasses import replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import read_eds, read_own_eds
from labrig.devices.drives.model import STOP_OPTIONS, Model, Stated
from labrig.devices.drives.objects import Place
from labrig.devices.units import AxisScale
from labrig.protocol.model import Model as Section

_UNITS = {
    (exponent & 0xFF) << 24 | code << 8: f"{10.0**exponent:g} {unit}" if exponent else unit
    for unit, code in {"rpm": 0xB447, "turns/s": 0xB403, "counts/s": 0xB503, "rpm/s": 0xC003}.items()
    for exponent in range(-9, 10)
}
"""Value of 0x60A9 and 0x60AA -> unit as a rig file has it (CiA 303-2; 0xC0 is maxon's)."""

_HALT_BY_RAMP = 1
_MAXON = 0xFB


VelocityUnit = Annotated[str, Field(pattern=r"^(\d*\.?\d+ )?(rpm|turns/s|counts/s)$")]
AccelerationUnit = Annotated[str, Field(pattern=r"^(\d*\.?\d+ )?(rpm/s|turns/s\^2|counts/s\^2)$")]
PlaceText = Annotated[str, Field(pattern=r"^0x[0-9A-Fa-f]{4}:[0-9A-Fa-f]{2}$")]
"""Index and subindex of an object, such as 0x3001:02."""


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


class Cia402Axis(AxisDescription):
    """One axis with any CiA 402 drive in profile position mode. Lengths are mm, or rad where `unit` is rad."""

    factory_settings: ClassVar[Mapping[str, object]] = {
        "driver": "cia402",
        "eds": None,
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
    velocity_unit: VelocityUnit
    """Unit of velocities in the drive (0x6081), of the motor: rpm, turns/s or counts/s; 0.001 rpm for
    thousandths."""
    acceleration_unit: AccelerationUnit
    """Unit of accelerations in the drive (0x6083), of the motor: rpm/s, turns/s^2 or counts/s^2."""
    home_here_method: Literal[35, 37] = 37
    """The drive's number for homing at the present position; 35 in older drives [-]."""
    referenced_bit: Literal[8, 14, 15] | None = None
    """Bit of the statusword that is set while the drive has its reference: 15 of maxon. null: the drive does
    not report it, and every run asks for zero [-]."""
    quick_stop_option: Literal[2, 6] = 6
    """0x605A. 2: brake and switch power off; 6: brake and hold [-]."""
    objects: ObjectsOfMaker = Field(default_factory=ObjectsOfMaker)
    """Objects of the manufacturer that labrig may use."""

    @property
    def files(self) -> dict[str, Path]:
        """The EDS file, if it is not labrig's own."""
        return {} if self.eds is None else {"eds": self._folder / self.eds}

    def scale(self) -> AxisScale:
        """Return the conversion to counts and to the stated units of velocity and acceleration."""
        scale = super().scale()
        return replace(
            scale,
            speed_units=_per_turn(self.velocity_unit, scale.counts_per_turn),
            acceleration_units=_per_turn(self.acceleration_unit, scale.counts_per_turn),
        )

    def model(self) -> Model:
        """Return what the EDS file and this section tell of the drive. Raises `InputError`."""
        path, named = self.files.get("eds"), self.objects.places()
        eds = read_own_eds("epos4.eds") if path is None else read_eds(path, self._folder)
        return Model(
            eds,
            settings={co.HALT_OPTION: _HALT_BY_RAMP, co.FOLLOWING_ERROR_TIMEOUT: 0},
            stop_options=STOP_OPTIONS | {co.QUICK_STOP_OPTION: self.quick_stop_option},
            errors="epos4" if eds.vendor == _MAXON else "",
            stated=self._list_stated(named),
            current_ma=named.get("current_ma"),
            current_limit_ma=named.get("current_limit_ma"),
            home_position=named.get("home_position"),
            home_here=self.home_here_method,
            referenced_bit=self.referenced_bit,
            analog={key.replace("_", "-"): at for key, at in named.items() if key.startswith("analog")},
            needs=tuple(named.values()),
        )

    def _list_stated(self, named: Mapping[str, Place]) -> tuple[Stated, ...]:
        """Return what the drive must say of its units and its encoder, as this section states it."""
        codes = {text: code for code, text in _UNITS.items()}
        units = {"velocity_unit": co.VELOCITY_UNIT, "acceleration_unit": co.ACCELERATION_UNIT}
        said = {key: getattr(self, key) for key in units}
        stated = [Stated(at, key, said[key], codes.get(said[key]), _UNITS.get) for key, at in units.items()]
        if "counts_per_turn" in named:
            counts = self.counts_per_turn
            raw = None if counts is None else round(counts)
            stated.append(Stated(named["counts_per_turn"], "counts_per_turn", counts, raw))
        return tuple(stated)


def _per_turn(unit: str, counts_per_turn: float) -> float:
    """Return how many of a unit of velocity or acceleration one turn a second, or one more each second, is."""
    *size, name = unit.split()
    per_turn = {"rpm": 60.0, "turns": 1.0, "counts": counts_per_turn}[name.partition("/")[0]]
    return per_turn / float(size[0] if size else 1)


DRIVE = Cia402Axis
"""What the entry point names."""
