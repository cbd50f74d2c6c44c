"""What the page of a design run shows."""

from pathlib import Path

from labrig.analysis.result import AnalysisResult
from labrig.experiments.hinge_design.figure import draw_hinge_figure, draw_section
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.experiments.hinge_design.result import DesignResult
from labrig.experiments.hinge_design.summary import list_findings, list_warnings
from labrig.needle.hinge import Hinge
from labrig.record.reader import Run
from labrig.report.figures import DrawnFigure
from labrig.report.page import Page

TEMPLATE = Path(__file__).with_name("page.html.jinja")


def make_page(_run: Run, _protocol: DesignProtocol, result: AnalysisResult[DesignResult]) -> Page:
    """Return the page of a design: both answers, figure 3, and the searched grid."""
    content, search = result.content, result.content.search
    shown = {
        "sentences": list_findings(content),
        "section": _draw_section(content),
        "figure": draw_hinge_figure(content.cells, search.fit, "rotations"),
        "warnings": list(list_warnings(content))[:-1],
    }
    return Page(TEMPLATE, shown=shown)


def _draw_section(content: DesignResult) -> DrawnFigure | None:
    """Return the drawing of the hinge on our contour; None if that has no answer."""
    cut_deg = content.search.beta_cut_deg
    return (
        None
        if cut_deg is None
        else draw_section(Hinge(content.tube, content.clearance_mm, cut_deg), "section")
    )
