"""What the page of a design run shows."""

from pathlib import Path

from labrig.analysis.result import AnalysisResult
from labrig.experiments.hinge_design.figure import draw_hinge_figure, draw_section
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.experiments.hinge_design.result import DesignResult, list_findings, list_warnings
from labrig.experiments.shared.paper import PAPER_GELS
from labrig.needle.equations import FIT_SD, radius_mm
from labrig.needle.hinge import Hinge
from labrig.record.reader import Run
from labrig.report.page import Page

TEMPLATE = Path(__file__).with_name("page.html.jinja")


def make_page(_run: Run, _protocol: DesignProtocol, result: AnalysisResult[DesignResult]) -> Page:
    """Return the page of a design: both answers, the hinge if there is one to cut, and figure 3."""
    content = result.content
    cut_deg = content.beta_cut_deg if content.basis == "equation (3)" else content.search.beta_cut_deg
    hinge = None if cut_deg is None else Hinge(content.tube, content.clearance_mm, cut_deg)
    shown = {
        "sentences": list(list_findings(content)),
        "section": None if hinge is None else draw_section(hinge, "section"),
        "radius_mm": radius_mm,
        "fit_sd": FIT_SD,
        "paper_gels": PAPER_GELS,
        "figure": draw_hinge_figure(content, "rotations"),
        "warnings": list(list_warnings(content))[:-1],
    }
    return Page(TEMPLATE, shown=shown)
