"""The tracks of a sweep in its blocks of gel: planned ones, and those that a run left."""

import math
from collections.abc import Iterator, Mapping

from labrig.analysis.result import AnalysisResult
from labrig.errors import Problem
from labrig.experiments.shared.curvature_result import CurvatureResult, PictureResult
from labrig.experiments.shared.grouping import find_final_pictures
from labrig.experiments.shared.hole_map import TrackShape, find_crossings, sample_arc
from labrig.experiments.shared.specimen_result import SpecimenMap, find_track_age_h, map_specimens
from labrig.experiments.steerability.events import SweepTrialStart
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.specimen_file import SpecimenTrack, TracksBySpecimen
from labrig.record.reader import Run


def plan_track(protocol: SteerabilityProtocol, place_mm: float) -> TrackShape:
    """Return the track of an insertion at an entry point, with the radius that the needle was designed for."""
    return _make_shape(protocol, place_mm, protocol.needle.design_radius_mm, _planned_side(protocol))


def find_track_problems(protocol: SteerabilityProtocol) -> Iterator[Problem]:
    """Yield the planned tracks that cross old ones."""
    for key, gel in protocol.gels.items():
        planned = [plan_track(protocol, place_mm) for place_mm in protocol.list_places_mm(gel)]
        yield from find_crossings(key, gel, planned, protocol.last_place_mm)


def map_sweep(run: Run, protocol: SteerabilityProtocol, content: CurvatureResult) -> tuple[SpecimenMap, ...]:
    """Return the map of each block with a specimen file."""
    own = trace_insertions(run, protocol, find_final_pictures(content.measurements))
    return map_specimens(
        protocol.gels, own, plan_track(protocol, 0.0), protocol.last_place_mm, protocol.needle.needle_id
    )


def list_tracks(
    run: Run, protocol: SteerabilityProtocol, result: AnalysisResult[CurvatureResult] | None
) -> TracksBySpecimen:
    """Return the tracks that a run left in blocks with a specimen file, in order of time."""
    measurements = () if result is None else result.content.measurements
    return trace_insertions(run, protocol, find_final_pictures(measurements))


def trace_insertions(
    run: Run, protocol: SteerabilityProtocol, finals: Mapping[int, PictureResult]
) -> TracksBySpecimen:
    """Return the track of each insertion that was begun, also of those that a person had left out.

    A radius that was not accepted, or not measured, is taken to be that of the design, and a broken insertion to have
    its full length: a track that is not there costs a place, one that is overlooked an insertion.
    """
    sections = {gel.name: gel.block for gel in protocol.gels.values() if gel.block is not None}
    starts = run.read_events(SweepTrialStart)
    return {
        name: tuple(
            _trace(run, protocol, start, find_track_age_h(run, section, start.t_s), finals)
            for start in starts
            if start.specimen == name
        )
        for name, section in sections.items()
    }


def _trace(
    run: Run,
    protocol: SteerabilityProtocol,
    start: SweepTrialStart,
    age_h: float,
    finals: Mapping[int, PictureResult],
) -> SpecimenTrack:
    final = finals.get(start.trial)
    known = final is not None and final.accepted
    radius_mm = final.radius_mm if known and final is not None else None
    side = _planned_side(protocol)
    if known and final is not None and final.bend is not None:
        side = 1 if final.bend == "-y" else -1
    shape = _make_shape(protocol, start.hole_position_mm, radius_mm or protocol.needle.design_radius_mm, side)
    return SpecimenTrack(
        run=run.path.name,
        trial=start.trial,
        hole=start.hole,
        needle_id=start.needle_id,
        age_h=age_h,
        radius_mm=None if radius_mm is None else round(radius_mm, 4),
        **vars(shape),
    )


def _planned_side(protocol: SteerabilityProtocol) -> int:
    """Return 1 if the bevel bends the needle towards later holes, which is -y of the steering plane, else -1."""
    return 1 if math.cos(protocol.insertion.bevel_roll_rad) >= 0 else -1


def _make_shape(protocol: SteerabilityProtocol, place_mm: float, radius_mm: float, side: int) -> TrackShape:
    sheath, length_mm = protocol.sheath, protocol.insertion.length_mm
    return TrackShape(
        hole_position_mm=place_mm,
        sheath_depth_mm=sheath.depth_mm,
        sheath_diameter_mm=sheath.diameter_mm,
        needle_diameter_mm=protocol.needle.diameter_mm,
        path_mm=sample_arc(place_mm, sheath.depth_mm, radius_mm, length_mm, side),
    )
