"""The rig file, how the rig stands: which bus and nodes, gears and limits, camera and calibration.

What is not known of a bench is written as `null`; such a file loads, so that it can be checked, but does not
open.
"""

import shlex
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr

from labrig.devices.axis_description import AXES, DEFAULT_DRIVER, WHERE_TO_FIND, AxisDescription
from labrig.devices.camera import CameraDescription, RigKind
from labrig.devices.can_description import ONLY_SIMULATED, CanDescription
from labrig.devices.driver_section import DriverSection
from labrig.devices.drives.settings import find_conflicts
from labrig.devices.fault_script import FaultDescription
from labrig.errors import InputError, Problem
from labrig.plugins import CAMERAS, DRIVES, Plugin, find_plugin
from labrig.protocol.model import Conflict, Model, Name
from labrig.protocol.schema import JsonSchema, model_schema
from labrig.protocol.sections import Needle
from labrig.protocol.yaml_file import load_yaml_model, validate_values
from labrig.simulation.description import WorldDescription

FileName = Annotated[str, Field(min_length=1, max_length=200)]
_Axis = Annotated[AxisDescription, DriverSection(DRIVES, AxisDescription, DEFAULT_DRIVER)]


_AS_A_WHOLE = "a rig is simulated as a whole or not at all"
_HINTS = {
    "state_file": "name a file, such as bench.state.json",
    "camera.width_px": "write the same size under camera and world: lens",
}


class AxesDescription(Model):
    """The three axes of the instrument."""

    insertion: _Axis
    """Screw that pushes the needle out of the sheath."""
    rotation: _Axis
    """Turns the needle about its axis."""
    linear: _Axis
    """Linear module that carries the instrument with the sheath."""

    def items(self) -> tuple[tuple[str, AxisDescription], ...]:
        """Return the axes with their names, in the order in which they are connected."""
        return (("insertion", self.insertion), ("rotation", self.rotation), ("linear", self.linear))

    def named(self, name: str) -> AxisDescription:
        """Return an axis. Raises `LookupError` for another name."""
        axes = dict(self.items())
        if name not in axes:
            raise LookupError(f"there is no axis {name!r}, only {', '.join(axes)}")
        return axes[name]

    def conflicts(self) -> Iterable[Conflict]:
        """Yield names of inputs that two axes share, and units that do not fit the axis."""
        wired: dict[str, str] = {}
        for name, axis in self.items():
            for channel in axis.inputs:
                other = wired.setdefault(channel, name)
                if other != name:
                    message = f"input {channel} is also one of axis {other}"
                    yield Conflict(f"{name}.inputs.{channel}", message, "give every input a name of its own")
            expected = "rad" if name == "rotation" else "mm"
            if axis.unit != expected:
                message = f"unit of axis {name} is {axis.unit}, expected {expected}"
                yield Conflict(f"{name}.unit", message, f"write unit: {expected}")


class CalibrationDescription(Model):
    """Which calibration belongs to this rig."""

    intrinsics: FileName | None
    """File of the lens, beside the rig file. null: not yet calibrated."""
    plane: FileName | None
    """File of the steering plane, beside the rig file. null: not yet."""
    template: FileName | None = None
    """Picture of the needle's tip by which insertions find it, beside the rig file, with a JSON of the same
    name; labrig calibrate template makes it. null: not yet."""
    mask: FileName | None = None
    """Pixels that are never the needle (a clamp, a reflection), beside the rig file: a picture of the
    camera's size, white there. Every run keeps it. null: none."""


class RecordingDescription(Model):
    """How a run is recorded."""

    state_rate_hz: Annotated[float, Field(gt=0, le=100)] = 10.0
    """States recorded a second while axes move [Hz]."""
    fsync_period_s: Annotated[float, Field(gt=0, le=60)] = 1.0
    """The record is forced to disk this often; a power cut loses at most what came since [s]."""
    least_free_mb: Annotated[float, Field(ge=0, le=1e6)] = 100.0
    """A run ends as failed when its disk has less free space than this [MB]."""


