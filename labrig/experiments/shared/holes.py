"""Holes in a block of gel along one line: how close a planned one comes to the old ones, and where the next one fits.

Places count across the insertion, from the first entry point that the block ever had. Nothing measures them: they rest
on the holes being made where the protocols say, and so on the operator who shifts the block by hand. What a needle does
beyond its hole is not compared: needles of one sweep bend alike, side by side.
"""

import math
from collections.abc import Iterator, Sequence

from labrig.errors import Problem
from labrig.protocol.sections import TrackedSpecimen
from labrig.protocol.specimen_file import SpecimenTrack
from labrig.text import format_count

_STEP_MM = 0.5


def is_clear(gel: TrackedSpecimen, place_mm: float, diameter_mm: float) -> bool:
    """Return whether a sheath of a diameter keeps off the old holes of a gel at a place, or need not."""
    return gel.block is None or gel.allow_crossing or _find_near(gel, place_mm, diameter_mm) is None


def _find_gap_mm(track: SpecimenTrack, place_mm: float, diameter_mm: float) -> float:
    """Return the distance between the surfaces of an old sheath and a planned one; negative where they overlap."""
    return abs(place_mm - track.hole_position_mm) - 0.5 * (diameter_mm + track.sheath_diameter_mm)


def _find_near(gel: TrackedSpecimen, place_mm: float, diameter_mm: float) -> SpecimenTrack | None:
    """Return the old track that a planned hole comes closest to, if that is too close."""
    old = () if gel.block is None else gel.block.tracks
    nearest = min(old, key=lambda track: _find_gap_mm(track, place_mm, diameter_mm), default=None)
    if nearest is None or _find_gap_mm(nearest, place_mm, diameter_mm) >= gel.track_clearance_mm:
        return None
    return nearest


def find_near_holes(
    key: str, gel: TrackedSpecimen, places_mm: Sequence[float], diameter_mm: float, last_mm: float
) -> Iterator[Problem]:
    """Yield a planned hole that comes too close to an old one, once for a gel: the first of them, and how many.

    Parameters
    ----------
    key : str
        Dotted key of the gel.
    places_mm : sequence of float
        In the order of the holes.
    diameter_mm : float
        Of the sheath.
    last_mm : float
        The last place that the block has room for.
    """
    if gel.block is None or gel.allow_crossing:
        return
    found = [(hole, _find_near(gel, place_mm, diameter_mm)) for hole, place_mm in enumerate(places_mm)]
    near = [(hole, track) for hole, track in found if track is not None]
    if not near:
        return
    hole, track = near[0]
    more, gap_mm = len(near) - 1, _find_gap_mm(track, places_mm[hole], diameter_mm)
    start_mm = find_place(gel, [place - places_mm[0] for place in places_mm], diameter_mm, last_mm)
    yield Problem(
        f"{key}.first_hole_mm",
        f"hole {hole + 1}, at {places_mm[hole]:g} mm: its sheath would be {max(gap_mm, 0.0):.2f} mm from that of hole "
        f"{track.hole + 1} of run {track.run}, at {track.hole_position_mm:g} mm; "
        f"the least clearance is {gel.track_clearance_mm:g} mm"
        + (f"; so would {format_count(more, 'hole')} more" if more else ""),
        _suggest(start_mm, len(places_mm)),
    )


def _suggest(start_mm: float | None, holes: int) -> str:
    if start_mm is None:
        return "the block has no room for that: fewer insertions, a fresh block, or allow_crossing: true"
    clear = "is clear" if holes == 1 else f"is clear for all {holes} holes"
    return f"first_hole_mm: {start_mm:g} {clear}, of the sheaths: arcs come closer; or allow_crossing: true"


def find_place(
    gel: TrackedSpecimen, places_mm: Sequence[float], diameter_mm: float, last_mm: float
) -> float | None:
    """Return the first place, in steps of 0.5 mm, from which planned holes are clear of old ones; None without any.

    Parameters
    ----------
    places_mm : sequence of float
        As they lie if the first of them is at 0.
    diameter_mm, last_mm : float
        As in `find_near_holes`.
    """
    for step in range(math.floor((last_mm - max(places_mm)) / _STEP_MM) + 1):
        start_mm = step * _STEP_MM
        if all(_find_near(gel, start_mm + place_mm, diameter_mm) is None for place_mm in places_mm):
            return start_mm
    return None
