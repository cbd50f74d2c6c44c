"""Radii of curvature in every picture of a sweep, gel by gel."""

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.pictures import Analysis
from labrig.analysis.result import Findings
from labrig.experiments.shared.curvature import CurvatureOrder, measure_curvature
from labrig.experiments.steerability.events import SweepRole
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.experiments.steerability.tracks import map_sweep
from labrig.record.reader import Run


def analyze(run: Run, protocol: SteerabilityProtocol, request: AnalysisRequest) -> Analysis[Findings]:
    """Measure every picture, as `measure_curvature` does, and map the tracks in each specimen."""
    content, save = yield from measure_curvature(run, make_order(protocol), request)
    return Findings(content.model_copy(update={"maps": map_sweep(run, protocol, content)}), save)


def make_order(protocol: SteerabilityProtocol) -> CurvatureOrder:
    """Return how the pictures of a sweep are measured."""
    return CurvatureOrder(
        protocol.pictured_needle, protocol.analysis, protocol.sheath, SweepRole.SHEATH, protocol.sentinel
    )
