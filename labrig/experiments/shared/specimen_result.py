"""What is known of a specimen after a run: all tracks in it, the next hole, and how the curvature drifts."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import scipy
from scipy.special import stdtrit

from labrig.analysis.result import Point, Rows
from labrig.analysis.statistics import LEVEL, has_spread
from labrig.experiments.shared.holes import find_place
from labrig.protocol.model import Model
from labrig.protocol.sections import TrackedSpecimen
from labrig.protocol.specimen_file import SpecimenTrack
from labrig.text import format_count

MOST_CHANGE_PERCENT = 2.0
"""A drift of the curvature is told of if it is significant and, over what was observed, larger than this [%].

From 10 to 19 % gelatin the paper's curvature changes by 4 %: a drift of half of that passes for another gel.
"""


_OVER = {"age_h": "hour of age", "track": "track"}


class CurvatureTrend(Model):
    """A straight line through the curvatures of one needle in one specimen, over its age or the number of the track.

    `slope` is in 1/mm per hour or per track, with its 95 % interval and p. `change_percent` is what the line says of
    the observed span, of the mean curvature. `drifts`: p is below 0.05, and that change is above the limit.
    """

    over: Literal["age_h", "track"]
    n: int
    span: float
    mean_curvature_per_mm: float
    slope: float
    slope_ci95: Point
    p: float
    change_percent: float
    drifts: bool


class SpecimenTrackRow(Model):
    """A track as a row of a table; it is of another run than the table's if `from_run` says so."""

    specimen: str
    track: int
    from_run: str
    from_trial: int
    from_hole: int
    hole_position_mm: float
    needle_id: str
    age_h: float
    radius_mm: float | None


class SpecimenMap(Model):
    """The tracks in a specimen, in order of time: those before the run (`tracks[:earlier]`), then its own.

    `next_hole_mm` is the first entry point from which one more such insertion is clear of all of them by
    `clearance_mm`; None if the block has no room. `trends` are of the needle of the run.
    """

    key: str
    name: str
    clearance_mm: float
    earlier: int
    tracks: tuple[SpecimenTrack, ...]
    next_hole_mm: float | None
    needle_id: str
    trends: tuple[CurvatureTrend, ...]


def map_specimens(
    gels: Mapping[str, TrackedSpecimen],
    own: Mapping[str, Sequence[SpecimenTrack]],
    diameter_mm: float,
    last_mm: float,
    needle_id: str,
) -> tuple[SpecimenMap, ...]:
    """Return the map of each gel with a specimen file.

    Parameters
    ----------
    gels : mapping of str to TrackedSpecimen
        By their key in the protocol.
    own : mapping of str to sequence of SpecimenTrack
        The tracks of the run, by the name of the specimen.
    diameter_mm : float
        Of the sheath.
    last_mm : float
        The last entry point that the block has room for.
    """
    maps = []
    for key, gel in gels.items():
        if gel.block is None:
            continue
        tracks = (*gel.block.tracks, *own.get(gel.name, ()))
        maps.append(
            SpecimenMap(
                key=key,
                name=gel.name,
                clearance_mm=gel.track_clearance_mm,
                earlier=len(gel.block.tracks),
                tracks=tracks,
                next_hole_mm=find_place(tracks, [0.0], diameter_mm, last_mm, gel),
                needle_id=needle_id,
                trends=fit_trends(tracks, needle_id),
            )
        )
    return tuple(maps)


def fit_trends(tracks: Sequence[SpecimenTrack], needle_id: str) -> tuple[CurvatureTrend, ...]:
    """Return the trends of the curvature that one needle cut, over age and over the number of the track."""
    held = [
        (track.age_h, float(number), 1.0 / track.radius_mm)
        for number, track in enumerate(tracks, start=1)
        if track.radius_mm is not None and track.needle_id == needle_id
    ]
    ages, numbers, curvatures = ([row[column] for row in held] for column in range(3))
    trends = (_fit("age_h", ages, curvatures), _fit("track", numbers, curvatures))
    return tuple(trend for trend in trends if trend is not None)


def _fit(
    over: Literal["age_h", "track"], values: Sequence[float], curvatures: Sequence[float]
) -> CurvatureTrend | None:
    """Return the trend; None for fewer than three values, or values that are all the same."""
    if len(values) < 3 or not has_spread(values):
        return None
    found = scipy.stats.linregress(values, curvatures)
    slope, p = float(found.slope), float(found.pvalue)
    half = float(found.stderr) * float(stdtrit(len(values) - 2, 0.5 + 0.5 * LEVEL))
    span, mean = max(values) - min(values), float(np.mean(curvatures))
    change_percent = 100.0 * slope * span / mean
    return CurvatureTrend(
        over=over,
        n=len(values),
        span=span,
        mean_curvature_per_mm=mean,
        slope=slope,
        slope_ci95=(slope - half, slope + half),
        p=p,
        change_percent=change_percent,
        drifts=p < 1.0 - LEVEL and abs(change_percent) > MOST_CHANGE_PERCENT,
    )


def describe_trend(trend: CurvatureTrend) -> str:
    """Return a trend as a sentence: slope with its interval, what it comes to, and whether that is a drift."""
    low, high = (100.0 * bound / trend.mean_curvature_per_mm for bound in trend.slope_ci95)
    slope = 100.0 * trend.slope / trend.mean_curvature_per_mm
    what = (
        f"by {_format_percent(slope)} % per {_OVER[trend.over]} (95 % interval {_format_percent(low)} to "
        f"{_format_percent(high)} %, "
        f"{format_count(trend.n, 'track')}), {trend.change_percent:+.1f} % over what was observed"
    )
    if trend.drifts:
        return f"The curvature changes {what}: above {MOST_CHANGE_PERCENT:g} %, and significant (p = {trend.p:.2g})."
    return f"The curvature changes {what}; that is no drift (p = {trend.p:.2g})."


def _format_percent(value: float) -> str:
    return f"{value:+.0f}" if abs(value) >= 10.0 else f"{value:+.2g}"


def summarise_maps(maps: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return a line for each specimen of a result document: its tracks and the next hole, and one for each drift."""
    lines = []
    for specimen in (SpecimenMap.model_validate(document, strict=False) for document in maps):
        next_mm = specimen.next_hole_mm
        place = (
            "no room for one more" if next_mm is None else f"next clear hole at first_hole_mm: {next_mm:g}"
        )
        lines.append(f"specimen {specimen.name}  {format_count(len(specimen.tracks), 'track')}, {place}")
        lines += [f"warning: {describe_trend(trend)}" for trend in specimen.trends if trend.drifts]
    return tuple(lines)


def make_track_table(maps: Sequence[SpecimenMap]) -> dict[str, Rows]:
    """Return the table of all tracks; no table without a specimen file."""
    rows = [
        SpecimenTrackRow(
            specimen=specimen.name,
            track=number,
            **{f"from_{key}": getattr(track, key) for key in ("run", "trial", "hole")},
            **track.model_dump(include=set(SpecimenTrackRow.model_fields)),
        )
        for specimen in maps
        for number, track in enumerate(specimen.tracks, start=1)
    ]
    return {"tracks": Rows(SpecimenTrackRow, rows)} if rows else {}
