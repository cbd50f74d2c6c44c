"""The keys of every protocol, and the sections that several experiments share."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import ConfigDict, Field

from labrig.protocol.conditions import Condition
from labrig.protocol.model import (
    Conflict,
    Direction,
    LimitMa,
    Line,
    Model,
    Name,
    NonNegativeMm,
    Notes,
    PixelUv,
    PositiveMm,
    Seed,
    SpeedMmS,
)
from labrig.protocol.specimen_file import Percent, SpecimenSection, TracksBySpecimen
from labrig.protocol.tree import choice_hint

# With fewer, a lag that alternates in sign from roll to roll would shift the fitted zero.
_LEAST_TURNED_ROLLS = 6


@dataclass(frozen=True)
class NeedleInPicture:
    """Outer diameters of needle and sheath in a picture; the sheath's is None if the pictures show none."""

    diameter_mm: float
    sheath_diameter_mm: float | None


@dataclass(frozen=True)
class Criterion:
    """By what virtual runs are judged: a quantity of their outcome, and its largest value that counts as reached."""

    quantity: str
    tolerance: float | None = None


class ExperimentProtocol(Model):
    """The keys of every protocol."""

    pictures_decide_motion: ClassVar[bool] = False
    """Whether pictures decide where an axis moves next."""

    schema_version: Literal[1] = 1
    """Version of this file format; a higher one needs a newer labrig."""
    experiment: str
    title: Line = ""
    """Heading of the report."""
    operator: Line = ""
    """Name of the operator."""
    notes: Notes = ""
    """Anything worth knowing later; may have several lines."""
    seed: Seed
    """Seed of every random draw; the same seed and names give the same simulated run."""

    @property
    def pictured_needle(self) -> NeedleInPicture | None:
        """The needle in the pictures; None for an experiment without pictures of a needle."""
        return None

    @property
    def expected_radius_mm(self) -> float:
        """The radius of a needle's arcs that a dry run of a bench takes for true [mm]."""
        return 30.0

    @property
    def current_limits_ma(self) -> Mapping[str, int]:
        """Axis -> limit of its output current during the run [mA]; empty for an experiment that sets none."""
        return {}

    @property
    def gels(self) -> Mapping[str, "TrackedSpecimen"]:
        """Dotted key -> block of gel that may name a specimen file; empty for an experiment without any."""
        return {}

    def put_tracks(self, tracks: TracksBySpecimen) -> Self:  # noqa: ARG002 - has no gels
        """Return this protocol with the tracks in each of its specimens, by the specimen's name."""
        return self

    @property
    def criterion(self) -> Criterion | None:
        """By what a campaign compares virtual runs; None for an experiment that leaves it to the campaign."""
        return None

    def find_map_circles(self, horizontal: str, vertical: str) -> Sequence[tuple[float, float, float]]:  # noqa: ARG002
        """Return what a map over two keys shows: (horizontal, vertical, radius) each; by default nothing."""
        return ()


class CurrentLimits(Model):
    """Limits of the drives' output currents during a run, which bound the force of each axis; null: the rig file's."""

    insertion: LimitMa | None = None
    """Limit of the insertion axis [mA]."""
    rotation: LimitMa | None = None
    """Limit of the rotation axis [mA]."""
    linear: LimitMa | None = None
    """Limit of the linear axis [mA]."""


class MovingProtocol(ExperimentProtocol):
    """The keys of every protocol that moves a needle."""

    max_current_ma: CurrentLimits = Field(default_factory=CurrentLimits)
    """Limits of the drives' output currents during this run, none above that of the rig file."""

    @property
    def current_limits_ma(self) -> Mapping[str, int]:
        """Axis -> limit of its output current [mA]."""
        return self.max_current_ma.model_dump(exclude_none=True)


