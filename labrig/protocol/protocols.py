"""The experiments that labrig knows: steerability, camera calibration, imported pictures, a design of hinges."""

from collections.abc import Iterator
from math import cos, pi
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from labrig.protocol.design_file import Basis, TubeSection
from labrig.protocol.model import (
    Conflict,
    Direction,
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


class Protocol(Model):
    """What every protocol says."""

    pictures_decide_motion: ClassVar[bool] = False
    """Whether what a picture shows decides where an axis goes next."""

    schema_version: Literal[1] = Field(
        1, description="Version of this file format; a higher one needs a newer labrig."
    )
    experiment: str
    title: Line = Field("", description="Heading of the report.")
    operator: Line = Field("", description="Who stands at the rig.")
    notes: Notes = Field("", description="Anything worth knowing later; several lines if wanted.")
    seed: Seed = Field(description="Seed of every random draw; the same seed gives the same simulated run.")


class NeedleDesignSection(Model):
    """What a design file said of the needle when the protocol was read; labrig writes it, people name the file."""

    file: str = Field(max_length=1000, description="Name of the design file, as the protocol had it.")
    sha256: str = Field(min_length=64, max_length=64, description="SHA-256 of that file.")
    radius_low_mm: PositiveMm = Field(description="Smallest radius within the laser's tolerances [mm].")
    radius_high_mm: PositiveMm = Field(description="Largest radius within the laser's tolerances [mm].")
    inner_diameter_mm: float = Field(gt=0, le=10, description="Inner diameter of the tube [mm].")
    link_length_mm: float = Field(gt=0, le=100, description="Length of a link, from hinge to hinge [mm].")
    clearance_mm: float = Field(gt=0, le=1, description="Width that the laser cuts [mm].")
    beta_cut_deg: float = Field(ge=0, le=90, description="Inclination that it cuts at [degrees].")
    basis: Basis = Field(description="By which plane the inclination was computed.")


_NUMBERS_OR_FILE: dict[str, Any] = {
    "properties": {
        "design_file": {
            "description": "Design file that gives diameter_mm and design_radius_mm with its tolerance, relative to "
            "this file; written by labrig design --out, or by a design run.",
            "type": "string",
            "minLength": 1,
            "maxLength": 1000,
        }
    },
    "required": ["needle_id"],
    "if": {"required": ["design_file"]},
    "then": {"properties": {"diameter_mm": False, "design_radius_mm": False, "design": False}},
    "else": {"required": ["diameter_mm", "design_radius_mm"]},
}


def _allow_design_file(schema: dict[str, Any]) -> None:
    """Let editors accept a design file instead of the numbers; the reader puts the numbers in before validation."""
    schema["properties"] |= _NUMBERS_OR_FILE["properties"]
    schema |= {key: each for key, each in _NUMBERS_OR_FILE.items() if key != "properties"}


class Needle(Model):
    """The needle of the run: its numbers, or `design_file` instead of them."""

    model_config = ConfigDict(json_schema_extra=_allow_design_file)

    needle_id: Name = Field(description="Which needle; results are grouped by needle and gel.")
    diameter_mm: float = Field(gt=0, le=10, description="Outer diameter of the needle [mm].")
    design_radius_mm: PositiveMm = Field(
        description="Radius of curvature that the needle was designed for [mm]."
    )
    design: NeedleDesignSection | None = Field(
        None, description="What a design file said; labrig writes it into records."
    )

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a radius that the needle's own thickness rules out."""
        yield from _radius_too_small(self)


class Specimen(Model):
    """One block of gel."""

    name: Name = Field(description="What is written on the block; unique in the protocol.")
    gelatin_percent: float = Field(
        ge=1, le=50, description="Mass of gelatin powder per mass of water [percent]; 10 for 10 %."
    )


class SheathOrigin(Model):
    """How far from the command the sheath may be found in the picture taken once it is in; a trial beyond is refused.

    Along the insertion the linear encoder measures, so little is left but the zero set by eye. Across it the sheath's
    play moves the needle honestly, and what is found is reckoned with: a limit is for what no play explains.
    """

    depth_mm: PositiveMm | None = Field(
        None,
        description="Depth of the sheath at which its tip stands at the origin of the steering plane [mm]; "
        "null: at the sheath's depth_mm.",
    )
    along_mm: PositiveMm = Field(
        0.5, description="Most along the insertion, from where the linear encoder puts the tip [mm]."
    )
    across_mm: PositiveMm = Field(1.0, description="Most across it, by the sheath's play [mm].")
    turn_deg: float = Field(
        2.0, gt=0, le=45, description="Most between the sheath and the insertion's direction [deg]."
    )


class Sheath(Model):
    """The tube that brings the needle into the gel."""

    depth_mm: PositiveMm = Field(description="How far the linear module brings the sheath into the gel [mm].")
    speed_mm_s: SpeedMmS = Field(description="Speed of the sheath, in and out [mm/s].")
    diameter_mm: float = Field(gt=0, le=20, description="Outer diameter of the sheath [mm].")
    origin: SheathOrigin | None = Field(
        None,
        description="Tip and direction of the sheath are compared with the command, and an insertion to a target "
        "starts where they were found. null: neither.",
    )

    @property
    def origin_depth_mm(self) -> float:
        """The depth at which its tip is expected at the origin of the steering plane."""
        known = None if self.origin is None else self.origin.depth_mm
        return self.depth_mm if known is None else known


class Insertion(Model):
    """How the needle goes in and comes out."""

    length_mm: float = Field(gt=0, le=500, description="How far the needle leaves the sheath [mm].")
    speed_mm_s: SpeedMmS = Field(description="Insertion speed [mm/s].")
    withdraw_speed_mm_s: SpeedMmS = Field(description="Speed of the way back [mm/s].")
    frame_every_mm: PositiveMm = Field(description="Inserted length between two pictures [mm].")
    bevel_roll_rad: float = Field(
        0.0,
        ge=-2 * pi,
        le=2 * pi,
        description="Roll of the bevel before the insertion, kept through it [rad]; 0 bends towards -y.",
    )

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a picture spacing longer than the insertion."""
        if self.frame_every_mm > self.length_mm:
            message = (
                f"frame_every_mm is {self.frame_every_mm:g}, must be at most length_mm, {self.length_mm:g}"
            )
            yield Conflict("frame_every_mm", message, "the final shape is pictured in any case")


class AnalysisWindow(Model):
    """Which part of the shaft the circle is fitted to, and when its radius is worth stating."""

    window_start_mm: NonNegativeMm = Field(
        description="Arc length behind the sheath tip left out of the fit, where the hinges still close [mm]."
    )
    window_end_mm: NonNegativeMm = Field(
        description="Arc length before the needle's tip left out of the fit [mm]."
    )
    min_window_mm: PositiveMm = Field(description="Shortest arc length that is still fitted [mm].")
    max_radius_sigma_mm: PositiveMm = Field(
        description="Standard deviation of the radius beyond which it is not accepted [mm]."
    )
    roll_sd_deg: float = Field(
        2.0,
        ge=0,
        le=30,
        description="How sure the bevel's roll is, standard deviation [deg]; 2 where it was set by eye. A bevel out of "
        "the plane makes the radius seen too large, so the lower end of intervals is moved.",
    )

    @property
    def least_length_mm(self) -> float:
        """The shortest needle outside the sheath that can be measured [mm]."""
        return self.window_start_mm + self.min_window_mm + self.window_end_mm


class GridSentinel(Model):
    """Graph paper that is photographed before and after the run, so that a camera that was bumped is noticed."""

    pitch_mm: float = Field(
        gt=0, le=100, description="Distance from one line of the graph paper to the next [mm]."
    )


class SteerabilityProtocol(Protocol):
    """Section V-B of the paper: insertions without turning the bevel, in gels of different stiffness."""

    experiment: Literal["steerability"] = Field(description="Which experiment this file describes.")
    title: Line = Field("Steerability test", description="Heading of the report.")
    needle: Needle = Field(description="The needle of the run.")
    specimens: tuple[Specimen, ...] = Field(
        min_length=1, max_length=50, description="The blocks of gel, in the order in which they are used."
    )
    insertions_per_specimen: int = Field(ge=1, le=500, description="Insertions into each block.")
    hole_spacing_mm: PositiveMm = Field(description="Lateral distance from one hole to the next [mm].")
    specimen_width_mm: float = Field(gt=0, le=2000, description="Width of a block across the insertion [mm].")
    sheath: Sheath = Field(description="The tube that brings the needle into the gel.")
    insertion: Insertion = Field(description="How the needle goes in and comes out.")
    analysis: AnalysisWindow = Field(description="Which part of the shaft is fitted, and what is accepted.")
    sentinel: GridSentinel | None = Field(
        None, description="Grid pictures before and after the run; null for none."
    )

    @property
    def lateral_reach_mm(self) -> float:
        """How far an arc of the design radius strays sideways over the insertion [mm]."""
        radius_mm = self.needle.design_radius_mm
        return radius_mm * (1 - cos(min(self.insertion.length_mm / radius_mm, pi)))

    def conflicts(self) -> Iterator[Conflict]:
        """Yield names that stand twice, and sizes that do not go together."""
        yield from self._repeated_names()
        yield from self._holes_beyond_the_block()
        yield from sheath_too_thin("sheath.diameter_mm", self.sheath.diameter_mm, self.needle)
        if self.hole_spacing_mm <= self.needle.diameter_mm:
            yield _must_exceed(
                "hole_spacing_mm", self.hole_spacing_mm, "needle.diameter_mm", self.needle.diameter_mm
            )
        if self.analysis.least_length_mm > self.insertion.length_mm:
            yield self._window_too_long()

    def _repeated_names(self) -> Iterator[Conflict]:
        first: dict[str, int] = {}
        for index, specimen in enumerate(self.specimens):
            if first.setdefault(specimen.name, index) != index:
                message = (
                    f'name "{specimen.name}" is taken by specimens.{first[specimen.name]}, must be unique'
                )
                yield Conflict(
                    f"specimens.{index}.name", message, "write on each block what tells it from the others"
                )

    def _holes_beyond_the_block(self) -> Iterator[Conflict]:
        gaps = self.insertions_per_specimen - 1
        room_mm = self.specimen_width_mm - self.lateral_reach_mm
        if gaps * self.hole_spacing_mm <= room_mm:
            return
        if gaps == 0 or room_mm <= 0:
            yield self._block_too_narrow()
            return
        message = (
            f"hole_spacing_mm is {self.hole_spacing_mm:g}, must be at most {room_mm / gaps:.4g}: "
            f"{self.insertions_per_specimen} holes and an arc that strays {self.lateral_reach_mm:.3g} mm "
            f"sideways have to fit into specimen_width_mm, {self.specimen_width_mm:g}"
        )
        most = int(room_mm / self.hole_spacing_mm) + 1
        yield Conflict("hole_spacing_mm", message, f"or insertions_per_specimen: {most}, or a wider block")

    def _block_too_narrow(self) -> Conflict:
        message = (
            f"specimen_width_mm is {self.specimen_width_mm:g}, must be above {self.lateral_reach_mm:.3g}: "
            f"an arc of radius {self.needle.design_radius_mm:g} mm and length {self.insertion.length_mm:g} "
            "mm strays that far sideways"
        )
        return Conflict("specimen_width_mm", message, "take a wider block or a shorter insertion")

    def _window_too_long(self) -> Conflict:
        window, length_mm = self.analysis, self.insertion.length_mm
        message = (
            f"min_window_mm is {window.min_window_mm:g}; with window_start_mm {window.window_start_mm:g} and "
            f"window_end_mm {window.window_end_mm:g} that asks for {window.least_length_mm:g} mm of needle, "
            f"must be at most insertion.length_mm, {length_mm:g}"
        )
        return Conflict("analysis.min_window_mm", message, "insert further, or fit a shorter window")


class Board(Model):
    """The chessboard that the operator holds."""

    columns: int = Field(ge=3, le=100, description="Inner corners in a row of the board.")
    rows: int = Field(ge=3, le=100, description="Inner corners in a column of the board.")
    square_mm: float = Field(gt=0, le=500, description="Side of a square [mm].")


class GelAbove(Model):
    """The gel that will lie between the camera and the needle, whose refraction is corrected."""

    index: float = Field(ge=1, le=2, description="Refractive index of the gel; gelatin has about 1.35.")
    depth_mm: float = Field(
        ge=0,
        le=1000,
        description="Depth of the needle below the gel's flat surface, which is parallel to the paper [mm].",
    )
    paper_at: Literal["needle", "surface"] = Field(
        "needle",
        description="Where the paper lies when it is photographed, in air: where the needle is to be, or on the gel's "
        "surface.",
    )


class GraphPaper(Model):
    """The graph paper that lies in the steering plane, and the frame that it fixes."""

    pitch_mm: float = Field(
        gt=0, le=100, description="Distance from one line of the graph paper to the next [mm]."
    )
    origin_px: PixelUv = Field(description="Pixel (u, v) that becomes the origin of the steering plane [px].")
    insertion: Direction = Field(description="Where the insertion points in the picture.")
    gel: GelAbove | None = Field(
        None,
        description="The gel above the needle, to be corrected for; null where the paper lies at the needle's depth in "
        "the same gel, or where there is none.",
    )


class CameraCalibrationProtocol(Protocol):
    """Intrinsics from a board held by the operator, then the steering plane from graph paper."""

    experiment: Literal["camera-calibration"] = Field(description="Which experiment this file describes.")
    title: Line = Field("Camera calibration", description="Heading of the report.")
    board: Board = Field(description="The chessboard that the operator holds.")
    views: int = Field(ge=3, le=200, description="Pictures of the board, each in another pose.")
    plane: GraphPaper = Field(
        description="The graph paper in the steering plane, and the frame that it fixes."
    )


class ImportedNeedle(Model):
    """The needle of pictures that were taken elsewhere."""

    needle_id: Name = Field(description="Which needle; results are grouped by needle and gel.")
    diameter_mm: float = Field(gt=0, le=10, description="Outer diameter of the needle [mm].")
    design_radius_mm: PositiveMm | None = Field(
        None, description="Radius of curvature that the needle was designed for [mm]; null if not known."
    )

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a radius that the needle's own thickness rules out."""
        yield from _radius_too_small(self)


class Scale(Model):
    """Millimetres by one number, for pictures whose camera is not at hand any more."""

    px_per_mm: float = Field(
        gt=0, le=10_000, description="Pixels in a millimetre of the steering plane [px/mm]."
    )
    origin_px: PixelUv = Field(description="Pixel (u, v) that becomes the origin of the steering plane [px].")
    insertion: Direction = Field(description="Where the insertion points in the picture.")


class ImportProtocol(Protocol):
    """Loose recorded pictures made into a run; `labrig import` writes it."""

    experiment: Literal["import"] = Field(description="Which experiment this file describes.")
    title: Line = Field("Imported pictures", description="Heading of the report.")
    needle: ImportedNeedle = Field(description="The needle in the pictures.")
    sheath_diameter_mm: float | None = Field(
        None, gt=0, le=20, description="Outer diameter of the sheath [mm]; null if the pictures show none."
    )
    scale: Scale | None = Field(
        None, description="Millimetres by one number; null if a calibration maps the pictures."
    )
    analysis: AnalysisWindow = Field(description="Which part of the shaft is fitted, and what is accepted.")

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a sheath that the needle does not fit through."""
        if self.sheath_diameter_mm is not None:
            yield from sheath_too_thin("sheath_diameter_mm", self.sheath_diameter_mm, self.needle)


class DesignTolerances(Model):
    """How sure the laser is."""

    clearance_mm: float = Field(
        ge=0, le=0.05, description="How sure the width of the cut is, plus or minus [mm]."
    )
    cut_deg: float = Field(ge=0, le=10, description="How sure the inclination is, plus or minus [degrees].")


class MeasuredNeedle(Model):
    """A needle of this tube that was measured: its radius tells its effective clearance."""

    radius_mm: PositiveMm = Field(description="Radius that was measured [mm].")
    beta_cut_deg: float | None = Field(
        None, ge=0, le=90, description="Inclination that it was cut at [degrees]; null: as equation (3) says."
    )


class DesignProtocol(Protocol):
    """Section III of the paper: what to cut for a steering radius. It moves no rig.

    What the contour's limits and the equations refuse is told by `labrig.experiments.find_problems`: only `needle`
    knows them.
    """

    experiment: Literal["design"] = Field(description="Which experiment this file describes.")
    title: Line = Field("Design of the hinges", description="Heading of the report.")
    tube: TubeSection = Field(description="The tube that the needle's tip is cut from.")
    radius_mm: PositiveMm = Field(description="Steering radius wanted [mm].")
    clearance_mm: float = Field(gt=0, le=1, description="Width that the laser cuts [mm].")
    tolerances: DesignTolerances = Field(description="How sure the laser is.")
    grid_points: int = Field(
        7, ge=3, le=25, description="Points of the searched grid, along each of its two sides."
    )
    tip_length_mm: PositiveMm | None = Field(
        None, description="Length of the tip, into which whole links fit [mm]; null if not asked."
    )
    measured: MeasuredNeedle | None = Field(
        None, description="A needle that was measured, for its effective clearance; null if none was."
    )


def _must_exceed(key: str, value: float, other: str, limit: float) -> Conflict:
    return Conflict(key, f"{key} is {value:g}, must be above {other}, {limit:g}", "are both in mm?")


def _radius_too_small(needle: Needle | ImportedNeedle) -> Iterator[Conflict]:
    radius_mm = needle.design_radius_mm
    if radius_mm is not None and radius_mm <= needle.diameter_mm:
        yield _must_exceed("design_radius_mm", radius_mm, "diameter_mm", needle.diameter_mm)


def sheath_too_thin(key: str, sheath_mm: float, needle: Needle | ImportedNeedle) -> Iterator[Conflict]:
    """Yield a sheath that the needle does not fit through."""
    if sheath_mm <= needle.diameter_mm:
        message = f"{key} is {sheath_mm:g}, must be above needle.diameter_mm, {needle.diameter_mm:g}"
        yield Conflict(key, message, "the needle runs inside the sheath")
