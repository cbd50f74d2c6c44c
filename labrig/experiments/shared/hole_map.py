"""Where tracks lie in a block of gel: how close a planned track comes to the old ones, and where the next hole fits.

Places are those of `SpecimenTrack`: along the insertion from the entry face, and across it from the first entry point
that the block ever had. Nothing measures that frame: it rests on the holes being made where the protocols say, and so
on the operator who shifts the block by hand.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from shapely import LineString, MultiLineString
from shapely.geometry.base import BaseGeometry

from labrig.analysis.result import Point
from labrig.errors import Problem
from labrig.protocol.sections import TrackedSpecimen
from labrig.protocol.specimen_file import SpecimenTrack
from labrig.text import format_count

ARC_POINTS = 17
"""Of an arc of 40 mm with a radius of 30 mm, chords between so many points stay within 0.03 mm."""

_STEP_MM = 0.5


@dataclass(frozen=True)
class TrackShape:
    """The shape of a track: straight along the sheath, then a path of (along, across) [mm] from the sheath's end."""

    hole_position_mm: float
    sheath_depth_mm: float
    sheath_diameter_mm: float
    needle_diameter_mm: float
    path_mm: tuple[Point, ...]

    @classmethod
    def of_track(cls, track: SpecimenTrack) -> "TrackShape":
        """Return the shape of a recorded track."""
        return cls(**{name: getattr(track, name) for name in cls.__dataclass_fields__})

    def shift(self, across_mm: float) -> "TrackShape":
        """Return the same shape further across [mm]."""
        path_mm = tuple((along, across + across_mm) for along, across in self.path_mm)
        return replace(self, hole_position_mm=self.hole_position_mm + across_mm, path_mm=path_mm)

    @property
    def parts(self) -> tuple[tuple[LineString, float], ...]:
        """The centre lines of sheath and needle, each with its diameter [mm]."""
        sheath = LineString([(0.0, self.hole_position_mm), (self.sheath_depth_mm, self.hole_position_mm)])
        return (sheath, self.sheath_diameter_mm), (LineString(self.path_mm), self.needle_diameter_mm)


def sample_arc(
    hole_position_mm: float, depth_mm: float, radius_mm: float, length_mm: float, side: int
) -> tuple[Point, ...]:
    """Return points of an arc that begins straight at the end of a sheath, rounded to 0.01 mm.

    Parameters
    ----------
    hole_position_mm, depth_mm : float
        Where the sheath entered, and how far it went in.
    side : int
        1 if it bends towards later holes, else -1.
    """
    angles = (length_mm / radius_mm * step / (ARC_POINTS - 1) for step in range(ARC_POINTS))
    return tuple(
        (
            round(depth_mm + radius_mm * math.sin(angle), 2),
            round(hole_position_mm + side * radius_mm * (1.0 - math.cos(angle)), 2),
        )
        for angle in angles
    )


_Part: TypeAlias = tuple[BaseGeometry, float]


def _compute_gap_mm(parts: Iterable[_Part], others: Sequence[_Part]) -> float:
    """Return the least distance between surfaces [mm]; negative where they overlap."""
    return min(
        line.distance(other) - 0.5 * (diameter_mm + other_mm)
        for line, diameter_mm in parts
        for other, other_mm in others
    )


def compute_gap_mm(shape: TrackShape, other: TrackShape) -> float:
    """Return the least distance between the surfaces of two tracks [mm]; negative where they overlap."""
    return _compute_gap_mm(shape.parts, other.parts)


def is_clear(gel: TrackedSpecimen, shape: TrackShape) -> bool:
    """Return whether a track keeps off the old tracks of a gel, or need not."""
    return gel.block is None or gel.allow_crossing or _find_crossing(gel, shape) is None


def _find_crossing(gel: TrackedSpecimen, shape: TrackShape) -> tuple[SpecimenTrack, float] | None:
    """Return the old track that a planned one comes closest to, and how close, if that is too close [mm]."""
    old = () if gel.block is None else gel.block.tracks
    gaps = ((track, compute_gap_mm(shape, TrackShape.of_track(track))) for track in old)
    track, gap_mm = min(gaps, key=lambda found: found[1], default=(None, math.inf))
    return (track, gap_mm) if track is not None and gap_mm < gel.track_clearance_mm else None


def find_crossings(
    key: str, gel: TrackedSpecimen, planned: Sequence[TrackShape], last_mm: float
) -> Iterator[Problem]:
    """Yield a planned track that comes too close to an old one, once for a gel: the first of them, and how many.

    Parameters
    ----------
    key : str
        Dotted key of the gel.
    planned : sequence of TrackShape
        In the order of the holes.
    last_mm : float
        The last entry point that the block has room for, of the last of them.
    """
    if gel.block is None or gel.allow_crossing:
        return
    found = ((hole, _find_crossing(gel, shape)) for hole, shape in enumerate(planned))
    crossings = [(hole, crossing) for hole, crossing in found if crossing is not None]
    if not crossings:
        return
    hole, (track, gap_mm) = crossings[0]
    more, place_mm = len(crossings) - 1, planned[hole].hole_position_mm
    start_mm = find_place(
        gel.block.tracks, [shape.shift(-planned[0].hole_position_mm) for shape in planned], last_mm, gel
    )
    yield Problem(
        f"{key}.first_hole_mm",
        f"hole {hole + 1}, at {place_mm:g} mm, would {_describe_gap(gap_mm)} of hole {track.hole + 1} of run "
        f"{track.run}, at {track.hole_position_mm:g} mm; the least clearance is {gel.track_clearance_mm:g} mm"
        + (f"; so would {format_count(more, 'hole')} more" if more else ""),
        _suggest(start_mm, len(planned)),
    )


def _describe_gap(gap_mm: float) -> str:
    return "cross the track" if gap_mm <= 0 else f"pass {gap_mm:.2f} mm from the track"


def _suggest(start_mm: float | None, holes: int) -> str:
    if start_mm is None:
        return "the block has no room for that: fewer or shorter insertions, a fresh block, or allow_crossing: true"
    clear = "is clear" if holes == 1 else f"is clear for all {holes} holes"
    return f"first_hole_mm: {start_mm:g} {clear}; or allow_crossing: true"


def find_place(
    old: Iterable[SpecimenTrack], planned: Sequence[TrackShape], last_mm: float, gel: TrackedSpecimen
) -> float | None:
    """Return the first place, in steps of 0.5 mm, from which planned tracks are clear of old ones; None without any.

    Parameters
    ----------
    planned : sequence of TrackShape
        As they lie if the first of them is at 0.
    last_mm : float
        As in `find_crossings`.
    gel : TrackedSpecimen
        Its track_clearance_mm counts.
    """
    others = _join_parts([TrackShape.of_track(track) for track in old])
    room_mm = last_mm - max(shape.hole_position_mm for shape in planned)
    for step in range(math.floor(room_mm / _STEP_MM) + 1):
        shifted = (shape.shift(step * _STEP_MM) for shape in planned)
        if not others or all(
            _compute_gap_mm(shape.parts, others) >= gel.track_clearance_mm for shape in shifted
        ):
            return step * _STEP_MM
    return None


def _join_parts(shapes: Iterable[TrackShape]) -> list[_Part]:
    """Return the centre lines of all tracks, those of one diameter together: so their distance is found at once."""
    by_diameter: dict[float, list[LineString]] = {}
    for line, diameter_mm in (part for shape in shapes for part in shape.parts):
        by_diameter.setdefault(diameter_mm, []).append(line)
    return [(MultiLineString(lines), diameter_mm) for diameter_mm, lines in by_diameter.items()]