class JudgedProtocol(MovingProtocol):
    """The keys of a protocol whose run asks its person, or stops, on what it measures."""

    judged_values: ClassVar[Mapping[str, str]]
    """The values that conditions may be on: name -> what it is."""

    conditions: tuple[Condition, ...] = Field((), max_length=20)
    """Conditions on which the run asks or stops after an insertion."""

    def conflicts(self) -> Iterator[Conflict]:
        """Yield conditions on values that are not judged."""
        yield from super().conflicts()
        for number, condition in enumerate(self.conditions):
            if condition.value not in self.judged_values:
                hint = choice_hint(condition.value, self.judged_values)
                yield Conflict(f"conditions.{number}.value", f"no value is named {condition.value}", hint)


class NeedleDesignSection(Model):
    """What a design file gave when the protocol was read. labrig writes this section; people name the file."""

    file: str = Field(max_length=1000)
    """Name of the design file, as the protocol had it."""
    sha256: str = Field(min_length=64, max_length=64)
    """SHA-256 of that file."""
    radius_low_mm: PositiveMm
    """Smallest radius by the laser's tolerances and the fit's error [mm]."""
    radius_high_mm: PositiveMm
    """Largest radius by the laser's tolerances and the fit's error [mm]."""
    link_length_mm: float = Field(gt=0, le=100)
    """Length of a link, from hinge to hinge [mm]."""


def _allow_file(
    key: str, description: str, instead_of: Sequence[str], filled: str
) -> Callable[[dict[str, Any]], None]:
    """Return what lets editors accept a file, named under a key, instead of other keys of a section.

    The reader fills in those, and `filled`, before validation.
    """

    def allow(schema: dict[str, Any]) -> None:
        named = {"description": description, "type": "string", "minLength": 1, "maxLength": 1000}
        schema["properties"] |= {key: named}
        schema["required"] = [name for name in schema["required"] if name not in instead_of]
        schema |= {
            "if": {"required": [key]},
            "then": {"properties": {filled: False}},
            "else": {"required": list(instead_of)},
        }

    return allow


class Needle(Model):
    """The needle of the run: its numbers, or `design_file` instead of them."""

    model_config = ConfigDict(
        json_schema_extra=_allow_file(
            "design_file",
            "Design file that gives diameter_mm and design_radius_mm with its tolerance, relative to this file; "
            "written by a run of protocols/design.yaml.",
            ("diameter_mm", "design_radius_mm"),
            "design",
        )
    )

    needle_id: Name
    """Name of the needle; results are grouped by needle and gel."""
    diameter_mm: float = Field(gt=0, le=10)
    """Outer diameter of the needle [mm]."""
    design_radius_mm: PositiveMm
    """Radius of curvature that the needle was designed for [mm]."""
    design: NeedleDesignSection | None = None
    """Numbers of the design file; labrig writes them into records."""

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a radius that is not above the needle's diameter."""
        yield from check_radius(self.diameter_mm, self.design_radius_mm)


class Specimen(Model):
    """One block of gel."""

    name: Name
    """Label on the block; unique in the protocol."""
    gelatin_percent: Percent
    """Mass of gelatin powder per mass of water [percent]; 10 for 10 %."""


class TrackedSpecimen(Specimen):
    """One block of gel; one with a specimen file keeps its tracks from run to run."""

    model_config = ConfigDict(
        json_schema_extra=_allow_file(
            "specimen_file",
            "Name of the specimen, whose file in data/specimens gives name, gelatin_percent, age and what else is "
            "known.",
            ("name", "gelatin_percent"),
            "block",
        )
    )

    block: SpecimenSection | None = None
    """What the specimen file says; labrig writes it into records."""
    first_hole_mm: NonNegativeMm = 0.0
    """Where the first hole of this run is, from the first entry point that the block ever had [mm]."""
    track_clearance_mm: NonNegativeMm = 2.0
    """Least distance between the sheath in a planned hole and that in an old one [mm]; needs a specimen file.
    2: each of the two sheaths may have been 1 mm aside (sheath.origin.across_mm)."""
    allow_crossing: bool = False
    """Whether a planned hole may come closer to an old one."""

    def put_tracks(self, tracks: TracksBySpecimen) -> Self:
        """Return this gel with the tracks of its specimen; unchanged without a specimen file."""
        if self.block is None:
            return self
        held = self.block.model_copy(update={"tracks": tracks.get(self.block.name, ())})
        return self.model_copy(update={"block": held})


