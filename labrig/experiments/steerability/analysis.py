"""Radii of curvature in every picture of a sweep, gel by gel."""

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.result import AnalysisResult, Findings
from labrig.experiments.shared.curvature import CurvatureOrder, measure_curvature
from labrig.experiments.shared.curvature_result import CurvatureResult
from labrig.experiments.shared.grouping import find_final_pictures
from labrig.experiments.shared.holes import list_tracks as list_hole_tracks
from labrig.experiments.shared.specimen_result import map_specimens
from labrig.experiments.steerability.events import SweepRole
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.specimen_file import TracksBySpecimen
from labrig.record.reader import Run


def analyze(run: Run, protocol: SteerabilityProtocol, request: AnalysisRequest) -> Findings:
    """Measure every picture, as `measure_curvature` does, and map the tracks in each specimen."""
    content, save = measure_curvature(run, make_order(protocol), request)
    maps = map_specimens(
        protocol.gels,
        trace_sweep(run, protocol, content),
        protocol.sheath.diameter_mm,
        protocol.last_place_mm,
        protocol.needle.needle_id,
    )
    return Findings(content.model_copy(update={"maps": maps}), save)


def list_tracks(
    run: Run, protocol: SteerabilityProtocol, result: AnalysisResult[CurvatureResult] | None
) -> TracksBySpecimen:
    """Return the tracks that a run left in blocks with a specimen file, in order of time."""
    return trace_sweep(run, protocol, None if result is None else result.content)


def trace_sweep(
    run: Run, protocol: SteerabilityProtocol, content: CurvatureResult | None
) -> TracksBySpecimen:
    """Return those tracks with the radii of a result that were accepted."""
    finals = {} if content is None else find_final_pictures(content.measurements)
    radii_mm = {
        trial: final.radius_mm
        for trial, final in finals.items()
        if final.accepted and final.radius_mm is not None
    }
    return list_hole_tracks(run, protocol.gels, protocol.sheath.diameter_mm, radii_mm)


def make_order(protocol: SteerabilityProtocol) -> CurvatureOrder:
    """Return how the pictures of a sweep are measured."""
    return CurvatureOrder(
        protocol.pictured_needle, protocol.analysis, protocol.sheath, SweepRole.SHEATH, protocol.sentinel
    )
