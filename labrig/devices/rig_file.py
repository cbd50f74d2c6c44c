"""The rig file, how the rig stands: which bus and nodes, gears and limits, camera and calibration.

What is not known of a bench is written as `null`; such a file loads, so that it can be checked, but does not
open.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Literal, Self

import can
from pydantic import Field, PrivateAttr

from labrig.devices.camera_settings import CameraDescription, RigKind
from labrig.devices.driver_section import DriverSection
from labrig.devices.fault_script import FaultDescription
from labrig.devices.units import TURN_RAD, AxisScale
from labrig.errors import InputError, LimitError
from labrig.plugins import CAMERAS
from labrig.protocol.model import Conflict, Model, Name
from labrig.protocol.protocols import Needle
from labrig.protocol.schema import JsonSchema, model_schema
from labrig.protocol.yaml_file import load_yaml_model, model_of_values
from labrig.simulation.description import WorldDescription

Positive = Annotated[float, Field(gt=0)]
NodeId = Annotated[int, Field(ge=1, le=127)]
FileName = Annotated[str, Field(min_length=1, max_length=200)]

ONLY_SIMULATED = "simulated"
"""Name of the in-process CAN interface, and of a kind of rig."""

_WHERE_TO_FIND = {
    "encoder_pulses_per_turn": "lines of the encoder on the motor: data sheet, or 0x2210:01 in EPOS Studio",
    "gear_ratio": "turns of the motor a turn of the screw or shaft: plate of the gearhead; 1 without one",
    "lead_mm": "travel a turn of the screw: its data sheet, or ten turns measured and divided by ten",
}
_INT32 = 2**31


class HeartbeatDescription(Model):
    """Heartbeats: the drives stop when the computer's stops, and the computer stops them when one of theirs does."""

    computer_node_id: NodeId = Field(127, description="Node id under which the computer beats.")
    period_ms: Annotated[int, Field(ge=10, le=1000)] = Field(100, description="A beat this often [ms].")
    timeout_ms: Annotated[int, Field(ge=100, le=10_000)] = Field(
        500,
        description="Silence after which the drives stop by themselves, and the computer stops them [ms].",
    )

    def conflicts(self) -> Iterable[Conflict]:
        """Yield a timeout that one late beat would trip."""
        if self.timeout_ms < 3 * self.period_ms:
            yield Conflict(
                "timeout_ms",
                f"timeout_ms is {self.timeout_ms}, below three periods of {self.period_ms}",
                f"write {3 * self.period_ms} or more, or beat more often",
            )


