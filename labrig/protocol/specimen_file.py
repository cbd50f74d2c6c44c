"""A specimen file: one block of gel, how it was made, and what is known of it.

It is here and not beside the experiments because protocols name it: what it says is filled into the protocol, so that a
record needs no file outside of it. The tracks of earlier runs are filled in too, when a run is made or checked.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from pydantic import AfterValidator, Field

from labrig.errors import InputError
from labrig.input_file import read_file
from labrig.lab import SPECIMENS, find_in_lab
from labrig.protocol.model import Conflict, Line, Model, Name, Notes, PositiveMm
from labrig.protocol.schema import JsonSchema, model_schema
from labrig.protocol.yaml_file import load_yaml_model
from labrig.protocol.yaml_text import MAX_BYTES

SUFFIX = ".yaml"
MOST_TRACKS = 200
"""In all blocks of a protocol: four with 50 holes each. With them its record stays below what a YAML file may have."""

_NO_PATH = 'choose a name without "/", "\\" and ":" that does not begin with a dot, such as A1'


def _require_file_name(text: str) -> str:
    """Refuse a name that could lead out of its folder, or that some file system does not take."""
    if text.startswith(".") or any(character in '/\\:*?"<>|' for character in text):
        raise ValueError(f"a specimen's name is also that of its file: {_NO_PATH}")
    return text


def _require_moment(text: str) -> str:
    """Refuse what is not a time with its distance from UTC; without that, an age could be wrong by a day."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        raise ValueError("expected date, time and distance from UTC, such as 2026-11-20T09:30+01:00")
    return text


SpecimenName: TypeAlias = Annotated[Name, AfterValidator(_require_file_name)]
"""A name that is also the name of a file."""

Moment: TypeAlias = Annotated[str, Field(max_length=40), AfterValidator(_require_moment)]
"""A time with its distance from UTC, ISO 8601."""

Percent: TypeAlias = Annotated[float, Field(ge=1, le=50)]
_Celsius: TypeAlias = Annotated[float, Field(ge=-30, le=100)]
_Coordinate: TypeAlias = Annotated[float, Field(ge=-10_000, le=10_000)]


class SpecimenFile(Model):
    """One block of gel."""

    schema_version: Literal[1] = 1
    """Version of this file format; a higher one needs a newer labrig."""
    name: SpecimenName
    """Label on the block; also the name of this file."""
    gelatin_percent: Percent
    """Mass of gelatin powder per mass of water [percent]; 10 for 10 %."""
    batch: Line = ""
    """Batch of gelatin that the block was cast from."""
    cast_on: Moment
    """When the block was cast; its age counts from here."""
    cured_for_h: float | None = Field(None, ge=0, le=10_000)
    """How long the block cures before it is used [h]."""
    cured_at_celsius: _Celsius | None = None
    """Temperature at which it cures [°C]."""
    temperature_celsius: _Celsius | None = None
    """Its temperature when it is used [°C]."""
    usable_until: Moment | None = None
    """Until when it may be used; a run after that is refused. null: no end is set."""
    length_mm: PositiveMm | None = None
    """Length of the block along the insertion [mm]."""
    width_mm: PositiveMm | None = None
    """Width of the block across the insertion [mm]."""
    height_mm: PositiveMm | None = None
    """Height of the block [mm]."""
    notes: Notes = ""
    """Anything worth knowing later; may have several lines."""

    def conflicts(self) -> Iterator[Conflict]:
        """Yield times in the wrong order."""
        cast = datetime.fromisoformat(self.cast_on)
        if self.usable_until is not None and datetime.fromisoformat(self.usable_until) < cast:
            message = f"usable_until is {self.usable_until}, before cast_on, {self.cast_on}"
            yield Conflict("usable_until", message, "was the year typed wrong?")

    def find_age_h(self, moment: datetime) -> float:
        """Return the age at a moment, since the block was cast [h]; negative before that."""
        return (moment - datetime.fromisoformat(self.cast_on)).total_seconds() / 3600.0


