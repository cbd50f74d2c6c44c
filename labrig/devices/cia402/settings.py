"""The section of an axis with a CiA 402 drive, and the settings of its drive."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from labrig.devices import canopen_objects as co
from labrig.devices.axis_description import AxisDescription, HomingDescription, Positive
from labrig.devices.can_description import HeartbeatDescription, NodeId
from labrig.devices.canopen_objects import Entry
from labrig.devices.cia402 import objects as od
from labrig.devices.cia402.eds import Eds, read_eds
from labrig.devices.cia402.epos4 import EPOS4
from labrig.devices.homing import HOMING_HERE
from labrig.devices.units import AxisScale
from labrig.errors import InputError
from labrig.protocol.model import Conflict, Model

_STOP_BY_RAMP, _STOP_BY_QUICK_STOP = 1, 2
_TRAPEZOID = 0


def _check_name(name: str) -> str:
    if not name.isprintable() or name != name.strip():
        raise ValueError("a name cannot start or end with a space, or contain a control character")
    parts = name.replace("\\", "/").split("/")
    if not all(parts) or ".." in parts or ":" in name:
        raise ValueError("the file must be in the folder of the rig file or below it")
    return name


Place = Annotated[str, Field(pattern=r"^0x[0-9A-Fa-f]{4}:[0-9A-Fa-f]{2}$")]
"""Index and subindex of an object, such as 0x3001:02."""


class Cia402Homing(HomingDescription):
    """Homing of an axis."""

    method: Literal[35, 1, 2, 17, 18] = Field(
        35,
        description="Homing method of CiA 402. 35: home is the present position, on confirmation. 17, 18: to the "
        "negative or positive limit switch. 1, 2: the same, then to the index.",
    )


class ObjectsOfMaker(Model):
    """Objects of the manufacturer, such as 0x3001:02; labrig uses those that are named."""

    home_position: Place | None = Field(
        None,
        description="Counter value at home: 0x30B0:00 of an EPOS4, 0x607C:00 of many others. null: zero, and "
        "homing.position must be 0.",
    )
    counts_per_turn: Place | None = Field(
        None,
        description="Counts per turn of the motor, compared with counts_per_turn: 0x3000:05 of an EPOS4. null: not "
        "compared.",
    )
    current_ma: Place | None = Field(
        None,
        description="Motor current [mA]: 0x30D1:01 of an EPOS4. null: 0x6078 or 0x6077, and 0x6075, if the drive has "
        "them.",
    )
    current_limit_ma: Place | None = Field(
        None,
        description="Output current limit [mA]: 0x3001:02 of an EPOS4. null: 0x6073 and 0x6075, if the drive has them.",
    )

    analog_1: Place | None = Field(
        None,
        description="Analog input 1 [mV]: 0x3160:01 of an EPOS4. null: the drive has none that labrig reads.",
    )
    analog_2: Place | None = Field(
        None,
        description="Analog input 2 [mV]: 0x3160:02 of an EPOS4. null: the drive has none that labrig reads.",
    )

    def entry(self, key: str) -> Entry | None:
        """Return the object that a key names; None for null."""
        place: str | None = getattr(self, key)
        return None if place is None else Entry(int(place[2:6], 16), int(place[7:], 16), key, "I")


ANALOG_KEYS = {"analog-1": "analog_1", "analog-2": "analog_2"}
"""Name of an analog input -> the key that names its object."""


class Cia402Axis(AxisDescription):
    """One axis with any CiA 402 drive in profile position mode. Lengths are mm, or rad where `unit` is rad."""

    homing_directions: ClassVar[Mapping[int, int]] = {HOMING_HERE: 0, 1: -1, 2: +1, 17: -1, 18: +1}
    needed: ClassVar[tuple[str, ...]] = ("counts_per_turn", *AxisDescription.needed)
    where_to_find: ClassVar[Mapping[str, str]] = {
        "counts_per_turn": "counts of 0x6064 per turn of the motor: four per encoder line, unless the drive scales",
        **AxisDescription.where_to_find,
    }
    file_keys: ClassVar[tuple[str, ...]] = ("eds",)
    digital_inputs: ClassVar[Mapping[str, int]] = {
        "negative-limit": 0,
        "positive-limit": 1,
        "home": 2,
        **{f"general-{bit - 15}": bit for bit in range(16, 24)},
    }

    driver: Literal["cia402"] = Field(description="cia402: any CiA 402 drive over CANopen.")
    node_id: NodeId = Field(description="CANopen node id of the drive.")
    eds: Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_check_name)] | None = Field(
        description="EDS file of the drive, in the folder of the rig file or below. Sizes and access of the objects "
        "come from it, and the drive must be of its product. null: a maxon EPOS4 Module 50/5, as labrig knows it."
    )
    counts_per_turn: Positive | None = Field(
        description="Counts of the position (0x6064) per turn of the motor. null: unknown [-]."
    )
    velocity_unit: Literal["rpm", "turns/s", "counts/s"] = Field(
        description="Unit of velocities in the drive (0x6081), of the motor."
    )
    velocity_factor: Positive = Field(
        1.0, description="Size of one unit of 0x6081 in velocity_unit: 0.001 for thousandths of rpm [-]."
    )
    acceleration_unit: Literal["rpm/s", "turns/s^2", "counts/s^2"] = Field(
        description="Unit of accelerations in the drive (0x6083), of the motor."
    )
    acceleration_factor: Positive = Field(
        1.0, description="Size of one unit of 0x6083 in acceleration_unit [-]."
    )
    homing: Cia402Homing = Field(default_factory=Cia402Homing, description="How the axis gets its reference.")
    home_here_method: Literal[35, 37] = Field(
        37, description="The drive's number for homing at the present position; 35 in older drives [-]."
    )
    referenced_bit: Literal[8, 14, 15] | None = Field(
        None,
        description="Bit of the statusword that is set while the drive has its reference: 15 of maxon. null: the drive "
        "does not report it, and every run asks for zero [-].",
    )
    quick_stop_option: Literal[2, 6] = Field(
        6, description="0x605A. 2: brake and switch power off; 6: brake and hold [-]."
    )
    abort_connection_option: Literal[1, 3] = Field(
        1,
        description="0x6007, what the drive does when the computer's heartbeat stops. 1: a fault, which must be reset; "
        "3: a quick stop [-].",
    )
    following_error_timeout_ms: Annotated[int, Field(ge=0, le=65535)] = Field(
        0, description="How long an axis may lag by more than max_following_error (0x6066) [ms]."
    )
    objects: ObjectsOfMaker = Field(
        default_factory=ObjectsOfMaker, description="Objects of the manufacturer that labrig may use."
    )

    @property
    def nodes(self) -> tuple[int, ...]:
        """The node id."""
        return (self.node_id,)

    @property
    def analog_inputs(self) -> tuple[str, ...]:
        """Names of the analog inputs whose objects are named."""
        return tuple(name for name, key in ANALOG_KEYS.items() if self.objects.entry(key) is not None)

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

    def read_eds(self) -> Eds:
        """Return the content of the drive's EDS file. Raises `InputError`."""
        path = self.files.get("eds")
        return EPOS4 if path is None else read_eds(path, self._folder)

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

    def problems(self, heartbeat: HeartbeatDescription) -> Iterator[Conflict]:
        """Yield objects that the EDS file lacks for this section, and settings out of the drive's range."""
        try:
            eds = self.read_eds()
            lacking = [*find_lacking(eds), *self._unknown_objects(eds)]
        except InputError as error:
            yield Conflict("eds", error.message, error.hint)
            return
        yield from lacking
        if lacking or self.unknown:
            return
        for entry, value in drive_settings(self, heartbeat, eds).items():
            low, high = entry.bounds
            if not low <= value <= high:
                yield Conflict(
                    "eds",
                    f"{entry.name} ({entry.place}) would be {value}, the drive takes {low} to {high}",
                    "check speeds, accelerations, windows and units of this axis",
                )

    def _unknown_objects(self, eds: Eds) -> Iterator[Conflict]:
        """Yield named objects of the manufacturer that the drive lacks."""
        for key in type(self.objects).model_fields:
            entry = self.objects.entry(key)
            if entry is not None and eds.find(entry) is None:
                yield Conflict(
                    f"objects.{key}",
                    f"{eds.source} has no object {entry.place}",
                    "correct it with the manual of the drive, or leave it out",
                )