class SheathOrigin(Model):
    """How far the sheath in the gel may be from its command, by the picture; a trial beyond the limits is refused.

    Along the insertion the linear encoder measures, so only the error of a zero set by eye remains. Across it the
    sheath has play, and the insertion starts where the sheath is found; the limit is for what play cannot explain.
    """

    depth_mm: PositiveMm | None = None
    """Depth of the sheath at which its tip is at the origin of the steering plane [mm]; null: the sheath's
    depth_mm."""
    along_mm: PositiveMm = 0.5
    """Limit along the insertion, from the tip's position by the linear encoder [mm]."""
    across_mm: PositiveMm = 1.0
    """Limit across the insertion, where the sheath has play [mm]."""
    turn_deg: float = Field(2.0, gt=0, le=45)
    """Largest angle between sheath and insertion [deg]."""


class Sheath(Model):
    """The tube that brings the needle into the gel."""

    depth_mm: PositiveMm
    """How far the linear module brings the sheath into the gel [mm]."""
    speed_mm_s: SpeedMmS
    """Speed of the sheath, in and out [mm/s]."""
    diameter_mm: float = Field(gt=0, le=20)
    """Outer diameter of the sheath [mm]."""
    origin: SheathOrigin | None = None
    """Tip and direction of the sheath are measured and compared with the command, and an insertion to a
    target starts from them. null: they are not measured."""

    @property
    def origin_depth_mm(self) -> float:
        """The depth at which its tip is expected at the origin of the steering plane."""
        depth_mm = None if self.origin is None else self.origin.depth_mm
        return self.depth_mm if depth_mm is None else depth_mm


class Advance(Model):
    """How fast the needle goes in and comes out."""

    speed_mm_s: SpeedMmS
    """Insertion speed [mm/s]."""
    withdraw_speed_mm_s: SpeedMmS
    """Speed of the way back [mm/s]."""


class TorsionSteps(Model):
    """How the torsion of the needle is measured: at each depth in two holes, turned to 90 degrees from either side."""

    depths_mm: tuple[Annotated[float, Field(ge=20, le=500)], ...] = Field(
        (30.0, 50.0, 70.0), min_length=2, max_length=6
    )
    """Lengths of needle in the gel at the turn; each takes two holes [mm]."""
    further_mm: float = Field(15.0, ge=8, le=25)
    """Inserted after the turn, for the deflection to be seen [mm]."""
    backlash_mm: NonNegativeMm = 1.5
    """Insertion over which the curvature reverses after half a turn [mm]."""
    max_sd_deg: float = Field(3.0, gt=0, le=45)
    """Largest standard deviation of the lag at which it is kept [deg]."""

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a depth that is given twice."""
        if len(set(self.depths_mm)) < len(self.depths_mm):
            yield Conflict("depths_mm", "a depth is given twice", "each depth has two holes already")


class RollZeroSteps(Model):
    """How the roll zero is found: short insertions at evenly spread rolls of the bevel, each in a hole of its own."""

    specimen: Specimen
    """A block of gel with nothing in it."""
    rolls: int = Field(6, ge=5, le=24)
    """Insertions, at rolls spread evenly over a turn."""
    length_mm: PositiveMm = 20.0
    """Length of each insertion beyond the sheath [mm]."""
    hole_spacing_mm: PositiveMm = 16.0
    """Lateral distance from one hole to the next [mm]."""
    max_sd_deg: float = Field(3.0, gt=0, le=45)
    """Largest standard deviation at which the zero is certified [deg]."""
    torsion: TorsionSteps | None = None
    """How the lag of the bevel behind the rotation axis is measured; null: not at all."""

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a number of rolls that does not free the roll zero of the lag."""
        if self.torsion is not None and (self.rolls % 2 or self.rolls < _LEAST_TURNED_ROLLS):
            message = f"{self.rolls} rolls, but with torsion: they are turned to from either side in turns"
            yield Conflict("rolls", message, "take an even number, 6 or more, or torsion: null")