class SpecimenTrack(Model):
    """The track that one insertion left in a block.

    Places count across the insertion from the first entry point, towards where later holes are, which is -y of the
    steering plane. `age_h` is the block's at the insertion.
    """

    run: str = Field(max_length=400)
    """The run that made it."""
    trial: int = Field(ge=0)
    """Its trial in that run."""
    hole: int = Field(ge=0)
    """Its hole in that run, from 0."""
    hole_position_mm: _Coordinate
    """Where it enters the block [mm]."""
    needle_id: Name
    """The needle."""
    sheath_diameter_mm: float = Field(gt=0, le=20)
    """Outer diameter of the sheath [mm]."""
    age_h: float
    """Age of the block at the insertion [h]."""


TracksBySpecimen: TypeAlias = Mapping[str, tuple[SpecimenTrack, ...]]
"""The tracks in each specimen, by its name, in order of time."""


class SpecimenSection(SpecimenFile):
    """What a specimen file gave when the protocol was read, and the tracks that were in the block then.

    labrig writes this section; people name the file.
    """

    sha256: str = Field(min_length=64, max_length=64)
    """SHA-256 of the specimen file."""
    tracks: tuple[SpecimenTrack, ...] = Field((), max_length=MOST_TRACKS)
    """Tracks of earlier runs in the block."""


def list_specimen_folders(protocol_folder: Path) -> tuple[Path, ...]:
    """Return where a protocol's specimens are looked for: in the lab folder, then beside the protocol's own folder."""
    return find_in_lab(SPECIMENS), protocol_folder.resolve().parent / SPECIMENS


def list_specimens(folder: Path | None = None) -> list[str]:
    """Return the names of the specimens in a folder, by default the lab's, in order; none without the folder."""
    return sorted(
        path.stem for path in (folder or find_in_lab(SPECIMENS)).glob(f"*{SUFFIX}") if path.is_file()
    )


def load_specimen(name: str, given: Sequence[Path] = ()) -> tuple[SpecimenFile, str]:
    """Return the specimen of this name from the first folder that has it, and the SHA-256 of its file.

    Parameters
    ----------
    given : sequence of Path
        The folders; by default the lab's.

    Raises
    ------
    InputError
        When the name is no file name, or no specimen has it; says which was probably meant. Or when its file is a link
        that leaves the folder.
    FileFormatError
        When the file is malformed, or names another specimen.
    """
    try:
        _require_file_name(name)
    except ValueError as error:
        raise InputError(f"specimen {name!r}: {error}", _NO_PATH) from error
    folders = given or (find_in_lab(SPECIMENS),)
    places = (folder / f"{name}{SUFFIX}" for folder in folders)
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        near = get_close_matches(name, [known for folder in folders for known in list_specimens(folder)], 1)
        raise InputError(
            f"there is no specimen {name} in {folders[0]}",
            f"did you mean {near[0]}?" if near else "labrig manual protocol says how to write its file",
        )
    if not path.resolve().is_relative_to(path.parent.resolve()):
        raise InputError(f"{path} is a link that leaves its folder", "put the file itself there")
    specimen = load_yaml_model(path, SpecimenFile, others=_OTHER_KINDS)
    if specimen.name != name:
        raise InputError(
            f"{path} holds the specimen {specimen.name}", f"rename it to {specimen.name}{SUFFIX}"
        )
    return specimen, hashlib.sha256(read_file(path, MAX_BYTES)).hexdigest()


_OTHER_KINDS: Mapping[str, tuple[str, str]] = {
    "experiment": ("this is a protocol, expected a specimen file", "labrig specimens"),
    "axes": ("this is a rig file, expected a specimen file", "labrig specimens"),
}


def specimen_schema() -> JsonSchema:
    """Return the JSON Schema (draft 2020-12) of a specimen file, for editors."""
    return model_schema(SpecimenFile, "labrig specimen")
