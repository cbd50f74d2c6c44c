"""The protocol of a steerability sweep."""

from collections.abc import Iterator, Mapping
from math import acos, ceil, cos, inf, pi
from typing import ClassVar, Literal, Self

from pydantic import Field

from labrig.errors import Problem
from labrig.protocol.model import Conflict, Line, Model, PositiveMm, SpeedMmS
from labrig.protocol.sections import (
    AnalysisWindow,
    Criterion,
    JudgedProtocol,
    NeedleProtocol,
    TrackedSpecimen,
    limit_conflict,
)
from labrig.protocol.specimen_file import TracksBySpecimen

# A picture nearer to the end than this share of the way between two pictures would be the final one again.
_AT_END = 0.01
# The paper's needle, designed for 30 mm, bent to 27.13 mm in its stiffest gel.
_TIGHTEST = 0.9


class Insertion(Model):
    """How the needle goes in and comes out."""

    length_mm: float = Field(gt=0, le=500)
    """How far the needle leaves the sheath; the longer an arc, the nearer it comes to the track of the next hole, and
    beyond half a circle it leaves the gel: `labrig check` warns of both, by 0.9 of the design radius, as the paper's
    needle bent in its stiffest gel [mm]."""
    speed_mm_s: SpeedMmS
    """Insertion speed [mm/s]."""
    withdraw_speed_mm_s: SpeedMmS
    """Speed of the way back [mm/s]."""
    frame_every_mm: PositiveMm
    """Inserted length between two pictures; the needle does not stop for them, and they come a reading later [mm]."""
    bevel_roll_rad: float = Field(0.0, ge=-2 * pi, le=2 * pi)
    """Roll of the bevel before the insertion, kept through it [rad]; at 0, set by eye, it bends towards -y."""

    def list_stops_mm(self) -> list[float]:
        """Return the inserted lengths at which a picture is taken on the way [mm]; the end has its own picture."""
        parts = ceil(self.length_mm / self.frame_every_mm - _AT_END)
        return [self.frame_every_mm * number for number in range(1, parts)]