class AnalysisWindow(Model):
    """The part of the shaft to which the circle is fitted, and when its radius is accepted."""

    window_start_mm: NonNegativeMm
    """Arc length behind the sheath tip left out of the fit, where the hinges still close [mm]."""
    window_end_mm: NonNegativeMm
    """Arc length before the needle's tip left out of the fit [mm]."""
    min_window_mm: PositiveMm
    """Shortest arc length that is fitted [mm]."""
    max_radius_sigma_mm: PositiveMm
    """Largest standard deviation at which the radius is accepted [mm]."""
    max_radius_sigma_percent: float | None = Field(None, gt=0, le=50)
    """Its largest share of the radius [%]: a radius is accepted within either limit, so that gentle arcs are
    stated too; null: only max_radius_sigma_mm counts."""
    roll_sd_deg: float = Field(2.0, ge=0, le=30)
    """Standard deviation of the bevel's roll [deg]; 2 if it was set by eye. A bevel out of the plane makes
    the measured radius too large or too small, so the interval of a gel and the error bar of each picture's
    radius are wider."""

    @property
    def least_length_mm(self) -> float:
        """The shortest needle outside the sheath that can be measured [mm]."""
        return self.window_start_mm + self.min_window_mm + self.window_end_mm


class GridSentinel(Model):
    """Graph paper that is photographed before and after the run, to notice a camera that was bumped."""

    pitch_mm: float = Field(gt=0, le=100)
    """Distance from one line of the graph paper to the next [mm]."""


class Scale(Model):
    """The scale of pictures whose camera is no longer available, as one number."""

    px_per_mm: float = Field(gt=0, le=10_000)
    """Pixels in a millimetre of the steering plane [px/mm]."""
    origin_px: PixelUv
    """Pixel (u, v) of the origin of the steering plane [px]."""
    insertion: Direction
    """Direction of the insertion in the picture."""


def limit_conflict(key: str, value: float, other: str, limit: float) -> Conflict:
    """Return the conflict of a value that is not above the limit that another key sets."""
    return Conflict(key, f"{key} is {value:g}, must be above {other}, {limit:g}", "are both in mm?")


def check_radius(diameter_mm: float, radius_mm: float | None) -> Iterator[Conflict]:
    """Yield a radius that is not above the needle's diameter."""
    if radius_mm is not None and radius_mm <= diameter_mm:
        yield limit_conflict("design_radius_mm", radius_mm, "diameter_mm", diameter_mm)


def check_sheath(key: str, sheath_mm: float, needle_mm: float) -> Iterator[Conflict]:
    """Yield a sheath that the needle does not fit through."""
    if sheath_mm <= needle_mm:
        message = f"{key} is {sheath_mm:g}, must be above needle.diameter_mm, {needle_mm:g}"
        yield Conflict(key, message, "the needle runs inside the sheath")


class NeedleProtocol(MovingProtocol):
    """The keys of every protocol that inserts a needle through a sheath."""

    needle: Needle
    """The needle of the run."""
    sheath: Sheath
    """The tube that brings the needle into the gel."""
    sentinel: GridSentinel | None = None
    """Grid pictures before and after the run; null for none."""

    @property
    def expected_radius_mm(self) -> float:
        """The design radius of the needle."""
        return self.needle.design_radius_mm

    @property
    def pictured_needle(self) -> NeedleInPicture:
        """Needle and sheath of the run."""
        return NeedleInPicture(self.needle.diameter_mm, self.sheath.diameter_mm)

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a sheath that is too narrow for the needle."""
        yield from super().conflicts()
        yield from check_sheath("sheath.diameter_mm", self.sheath.diameter_mm, self.needle.diameter_mm)


class RollZeroSearch(NeedleProtocol):
    """The keys of every protocol that may find the roll zero of its needle."""

    insertion: Advance
    """How fast the needle goes in and comes out."""
    roll_zero: RollZeroSteps | None = None
    """How to find the needle's roll zero if the rig has no certified one; null: refuse the insertion."""