def find_lacking(eds: Eds) -> Iterator[Conflict]:
    """Yield each required object that the drive lacks, or of which it refuses the access that labrig needs.

    Raises
    ------
    InputError
        When the description of an object is malformed.
    """
    for entry in (*od.READ, *od.WRITTEN):
        found = eds.find(entry)
        refused = {"ro"} if entry in od.WRITTEN else {"wo"}
        if found is None or found.access in refused:
            lack = "has no object" if found is None else f"does not allow to {_REFUSED[found.access]} object"
            yield Conflict(
                "eds",
                f"{eds.source} {lack} {entry.place} ({entry.name})",
                "labrig needs it in every drive: use the EDS file of this drive, or another drive",
            )


_REFUSED = {"ro": "write", "wo": "read"}


def drive_settings(axis: Cia402Axis, heartbeat: HeartbeatDescription, eds: Eds) -> dict[Entry, int]:
    """Return the settings of the drive of an axis, as far as it has and can write them.

    Raises
    ------
    InputError
        When gear, lead or counts per turn are unknown.
    """
    scale = axis.scale()
    acceleration = scale.to_acceleration_units(axis.acceleration)
    settings = {
        co.ABORT_CONNECTION: axis.abort_connection_option,
        od.QUICK_STOP_OPTION: axis.quick_stop_option,
        od.HALT_OPTION: _STOP_BY_RAMP,
        co.FAULT_REACTION: _STOP_BY_QUICK_STOP,
        co.MAX_FOLLOWING_ERROR: scale.to_distance_counts(axis.max_following_error),
        od.FOLLOWING_ERROR_TIMEOUT: axis.following_error_timeout_ms,
        co.POSITION_WINDOW: scale.to_distance_counts(axis.position_window),
        co.POSITION_WINDOW_TIME: axis.position_window_time_ms,
        co.MAX_PROFILE_VELOCITY: scale.to_speed_units(axis.max_speed),
        co.PROFILE_ACCELERATION: acceleration,
        co.PROFILE_DECELERATION: acceleration,
        co.QUICK_STOP_DECELERATION: scale.to_acceleration_units(axis.quick_stop_deceleration),
        co.PROFILE_TYPE: _TRAPEZOID,
        co.CONSUMER_HEARTBEAT: heartbeat.computer_node_id << 16 | heartbeat.timeout_ms,
    }
    own = ((eds.find(entry), value) for entry, value in settings.items())
    return {entry: value for entry, value in own if entry is not None and entry.access == "rw"}