class CanDescription(Model):
    """The CAN bus on which the drives stand."""

    interface: Annotated[str, Field(min_length=1, max_length=40)] = Field(
        description="Interface of python-can (socketcan, pcan, kvaser, ixxat, slcan, ...); "
        "simulated stands for a bus inside the process."
    )
    channel: Annotated[str, Field(max_length=200)] = Field(
        "", description="Channel of the interface, such as can0."
    )
    bitrate: Literal[20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000] = Field(
        1_000_000, description="Bit rate; the drives must be set to the same [bit/s]."
    )
    answer_timeout_ms: Annotated[int, Field(ge=20, le=5000)] = Field(
        120,
        description="How long a drive may take to answer before it is asked once more; with the default a silent "
        "drive is found out, and every axis stopped, within half a second [ms].",
    )
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="Further arguments of the python-can interface, by name."
    )
    heartbeat: HeartbeatDescription = Field(default_factory=HeartbeatDescription, description="Heartbeats.")

    def conflicts(self) -> Iterable[Conflict]:
        """Yield an interface that python-can does not know."""
        known = sorted({ONLY_SIMULATED, *can.VALID_INTERFACES})
        if self.interface not in known:
            near = get_close_matches(self.interface, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"python-can knows {', '.join(known)}"
            yield Conflict("interface", f"unknown interface {self.interface}", hint)


class HomingDescription(Model):
    """How an axis gets its reference."""

    method: Literal[35, -1, -2, -3, -4, 1, 2, 17, 18] = Field(
        35,
        description="maxon's homing method. 35: where it stands, on confirmation. -1, -3: into the stop in the motor's "
        "positive direction, -2, -4: in its negative one, by current, -1 and -2 then to the index. 1, 2, 17, 18: limit "
        "switches.",
    )
    position: float = Field(0.0, description="What the position is once home is found [mm or rad].")
    offset: Annotated[float, Field(ge=0)] = Field(
        0.0, description="How far to move off the stop or switch before [mm or rad]."
    )
    speed: Positive = Field(1.0, description="Speed of the search [mm/s or rad/s].")
    current_threshold_ma: Annotated[int, Field(ge=1, le=65535)] = Field(
        500, description="Current at which a stop is believed to be reached [mA]."
    )
    timeout_s: Annotated[float, Field(gt=0, le=600)] = Field(
        60.0, description="When the search is given up [s]."
    )


class AxisDescription(Model):
    """One axis: its drive, its mechanics and its limits. Lengths are mm, or rad where `unit` is rad."""

    node_id: NodeId = Field(description="CANopen node id of the drive, as its DIP switches are set.")
    unit: Literal["mm", "rad"] = Field(description="mm for an axis that travels, rad for one that turns.")
    encoder_pulses_per_turn: Annotated[int, Field(ge=16, le=65535)] | None = Field(
        description="Lines of the encoder a turn of the motor; a quadcount is a quarter. null: unknown [-]."
    )
    gear_ratio: Annotated[float, Field(gt=0, le=10_000)] | None = Field(
        description="Turns of the motor a turn of the screw or shaft. null: unknown [-]."
    )
    lead_mm: Annotated[float, Field(gt=0, le=1000)] | None = Field(
        description="Travel a turn of the screw; null: unknown, or an axis that turns [mm]."
    )
    reversed: bool = Field(
        default=False, description="Whether the axis goes backwards when the motor's counter goes up."
    )
    limits: tuple[float, float] = Field(
        description="Lowest and highest position that a move may have [mm or rad]."
    )
    max_speed: Positive = Field(description="Highest speed that a move may have [mm/s or rad/s].")
    acceleration: Positive = Field(description="Acceleration and deceleration of moves [mm/s^2 or rad/s^2].")
    quick_stop_deceleration: Positive = Field(
        description="Deceleration of a quick stop and after a fault [mm/s^2 or rad/s^2]."
    )
    speed_tolerance_fraction: Annotated[float, Field(gt=0, le=0.5)] = Field(
        0.01,
        description="The drive takes integer rpm; a move whose speed this changes by more is refused [-].",
    )
    position_window: Positive = Field(
        description="A move is done when the axis stands within this [mm or rad]."
    )
    position_window_time_ms: Annotated[int, Field(ge=0, le=10_000)] = Field(
        20, description="... for this long [ms]."
    )
    max_following_error: Positive = Field(
        description="The drive goes to fault when the axis lags further behind its profile [mm or rad]."
    )
    backlash: Annotated[float, Field(ge=0)] = Field(
        0.0,
        description="Measured play of screw and gear. Moves downwards go this far beyond their target and come "
        "back, so that every move ends from the same side [mm or rad].",
    )
    homing: HomingDescription = Field(default_factory=HomingDescription, description="How it is referenced.")
    configuration_fingerprint: (
        tuple[Annotated[int, Field(ge=0, lt=2**32)], Annotated[int, Field(ge=0, lt=2**32)]] | None
    ) = Field(
        None,
        description="Date and time in 0x1020 of the drive, which it clears when a parameter is changed: a drive with "
        "others is refused. null: not compared [-].",
    )
    lag_s: Annotated[float, Field(ge=0, le=30)] = Field(
        0.0,
        description="Measured time by which what the axis moves follows later than its drive: a needle winds up while "
        "it is turned in gel. A turn of the bevel waits for it before the needle goes on [s].",
    )
    limit_switches: tuple[Literal["negative", "positive"], ...] = Field(
        (), description="Limit switches that are wired and must stop the drive; by default it ignores them."
    )

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the entries that are unknown."""
        needed = ("encoder_pulses_per_turn", "gear_ratio", *(("lead_mm",) if self.unit == "mm" else ()))
        return tuple(name for name in needed if getattr(self, name) is None)

    def scale(self) -> AxisScale:
        """Return the conversion to quadcounts and rpm.

        Raises
        ------
        InputError
            When an entry that it needs is unknown.
        """
        travel = self.lead_mm if self.unit == "mm" else TURN_RAD
        if self.encoder_pulses_per_turn is None or self.gear_ratio is None or travel is None:
            raise InputError(f"unknown: {', '.join(self.unknown)}", "enter them in the rig file")
        return AxisScale(self.encoder_pulses_per_turn, self.gear_ratio, travel, self.reversed)

    def conflicts(self) -> Iterable[Conflict]:
        """Yield limits in the wrong order, a lead where there is none, and what a drive cannot hold."""
        low, high = self.limits
        if low >= high:
            yield Conflict(
                "limits", f"limits are [{low:g}, {high:g}], expected the lower one first", "exchange them"
            )
        elif self.backlash >= high - low:
            yield Conflict(
                "backlash", f"backlash is {self.backlash:g}, as long as the axis", "enter what was measured"
            )
        if self.unit == "rad" and self.lead_mm is not None:
            yield Conflict("lead_mm", "an axis that turns has no lead", "write lead_mm: null")
        if not self.unknown:
            yield from self._scale_conflicts(self.scale())

    def _scale_conflicts(self, scale: AxisScale) -> Iterator[Conflict]:
        farthest = max(map(abs, self.limits)) * scale.quadcounts_per_unit
        if farthest >= _INT32:
            yield Conflict(
                "limits",
                f"limits reach {farthest:.3g} quadcounts, the drive's counter holds {_INT32}",
                "check encoder, gear_ratio, lead_mm and limits",
            )
        if self.max_speed * scale.rpm_per_speed < 0.5:
            slowest = scale.to_speed(1)
            yield Conflict(
                "max_speed",
                f"max_speed is {self.max_speed:g}, below 1 rpm of the motor, {slowest:.3g}",
                "check gear_ratio, lead_mm and max_speed",
            )
        if self.max_speed * scale.rpm_per_speed > 25_000:
            rpm = self.max_speed * scale.rpm_per_speed
            yield Conflict(
                "max_speed",
                f"max_speed is {rpm:.0f} rpm of the motor, the drive's limit is 25000 rpm",
                f"write {scale.to_speed(25_000):.4g} or less, or check gear_ratio and lead_mm",
            )


class AxesDescription(Model):
    """The three axes of the instrument."""

    insertion: AxisDescription = Field(description="Screw that pushes the needle out of the sheath.")
    rotation: AxisDescription = Field(description="Turns the needle about its axis.")
    linear: AxisDescription = Field(description="Linear module that carries the instrument with the sheath.")

    def items(self) -> tuple[tuple[str, AxisDescription], ...]:
        """Return the axes with their names, in the order in which they are connected."""
        return (("insertion", self.insertion), ("rotation", self.rotation), ("linear", self.linear))

    def conflicts(self) -> Iterable[Conflict]:
        """Yield node ids that two axes share, and units that do not fit the axis."""
        owners: dict[int, str] = {}
        for name, axis in self.items():
            other = owners.setdefault(axis.node_id, name)
            if other != name:
                yield Conflict(
                    f"{name}.node_id",
                    f"node_id {axis.node_id} is also that of axis {other}",
                    "give every drive a node id of its own, by its DIP switches",
                )
            expected = "rad" if name == "rotation" else "mm"
            if axis.unit != expected:
                yield Conflict(f"{name}.unit", f"unit of axis {name} is {axis.unit}, expected {expected}")


class CalibrationDescription(Model):
    """Which calibration belongs to this rig."""

    intrinsics: FileName | None = Field(
        description="File of the lens, beside the rig file. null: not yet calibrated."
    )
    plane: FileName | None = Field(
        description="File of the steering plane, beside the rig file. null: not yet."
    )
    template: FileName | None = Field(
        None,
        description="Picture of the needle's tip by which insertions find it, beside the rig file, with a JSON of the "
        "same name; labrig calibrate template makes it. null: not yet.",
    )
    mask: FileName | None = Field(
        None,
        description="Pixels that are never the needle (a clamp, a reflection), beside the rig file: a picture of the "
        "camera's size, white there, or polygons as JSON. Every run keeps it. null: none.",
    )


class RecordingDescription(Model):
    """How a run is recorded."""

    state_rate_hz: Annotated[float, Field(gt=0, le=100)] = Field(
        10.0, description="States recorded a second while axes move [Hz]."
    )
    fsync_period_s: Annotated[float, Field(gt=0, le=60)] = Field(
        1.0,
        description="The record is forced to disk this often; a power cut loses at most what came since [s].",
    )
    least_free_mb: Annotated[float, Field(ge=0, le=1e6)] = Field(
        100.0, description="A run ends as failed when its disk has less free space than this [MB]."
    )


class RigDescription(Model):
    """A rig file of labrig."""

    schema_version: Literal[1] = Field(1, description="Version of this format.")
    name: Name = Field(description="What the rig is called in records and reports.")
    kind: RigKind = Field(description="simulated, or bench for real drives and a real camera.")
    state_file: FileName | None = Field(
        None,
        description="Where the rig keeps across runs whether a needle is in tissue, relative to this file. "
        "null: it is forgotten when labrig ends, as befits a simulated rig, which is new in every run.",
    )
    can: CanDescription = Field(description="The CAN bus.")
    axes: AxesDescription = Field(description="The three axes.")
    camera: Annotated[CameraDescription, DriverSection(CAMERAS, CameraDescription)] = Field(
        description="The camera."
    )
    calibration: CalibrationDescription = Field(description="Calibration files.")
    recording: RecordingDescription = Field(default_factory=RecordingDescription, description="The record.")
    world: WorldDescription | None = Field(
        None, description="What a simulated rig lives in; none on a bench."
    )

    faults: tuple[FaultDescription, ...] = Field(
        (), description="What is to go wrong on a simulated rig, and when; none on a bench."
    )

    _folder: Path = PrivateAttr(default=Path())

    def conflicts(self) -> Iterable[Conflict]:
        """Yield parts that do not belong together: a rig is simulated as a whole or not at all."""
        simulated = self.kind == ONLY_SIMULATED
        if (self.world is not None) != simulated:
            needs = "needs a section world" if simulated else "has no section world"
            yield Conflict("world" if self.world else "kind", f"a rig of kind {self.kind} {needs}")
        fits = {
            "can.interface": (self.can.interface, (self.can.interface == ONLY_SIMULATED) == simulated),
            "camera.driver": (self.camera.driver, self.kind in self.camera.rig_kinds),
        }
        for key, (chosen, fit) in fits.items():
            if not fit:
                yield Conflict(key, f"{key} is {chosen}, which does not go with kind {self.kind}")
        if self.faults and not simulated:
            yield Conflict("faults", "faults are for simulated rigs, a bench has its own")
        computer = self.can.heartbeat.computer_node_id
        for name, axis in self.axes.items():
            if axis.node_id == computer:
                yield Conflict(
                    f"axes.{name}.node_id",
                    f"node_id {computer} is that under which the computer beats",
                    "change it, or can.heartbeat.computer_node_id",
                )
        if not simulated and self.state_file is None:
            yield Conflict("state_file", "a bench needs a state_file: it must not forget a needle in tissue")
        if self.world is not None:
            yield from self._lens_conflicts(self.world)

    def _lens_conflicts(self, world: WorldDescription) -> Iterator[Conflict]:
        size, lens = (
            (self.camera.width_px, self.camera.height_px),
            (world.lens.width_px, world.lens.height_px),
        )
        if size != lens:
            message = (
                f"the camera is set to {size[0]}x{size[1]} px, the world's lens draws {lens[0]}x{lens[1]} px"
            )
            yield Conflict("camera.width_px", message)

    def placed_in(self, folder: Path) -> Self:
        """Return this description as of a file in `folder`, to which its file names are relative."""
        placed = self.model_copy()
        placed._folder = folder  # noqa: SLF001 - of this class; not a field, so that it enters neither file nor record
        return placed

    def with_needle(self, needle: Needle) -> Self:
        """Return this description with the protocol's designed needle in its world.

        Nothing changes on a bench, for a needle without a design, or where the rig file itself says what the
        needle was designed for: the world need not be what the protocol believes.

        Raises
        ------
        FileFormatError
            When the world's sheath and camera have no room for such a needle.
        """
        design = needle.design
        if self.world is None or design is None or self.world.needle.design is not None:
            return self
        values = self.world.model_dump(mode="json")
        values["needle"] |= {
            "diameter_mm": needle.diameter_mm,
            "link_mm": design.link_length_mm,
            "design": {"radius_low_mm": design.radius_low_mm, "radius_high_mm": design.radius_high_mm},
        }
        world = model_of_values(
            values, f"the simulated world with needle {needle.needle_id}", WorldDescription
        )
        changed = self.model_copy(update={"world": world})
        return changed.placed_in(self._folder)

    @property
    def folder(self) -> Path:
        """Folder of the rig file, to which its file names are relative."""
        return self._folder

    @property
    def state_path(self) -> Path | None:
        """Where the rig keeps its state across runs, or None."""
        return None if self.state_file is None else self._folder / self.state_file

    def calibration_paths(self) -> dict[str, Path]:
        """Return the calibration files that the rig file names, by the name that they have in a record."""
        named = {"intrinsics.json": self.calibration.intrinsics, "plane.json": self.calibration.plane}
        return {name: self._folder / file for name, file in named.items() if file is not None}

    def template_paths(self) -> dict[str, Path]:
        """Return picture and sidecar of the tip's template, by the name that they have in a record."""
        if self.calibration.template is None:
            return {}
        picture = self._folder / self.calibration.template
        return {"template.png": picture, "template.json": picture.with_suffix(".json")}

    def mask_paths(self) -> dict[str, Path]:
        """Return the mask by the name that it has in a record; empty where the rig file names none."""
        if self.calibration.mask is None:
            return {}
        path = self._folder / self.calibration.mask
        return {f"mask{path.suffix}": path}

    def calibration_files(self) -> dict[str, Path]:
        """Return the files named that exist: a rig that is being calibrated has none yet."""
        named = self.calibration_paths() | self.template_paths() | self.mask_paths()
        return {name: path for name, path in named.items() if path.is_file()}


_OTHER_KINDS = {
    "experiment": ("this is a protocol, expected a rig file", "such as calibration/rig-simulated.yaml")
}


def load_rig(path: Path | str, overrides: Sequence[str] = ()) -> RigDescription:
    """Read a rig file.

    Parameters
    ----------
    path : Path or str
        The file.
    overrides : sequence of str
        `dotted.key=value`, put in before validation.

    Raises
    ------
    FileFormatError
        With every fault of the file, each with its line and column.
    """
    return load_yaml_model(path, RigDescription, overrides, _OTHER_KINDS).placed_in(Path(path).parent)


def rig_schema() -> JsonSchema:
    """Return the JSON Schema of rig files."""
    return model_schema(RigDescription, "labrig rig file")


def unknown_entries(rig: RigDescription) -> dict[str, str]:
    """Return each entry that is null because nobody has entered it yet -> where to find it."""
    return {
        f"axes.{name}.{entry}": _WHERE_TO_FIND[entry]
        for name, axis in rig.axes.items()
        for entry in axis.unknown
    }


def require_complete(rig: RigDescription, axes: Collection[str]) -> None:
    """Refuse a rig file with unknown entries of these axes, naming each.

    Raises
    ------
    InputError
    """
    unknown = [entry for entry in unknown_entries(rig) if entry.split(".")[1] in axes]
    if unknown:
        raise InputError(
            f"rig {rig.name} cannot be opened, unknown: {', '.join(unknown)}",
            "enter them in the rig file; labrig devices check --rig FILE says where to find each",
        )


def check_axis_move(rig: RigDescription, axis_name: str, position: float, speed: float) -> None:
    """Refuse a move that an axis of this rig may not make; nothing is opened.

    Parameters
    ----------
    axis_name : str
        insertion, rotation or linear.
    position : float
        Where to [mm or rad].
    speed : float
        How fast [mm/s or rad/s].

    Raises
    ------
    LimitError
        Names axis, value and limit. A speed is also refused when integer rpm of the motor miss it by more
        than the tolerance; that part is left out while gear, lead or encoder are unknown.
    """
    axis = dict(rig.axes.items())[axis_name]
    check_move(axis_name, axis, position, speed)


def check_move(name: str, axis: AxisDescription, position: float, speed: float) -> None:
    """Refuse a move that an axis may not make, as `check_axis_move` does."""
    low, high = axis.limits
    if not low <= position <= high:
        raise LimitError(
            f"axis {name}: {position:g} {axis.unit} is beyond its limits [{low:g}, {high:g}] {axis.unit}",
            "ask for less, or widen axes limits in the rig file where the mechanics allow it",
        )
    if not 0 < speed <= axis.max_speed:
        raise LimitError(
            f"axis {name}: speed {speed:g} {axis.unit}/s is not within 0 to {axis.max_speed:g} {axis.unit}/s",
            "ask for a slower move, or raise max_speed in the rig file where the mechanics allow it",
        )
    if not axis.unknown:
        _check_rounding(name, axis, speed)


def _check_rounding(name: str, axis: AxisDescription, speed: float) -> None:
    scale = axis.scale()
    rpm = scale.to_rpm(speed)
    error = abs(scale.to_speed(rpm) - speed) / speed
    if error > axis.speed_tolerance_fraction:
        below = max(1, math.floor(speed * scale.rpm_per_speed))
        raise LimitError(
            f"axis {name}: {speed:g} {axis.unit}/s is {speed * scale.rpm_per_speed:.2f} rpm of the motor; "
            f"the drive takes {rpm}, off by {100 * error:.1f} %, and the tolerance is "
            f"{100 * axis.speed_tolerance_fraction:g} %",
            f"ask for {scale.to_speed(below):.4g} or {scale.to_speed(below + 1):.4g} {axis.unit}/s, "
            "or raise speed_tolerance_fraction",
        )