class RigDescription(Model):
    """A rig file of labrig."""

    schema_version: Literal[1] = 1
    """Version of this format."""
    name: Name
    """What the rig is called in records and reports."""
    kind: RigKind
    """simulated, or bench for real drives and a real camera."""
    clock: Literal["real"] | None = None
    """real: a simulated rig runs at a bench's pace and asks its questions, to rehearse on it. null: it runs
    as fast as the processor allows and answers by itself. A bench always runs in real time."""
    state_file: FileName | None = None
    """Where the rig keeps across runs whether a needle is in tissue, relative to this file. null: it is
    forgotten when labrig ends, as befits a simulated rig, which is new in every run."""
    can: CanDescription
    """The CAN bus."""
    axes: AxesDescription
    """The three axes."""
    camera: Annotated[CameraDescription, DriverSection(CAMERAS, CameraDescription)]
    """The camera."""
    calibration: CalibrationDescription
    """Calibration files."""
    recording: RecordingDescription = Field(default_factory=RecordingDescription)
    """The record."""
    world: WorldDescription | None = None
    """What a simulated rig lives in; none on a bench."""

    faults: tuple[FaultDescription, ...] = ()
    """What is to go wrong on a simulated rig, and when; none on a bench."""

    _folder: Path = PrivateAttr(default=Path())
    _file: Path | None = PrivateAttr(default=None)

    def conflicts(self) -> Iterable[Conflict]:
        """Yield parts that do not belong together: a rig is simulated as a whole or not at all."""
        simulated, unfit = self.kind == ONLY_SIMULATED, f"does not go with kind {self.kind}"
        wrong: dict[str, str] = {}
        if (self.can.interface == ONLY_SIMULATED) != simulated:
            wrong["can.interface"] = f"{self.can.interface} {unfit}"
        if self.kind not in self.camera.rig_kinds:
            wrong["camera.driver"] = f"{self.camera.driver} {unfit}"
        if simulated and self.world is None:
            wrong["kind"] = f"a rig of kind {self.kind} needs a section world"
        for key in () if simulated else ("world", "faults"):
            if getattr(self, key):
                wrong[key] = f"a rig of kind {self.kind} has no section {key}"
        if not simulated and self.state_file is None:
            wrong["state_file"] = "a bench needs a state_file: it must not forget a needle in tissue"
        if self.world is not None:
            seen, drawn = (f"{of.width_px}x{of.height_px}" for of in (self.camera, self.world.lens))
            if seen != drawn:
                message = f"the camera is set to {seen} px, the world's lens draws {drawn} px"
                wrong["camera.width_px"] = message
        yield from (Conflict(key, message, _HINTS.get(key, _AS_A_WHOLE)) for key, message in wrong.items())
        yield from self._find_shared_nodes()

    def _find_shared_nodes(self) -> Iterator[Conflict]:
        owners = {self.can.heartbeat.computer_node_id: "that under which the computer beats"}
        for name, axis in self.axes.items():
            other = owners.setdefault(axis.node_id, f"that of axis {name}")
            if other != f"that of axis {name}":
                message = f"node_id {axis.node_id} is also {other}"
                hint = "give every drive a node id of its own, by its switches"
                yield Conflict(f"axes.{name}.node_id", message, hint)

    def placed_in(self, folder: Path, file: Path | None = None) -> Self:
        """Return this description as of a file in `folder`, to which its file names are relative.

        `file` is what a hint names, in a command for this rig.
        """
        axes = {name: axis.placed_in(folder) for name, axis in self.axes.items()}
        placed = self.model_copy(update={"axes": self.axes.model_copy(update=axes)})
        # Of this class; no fields, so that they enter neither file nor record.
        placed._folder, placed._file = folder, file  # noqa: SLF001
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
        world = validate_values(
            values, f"the simulated world with needle {needle.needle_id}", WorldDescription
        )
        changed = self.model_copy(update={"world": world})
        return changed.placed_in(self._folder, self._file)

    @property
    def asks_person(self) -> bool:
        """Whether a person answers its questions: on a bench, and where one is rehearsed."""
        return self.kind != ONLY_SIMULATED or self.clock == "real"

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """Its kinds of drives and its kind of camera, each once. Raises `InputError` as `find_plugin`."""
        drivers = [*((DRIVES, axis.driver) for _, axis in self.axes.items()), (CAMERAS, self.camera.driver)]
        return tuple(find_plugin(group, name) for group, name in dict.fromkeys(drivers))

    @property
    def folder(self) -> Path:
        """Folder of the rig file, to which its file names are relative."""
        return self._folder

    @property
    def option(self) -> str:
        """The option that names its file in a command; `--rig FILE` as it stands if no file is known."""
        return f"--rig {'FILE' if self._file is None else shlex.quote(str(self._file))}"

    @property
    def state_path(self) -> Path | None:
        """Where the rig keeps its state across runs, or None."""
        return None if self.state_file is None else self._folder / self.state_file

    def calibration_file(self, kind: str) -> Path | None:
        """Return the file of the calibration: intrinsics, plane, template or mask; None where none is named."""
        named = getattr(self.calibration, kind)
        return None if named is None else self._folder / named

    def calibration_paths(self) -> dict[str, Path]:
        """Return the files of lens and plane that the rig file names, by the name that they have in a record."""
        paths = {f"{kind}.json": self.calibration_file(kind) for kind in ("intrinsics", "plane")}
        return {name: path for name, path in paths.items() if path is not None}

    def calibration_files(self) -> dict[str, Path]:
        """Return the files named that exist, those of the axes too, by the name that they have in a record."""
        named = self.calibration_paths()
        if template := self.calibration_file("template"):
            named |= {"template.png": template, "template.json": template.with_suffix(".json")}
        if mask := self.calibration_file("mask"):
            named[f"mask{mask.suffix}"] = mask
        for name, axis in self.axes.items():
            named |= {kept_name(name, key, path): path for key, path in axis.files.items()}
        return {name: path for name, path in named.items() if path.is_file()}


def kept_name(axis: str, key: str, path: Path) -> str:
    """Return the name in a record of the file that an axis names by a key."""
    return f"{axis}-{key}{path.suffix}"


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
    return load_yaml_model(path, RigDescription, overrides, _OTHER_KINDS).placed_in(
        Path(path).parent, Path(path)
    )


def rig_schema() -> JsonSchema:
    """Return the JSON Schema of rig files."""
    return model_schema(RigDescription, "labrig rig file")


def find_problems(rig: RigDescription, axes: Collection[str] = AXES) -> tuple[Problem, ...]:
    """Return which entries of axes nobody has entered yet, and what is wrong with their files and settings."""
    return tuple(
        Problem(f"axes.{name}.{found.key}", found.message, found.hint)
        for name, axis in rig.axes.items()
        if name in axes
        for found in (
            *(Conflict(key, "unknown", f"enter it: {WHERE_TO_FIND[key]}") for key in axis.unknown),
            *find_conflicts(axis),
        )
    )


def require_complete(rig: RigDescription, axes: Collection[str] = AXES) -> None:
    """Refuse a rig file with problems of these axes. Raises `InputError`, which names each."""
    if problems := find_problems(rig, axes):
        told = "; ".join(f"{problem.where}: {problem.message}" for problem in problems)
        more = f"; labrig devices check {rig.option} says what to do about each" if len(problems) > 1 else ""
        raise InputError(f"rig {rig.name} cannot be opened: {told}", f"{problems[0].hint}{more}")
