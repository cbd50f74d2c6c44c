"""What the rig file says of an axis whatever drives it; each kind of drive adds its own keys."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr

from labrig.devices.can_description import NodeId
from labrig.devices.drives.drive import HOMING_HERE, Homing
from labrig.devices.drives.model import Model as DriveModel
from labrig.devices.input_channel import ChannelName, InputChannel
from labrig.devices.units import TURN_RAD, AxisScale
from labrig.errors import InputError, LimitError, SafetyStopError
from labrig.plugins import INTERFACE
from labrig.protocol.model import Conflict, Interval, LimitMa, Model

AXES = ("insertion", "rotation", "linear")
"""Every axis of the instrument."""

DEFAULT_DRIVER = "epos2"
"""Driver of an axis section without the key `driver`."""

_A_SCREW: Mapping[str, object] = {
    "unit": "mm", "counts_per_turn": 2000.0, "gear_ratio": 1.0, "lead_mm": 1.0, "limits": (-100.0, 100.0),
    "max_speed": 20.0, "acceleration": 50.0, "quick_stop_deceleration": 200.0,
    "position_window": 0.01, "max_following_error": 1.0,
}  # fmt: skip
"""An axis without a gear."""

WHERE_TO_FIND = {
    "counts_per_turn": "counts of 0x6064 per turn of the motor: four per encoder line, unless the drive scales",
    "gear_ratio": "turns of the motor a turn of the screw or shaft: plate of the gearhead; 1 without one",
    "lead_mm": "travel a turn of the screw: its data sheet, or ten turns measured and divided by ten",
}
"""Keys without which nothing can be converted, null where nobody has entered them yet -> where each is found."""

Positive = Annotated[float, Field(gt=0)]


class AxisDescription(Model):
    """One axis: its drive, its mechanics and its limits. Lengths are mm, or rad where `unit` is rad.

    A product derives its section from this: its name as the type and default of `driver`, keys of its own, `model`, and
    what the class attributes tell. An entry point of the group `labrig.drives` names the class.

    Attributes
    ----------
    homing_directions : mapping of int to int
        Homing methods that this drive has -> sign of the motor's speed in the search, 0 where nothing moves.
    digital_inputs : mapping of str to int
        Digital inputs of the drive by name -> its bit in the word that holds them.
    analog_inputs : tuple of str
        Names of the analog inputs that the drive may have.
    factory_settings : mapping of str to object
        Keys of its own as they are for a drive that comes from its maker.
    interface : int
        Version of the interface for which it is written.
    """

    interface: ClassVar[int] = INTERFACE
    factory_settings: ClassVar[Mapping[str, object]] = {}
    homing_directions: ClassVar[Mapping[int, int]] = {HOMING_HERE: 0, 1: -1, 2: +1, 17: -1, 18: +1}
    digital_inputs: ClassVar[Mapping[str, int]] = {}
    analog_inputs: ClassVar[tuple[str, ...]] = ("analog-1", "analog-2")

    driver: str
    """Kind of drive."""
    node_id: NodeId
    """CANopen node id of the drive, as set by its switches."""
    unit: Literal["mm", "rad"]
    """mm for an axis that travels, rad for one that turns."""
    counts_per_turn: Positive | None
    """Counts of the position (0x6064) per turn of the motor, four for each line of an encoder. null: unknown [-]."""
    gear_ratio: Annotated[float, Field(gt=0, le=10_000)] | None
    """Turns of the motor a turn of the screw or shaft. null: unknown [-]."""
    lead_mm: Annotated[float, Field(gt=0, le=1000)] | None
    """Travel a turn of the screw; null: unknown, or an axis that turns [mm]."""
    reversed: bool = False
    """Whether the axis goes backwards when the motor's counter goes up."""
    limits: Interval
    """Lowest and highest position that a move may have [mm or rad]."""
    max_speed: Positive
    """Highest speed that a move may have [mm/s or rad/s]."""
    acceleration: Positive
    """Acceleration and deceleration of moves [mm/s^2 or rad/s^2]."""
    quick_stop_deceleration: Positive
    """Deceleration of a quick stop and after a fault [mm/s^2 or rad/s^2]."""
    speed_tolerance_fraction: Annotated[float, Field(gt=0, le=0.5)] = 0.01
    """The drive takes integer rpm; a move whose speed this changes by more is refused [-]."""
    position_window: Positive
    """A move is done when the axis stands within this [mm or rad]."""
    position_window_time_ms: Annotated[int, Field(ge=0, le=10_000)] = 20
    """... for this long [ms]."""
    max_following_error: Positive
    """The drive goes to fault when the axis lags further behind its profile [mm or rad]."""
    max_current_ma: LimitMa | None = None
    """Limit of the drive's output current while labrig has the rig open; not above the drive's own, which is
    restored afterwards. null: the drive's own [mA]."""
    inputs: Mapping[ChannelName, InputChannel] = Field(default_factory=dict)
    """What is wired to inputs of this drive, by a name of its own: needle_force, door, emergency_stop."""
    backlash: Annotated[float, Field(ge=0)] = 0.0
    """Measured play of screw and gear. Moves downwards go this far beyond their target and come back, so that
    every move ends from the same side [mm or rad]."""
    homing: Homing = Field(default_factory=Homing)
    """How it is referenced."""
    lag_s: Annotated[float, Field(ge=0, le=30)] = 0.0
    """Measured time by which what the axis moves follows later than its drive: a needle winds up while it is
    turned in gel. A turn of the bevel waits for it before the needle goes on [s]."""

    _folder: Path = PrivateAttr(default=Path())

    def placed_in(self, folder: Path) -> Self:
        """Return this section as of a rig file in `folder`, to which its file names are relative."""
        placed = self.model_copy()
        placed._folder = folder  # noqa: SLF001 - of this class; not a field, so that it enters neither file nor record
        return placed

    @classmethod
    def example(cls, node_id: int) -> Self:
        """Return a section for a drive with factory settings, on a screw without a gear."""
        return cls.model_validate({**_A_SCREW, **cls.factory_settings, "node_id": node_id})

    # What each product has of its own

    def model(self) -> DriveModel:
        """Return what is known of the drive. Raises `InputError` if its EDS file cannot be read."""
        raise NotImplementedError

    @property
    def files(self) -> dict[str, Path]:
        """The files beside the rig file that this section names, by its keys; every run keeps a copy of each."""
        return {}

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the entries that are unknown."""
        turns = self.unit == "rad"
        return tuple(
            name
            for name in WHERE_TO_FIND
            if getattr(self, name) is None and not (turns and name == "lead_mm")
        )

    def scale(self) -> AxisScale:
        """Return the conversion to the units of the drive: counts and rpm, unless a product has others.

        Raises
        ------
        InputError
            When an entry that it needs is unknown.
        """
        travel = self.lead_mm if self.unit == "mm" else TURN_RAD
        if self.counts_per_turn is None or self.gear_ratio is None or travel is None:
            raise InputError(f"unknown: {', '.join(self.unknown)}", "enter them in the rig file")
        return AxisScale(self.counts_per_turn, self.gear_ratio, travel, self.reversed)

    def homing_current_ma(self, method: int) -> int | None:
        """Return the current by which a method feels its stop [mA]; None for one that does not."""
        return self.homing.current_threshold_ma if method < 0 else None

    def homing_direction(self, method: int) -> int:
        """Return which way the axis goes in the search of a method: -1 back, +1 forwards, 0 not at all."""
        return -self.homing_directions[method] if self.reversed else self.homing_directions[method]

    def nearest_speed(self, speed: float) -> float:
        """Return the fastest speed that the drive can be set to and that is no faster than `speed`."""
        scale = self.scale()
        return scale.to_speed(scale.speed_units_below(speed))

    def check_move(self, name: str, position: float, speed: float) -> None:
        """Refuse a move that this axis, of this name, may not make, or whose speed rounding changes too much.

        Raises `LimitError`.
        """
        low, high = self.limits
        if not low <= position <= high:
            raise LimitError(
                f"axis {name}: {position:g} {self.unit} is beyond its limits [{low:g}, {high:g}] {self.unit}",
                "ask for less, or widen axes limits in the rig file where the mechanics allow it",
            )
        if not 0 < speed <= self.max_speed:
            raise LimitError(
                f"axis {name}: speed {speed:g} {self.unit}/s is not within 0 to {self.max_speed:g} {self.unit}/s",
                "ask for a slower move, or raise max_speed in the rig file where the mechanics allow it",
            )
        if not self.unknown:
            self._check_rounding(name, speed)

    def _check_rounding(self, name: str, speed: float) -> None:
        scale = self.scale()
        error = abs(scale.to_speed(scale.to_speed_units(speed)) - speed) / speed
        if error > self.speed_tolerance_fraction:
            below = scale.speed_units_below(speed)
            raise LimitError(
                f"axis {name}: {speed:g} {self.unit}/s is off by {100 * error:.1f} % in whole units of the drive, "
                f"and the tolerance is {100 * self.speed_tolerance_fraction:g} %",
                f"ask for {scale.to_speed(below):.4g} or {scale.to_speed(below + 1):.4g} {self.unit}/s, "
                "or raise speed_tolerance_fraction",
            )

    def conflicts(self) -> Iterable[Conflict]:
        """Yield limits without room for the backlash, a lead of what turns, and inputs that the drive does not have."""
        low, known = self.limits[0], (*self.analog_inputs, *self.digital_inputs)
        if self.backlash and low <= 0 < low + self.backlash:
            yield Conflict(
                "limits",
                f"limits begin at {low:g}, and a move back to 0 passes it by the backlash, {self.backlash:g}",
                f"let them begin at {-self.backlash:g} or lower where the mechanics allow it",
            )
        if self.unit == "rad" and self.lead_mm is not None:
            yield Conflict("lead_mm", "an axis that turns has no lead", "write lead_mm: null")
        if self.homing.method not in self.homing_directions:
            methods = ", ".join(map(str, self.homing_directions))
            message = f"{self.homing.method} is no homing method of this drive"
            yield Conflict("homing.method", message, f"it has {methods}")
        for name, channel in self.inputs.items():
            if channel.source not in known:
                hint = f"it has {', '.join(known) or 'none that labrig knows'}"
                yield Conflict(f"inputs.{name}.source", f"{channel.source} is no input of this drive", hint)


def refuse_unreferenced(name: str) -> SafetyStopError:
    """Return why an axis without a reference may not be moved."""
    return SafetyStopError(
        f"axis {name} is not referenced: nobody knows where it stands",
        f"call session.reference_axes() before the first move, or first: labrig devices home --axis {name} --rig FILE",
    )
