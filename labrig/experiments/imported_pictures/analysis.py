"""Radii of curvature in imported pictures."""

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.result import Findings
from labrig.experiments.imported_pictures.protocol import ImportProtocol
from labrig.experiments.shared.curvature import CurvatureOrder, analyze_curvature
from labrig.record.reader import Run


def analyze(run: Run, protocol: ImportProtocol, request: AnalysisRequest) -> Findings:
    """Measure every picture, as `analyze_curvature` does."""
    order = CurvatureOrder(protocol.pictured_needle, protocol.analysis)
    return analyze_curvature(run, order, request)
