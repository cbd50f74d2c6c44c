"""Radii of curvature in every picture of a sweep, gel by gel."""

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.result import Findings
from labrig.experiments.shared.curvature import CurvatureOrder, analyze_curvature
from labrig.experiments.steerability.events import SweepRole
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.record.reader import Run


def analyze(run: Run, protocol: SteerabilityProtocol, request: AnalysisRequest) -> Findings:
    """Measure every picture, as `analyze_curvature` does."""
    return analyze_curvature(run, make_order(protocol), request)


def make_order(protocol: SteerabilityProtocol) -> CurvatureOrder:
    """Return how the pictures of a sweep are measured."""
    return CurvatureOrder(
        protocol.pictured_needle, protocol.analysis, protocol.sheath, SweepRole.SHEATH, protocol.sentinel
    )
