"""The page of a steerability sweep: its table beside the paper's, figure 8, pictures and refusals."""

from labrig.analysis.result import AnalysisResult
from labrig.experiments.shared.curvature_page import TEMPLATE, make_curvature_page
from labrig.experiments.shared.curvature_result import CurvatureResult
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.record.reader import Run
from labrig.report.figures import Design
from labrig.report.page import Page

__all__ = ["TEMPLATE", "make_page"]


def make_page(run: Run, protocol: SteerabilityProtocol, result: AnalysisResult[CurvatureResult]) -> Page:
    """Return the page of a sweep."""
    design = Design(protocol.needle.design_radius_mm, protocol.insertion.length_mm, side=1)
    return make_curvature_page(run, result, design)
