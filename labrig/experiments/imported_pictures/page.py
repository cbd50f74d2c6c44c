"""The page of imported pictures: each picture with its measurement."""

from labrig.analysis.result import AnalysisResult
from labrig.experiments.imported_pictures.protocol import ImportProtocol
from labrig.experiments.shared.curvature_page import TEMPLATE, make_curvature_page
from labrig.experiments.shared.curvature_result import CurvatureResult
from labrig.record.reader import Run
from labrig.report.page import Page

__all__ = ["TEMPLATE", "make_page"]


def make_page(run: Run, _protocol: ImportProtocol, result: AnalysisResult[CurvatureResult]) -> Page:
    """Return the page of imported pictures."""
    return make_curvature_page(run, result)