class SteerabilityProtocol(JudgedProtocol, NeedleProtocol):
    """Section V-B of the paper: insertions without turning the bevel, in gels of different stiffness."""

    judged_values: ClassVar[Mapping[str, str]] = {
        "radius_mm": "the radius in the final picture of an insertion",
        "radius_sd_mm": "its standard deviation",
    }

    experiment: Literal["steerability"]
    """Which experiment this file describes."""
    title: Line = "Steerability test"
    """Heading of the report."""
    specimens: tuple[TrackedSpecimen, ...] = Field(min_length=1, max_length=50)
    """The blocks of gel, in the order in which they are used."""
    insertions_per_specimen: int = Field(ge=1, le=500)
    """Insertions into each block."""
    hole_spacing_mm: PositiveMm
    """Lateral distance from one hole to the next [mm]."""
    hole_order: Literal["sequential", "random"] = "sequential"
    """Order of the holes within each block: one after the other, or a random order drawn from the seed, so
    that a drift over time is not taken for an effect of the place."""
    specimen_width_mm: float = Field(gt=0, le=2000)
    """Width of a block across the insertion [mm]."""
    insertion: Insertion
    """How the needle goes in and comes out."""
    analysis: AnalysisWindow
    """Which part of the shaft is fitted, and what is accepted."""

    @property
    def lateral_reach_mm(self) -> float:
        """The lateral deflection of an arc of the design radius over the insertion [mm]."""
        radius_mm = self.needle.design_radius_mm
        return radius_mm * (1 - cos(min(self.insertion.length_mm / radius_mm, pi)))

    @property
    def last_place_mm(self) -> float:
        """The last entry point from which such an arc stays in its block [mm]."""
        return self.specimen_width_mm - self.lateral_reach_mm

    @property
    def criterion(self) -> Criterion:
        """The mean radius."""
        return Criterion("mean_radius_mm")

    @property
    def gels(self) -> Mapping[str, TrackedSpecimen]:
        """Dotted key -> block of gel."""
        return {f"specimens.{index}": gel for index, gel in enumerate(self.specimens)}

    def put_tracks(self, tracks: TracksBySpecimen) -> Self:
        """Return this protocol with the tracks in each of its specimens, by the specimen's name."""
        return self.model_copy(update={"specimens": tuple(gel.put_tracks(tracks) for gel in self.specimens)})

    def list_places_mm(self, gel: TrackedSpecimen) -> tuple[float, ...]:
        """Return the planned entry points in a gel, from its first one [mm]."""
        return tuple(
            gel.first_hole_mm + hole * self.hole_spacing_mm for hole in range(self.insertions_per_specimen)
        )

    def list_spacings_mm(self) -> Iterator[float]:
        """Yield how far holes are from the next, and from old ones of their gel that may not be crossed [mm]."""
        if self.insertions_per_specimen > 1:
            yield self.hole_spacing_mm
        for gel in self.gels.values():
            for track in () if gel.block is None or gel.allow_crossing else gel.block.tracks:
                yield from (abs(place_mm - track.hole_position_mm) for place_mm in self.list_places_mm(gel))

    def list_doubts(self) -> Iterator[Problem]:
        """Yield what a needle comes to that bends more than it was designed for, if it is inserted too far for it.

        The law of cosines says where two arcs alike are a needle's width from each other; those of one gel differ.
        """
        radius_mm = _TIGHTEST * self.needle.design_radius_mm
        ends = {"leads back out of the gel": pi * radius_mm + self.sheath.depth_mm}
        apart_mm, near_mm = min(self.list_spacings_mm(), default=inf), radius_mm + 2 * self.needle.diameter_mm
        cosine = (near_mm**2 - radius_mm**2 - apart_mm**2) / (2 * radius_mm * apart_mm)
        if cosine > -1:
            ends[f"comes within its width of a track {apart_mm:g} mm off"] = radius_mm * acos(min(cosine, 1))
        for end, most_mm in ends.items():
            if self.insertion.length_mm > most_mm:
                arc = f"an arc of {radius_mm:g} mm, {_TIGHTEST:g} of the design radius, {end} after {most_mm:.3g} mm"
                yield Problem("insertion.length_mm", arc, "a shorter insertion, or holes farther apart")

    def conflicts(self) -> Iterator[Conflict]:
        """Yield repeated names, and sizes that contradict each other."""
        yield from super().conflicts()
        yield from self._find_repeated_names()
        yield from self._find_holes_beyond_block()
        if self.hole_spacing_mm <= self.needle.diameter_mm:
            yield limit_conflict(
                "hole_spacing_mm", self.hole_spacing_mm, "needle.diameter_mm", self.needle.diameter_mm
            )
        if self.analysis.least_length_mm > self.insertion.length_mm:
            yield self._explain_long_window()

    def _find_repeated_names(self) -> Iterator[Conflict]:
        first: dict[str, int] = {}
        for index, specimen in enumerate(self.specimens):
            if first.setdefault(specimen.name, index) != index:
                message = (
                    f'name "{specimen.name}" is taken by specimens.{first[specimen.name]}, must be unique'
                )
                yield Conflict(f"specimens.{index}.name", message, "give each block a name of its own")

    def _find_holes_beyond_block(self) -> Iterator[Conflict]:
        """Yield gels that are too narrow for their holes and the arc that strays from the last of them."""
        needed_mm = (self.insertions_per_specimen - 1) * self.hole_spacing_mm
        for key, gel in self.gels.items():
            last_mm = gel.first_hole_mm + needed_mm
            if last_mm > self.last_place_mm:
                message = (
                    f"the last of {self.insertions_per_specimen} holes is at {last_mm:g} mm, must be at most "
                    f"{self.last_place_mm:.4g}: from there an arc of radius {self.needle.design_radius_mm:g} mm strays "
                    f"{self.lateral_reach_mm:.3g} mm sideways, and specimen_width_mm is {self.specimen_width_mm:g}"
                )
                where = "hole_spacing_mm" if self.last_place_mm > 0 else "specimen_width_mm"
                if needed_mm <= self.last_place_mm:
                    where = f"{key}.first_hole_mm"
                yield Conflict(where, message, "fewer or nearer holes, a shorter insertion, or a wider block")
                return

    def _explain_long_window(self) -> Conflict:
        window, length_mm = self.analysis, self.insertion.length_mm
        message = (
            f"min_window_mm is {window.min_window_mm:g}; with window_start_mm {window.window_start_mm:g} and "
            f"window_end_mm {window.window_end_mm:g} that asks for {window.least_length_mm:g} mm of needle, "
            f"and insertion.length_mm is {length_mm:g}"
        )
        return Conflict("analysis.min_window_mm", message, "insert further, or fit a shorter window")


Protocol = SteerabilityProtocol
