"""The tracks of insertions to a target in their block of gel: the planned one, and those that a run left."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from labrig.analysis.result import AnalysisResult, Point
from labrig.errors import Problem
from labrig.experiments.insertion.events import InsertionStart, NeedleRetreat, TipObserved
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.result import InsertionResult, InsertionTrial
from labrig.experiments.shared.hole_map import TrackShape, find_crossings
from labrig.experiments.shared.specimen_result import SpecimenMap, find_track_age_h, map_specimens
from labrig.protocol.specimen_file import SpecimenSection, SpecimenTrack, TracksBySpecimen
from labrig.record.reader import Run

# With a radius of 30 mm, chords between so many points of a path of 100 mm stay within 0.12 mm.
_PATH_POINTS = 20


def make_shape(protocol: InsertionProtocol, path_mm: ArrayLike) -> TrackShape:
    """Return the track of an insertion along a path of the steering plane (N, 2), columns (y, z) [mm].

    Without points it is taken to be straight and as long as the protocol allows.
    """
    sheath, hole_position_mm = protocol.sheath, protocol.specimen.first_hole_mm
    end = np.array([[sheath.depth_mm, hole_position_mm]])
    y_z = np.asarray(path_mm, dtype=float).reshape(-1, 2)
    if not len(y_z):
        y_z = np.array([[0.0, sheath.depth_mm - sheath.origin_depth_mm + protocol.insertion.max_length_mm]])
    points = np.vstack(
        (end, np.column_stack((sheath.origin_depth_mm + y_z[:, 1], hole_position_mm - y_z[:, 0])))
    )
    kept = np.unique(np.linspace(0, len(points) - 1, _PATH_POINTS).round().astype(int))
    return TrackShape(
        hole_position_mm=hole_position_mm,
        sheath_depth_mm=sheath.depth_mm,
        sheath_diameter_mm=sheath.diameter_mm,
        needle_diameter_mm=protocol.needle.diameter_mm,
        path_mm=tuple((round(float(along), 2), round(float(across), 2)) for along, across in points[kept]),
    )


def find_track_problems(protocol: InsertionProtocol, path_mm: ArrayLike) -> Iterator[Problem]:
    """Yield a planned path (N, 2) of the steering plane, as for `make_shape`, whose track crosses an old one."""
    shape = make_shape(protocol, path_mm)
    for key, gel in protocol.gels.items():
        yield from find_crossings(key, gel, [shape], protocol.specimen.width_mm)


def map_insertions(
    run: Run, protocol: InsertionProtocol, trials: Sequence[InsertionTrial]
) -> tuple[SpecimenMap, ...]:
    """Return the map of the block, if it has a specimen file."""
    own = _trace_insertions(run, protocol, {trial.trial: trial.shaft_mm for trial in trials})
    straight, width_mm = make_straight_shape(protocol), protocol.specimen.width_mm
    return map_specimens(protocol.gels, own, straight, width_mm, protocol.needle.needle_id)


def make_straight_shape(protocol: InsertionProtocol) -> TrackShape:
    """Return the track of a straight insertion that enters at 0, as long as the protocol allows."""
    return make_shape(protocol, ()).shift(-protocol.specimen.first_hole_mm)


def list_tracks(
    run: Run, protocol: InsertionProtocol, result: AnalysisResult[InsertionResult] | None
) -> TracksBySpecimen:
    """Return the tracks that a run left in a block with a specimen file, in order of time."""
    trials = () if result is None else result.content.insertions
    return _trace_insertions(run, protocol, {trial.trial: trial.shaft_mm for trial in trials})


def _trace_insertions(
    run: Run, protocol: InsertionProtocol, shafts: Mapping[int, Sequence[Point]]
) -> TracksBySpecimen:
    """Return the track of each insertion that was begun, also of those that a person had left out.

    It is the needle's shaft in the final picture. Where that was not measured, or the needle was withdrawn and went
    elsewhere, it also passes through the places where the tip was on the way.
    """
    section = protocol.specimen.block
    if section is None:
        return {}
    way: dict[int, list[Point]] = {}
    retreated = {event.trial for event in run.read_events(NeedleRetreat)}
    for event in run.read_events(TipObserved):
        way.setdefault(event.trial, []).append(event.estimate.position_mm[1:])
    return {
        section.name: tuple(
            _trace(run, protocol, section, start, _join_path(start.trial, shafts, way, retreated))
            for start in run.read_events(InsertionStart)
        )
    }


def _join_path(
    trial: int, shafts: Mapping[int, Sequence[Point]], way: Mapping[int, Sequence[Point]], retreated: set[int]
) -> list[Point]:
    shaft = shafts.get(trial, ())
    return [*(way.get(trial, ()) if trial in retreated or not shaft else ()), *shaft]


def _trace(
    run: Run,
    protocol: InsertionProtocol,
    section: SpecimenSection,
    start: InsertionStart,
    path_mm: Sequence[Point],
) -> SpecimenTrack:
    return SpecimenTrack(
        run=run.path.name,
        trial=start.trial,
        hole=start.hole,
        needle_id=start.needle_id,
        age_h=find_track_age_h(run, section, start.t_s),
        **vars(make_shape(protocol, path_mm)),
    )
