"""What the page of a design run shows."""

from pathlib import Path
from typing import Any

from labrig.analysis.result import AnalysisResult
from labrig.experiments.hinge_design.figure import draw_hinge_figure, draw_section
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.experiments.hinge_design.result import DesignResult
from labrig.experiments.hinge_design.summary import (
    list_answers,
    list_findings,
    list_planes,
    list_warnings,
)
from labrig.needle.hinge import Hinge
from labrig.record.reader import Run
from labrig.report.figures import DrawnFigure
from labrig.report.formatting import Rows
from labrig.report.page import Page

TEMPLATE = Path(__file__).with_name("page.html.jinja")


def make_page(_run: Run, protocol: DesignProtocol, result: AnalysisResult[DesignResult] | None) -> Page:
    """Return the page of a design: both answers, figure 3, and the searched grid."""
    facts = _list_facts(protocol)
    if result is None:
        return Page(facts)
    content = result.content
    return Page(facts, TEMPLATE, list(list_findings(content)), shown=_collect_content(content, protocol))


def _list_facts(protocol: DesignProtocol) -> Rows:
    tube, tolerances = protocol.tube, protocol.tolerances
    diameters = f"{tube.outer_diameter_mm:g} / {tube.inner_diameter_mm:g} mm"
    return (
        ("Tube", f"{diameters}, links of {tube.link_length_mm:g} mm"),
        ("Radius wanted", f"{protocol.radius_mm:g} mm"),
        ("Clearance", f"{protocol.clearance_mm:g} ± {tolerances.clearance_mm:g} mm"),
        ("Inclination", f"± {tolerances.cut_deg:g} degrees"),
    )


def _collect_content(content: DesignResult, protocol: DesignProtocol) -> dict[str, Any]:
    search = content.search
    return {
        "section": _draw_section(content),
        "tolerances": protocol.tolerances,
        "figure": draw_hinge_figure(content.cells, search.fit, "rotations"),
        "answers": list(list_answers(content)),
        "planes": list(list_planes(content)),
        "warnings": list(list_warnings(content))[:-1],
        "b_percent": 100 * (search.fit.b / content.equation_3.b - 1),
        "cut_deg": None if search.beta_cut_deg is None else search.beta_cut_deg - content.beta_cut_deg,
    }


def _draw_section(content: DesignResult) -> DrawnFigure | None:
    """Return the drawing of the hinge on our contour; None if that has no answer."""
    cut_deg = content.search.beta_cut_deg
    return (
        None
        if cut_deg is None
        else draw_section(Hinge(content.tube, content.clearance_mm, cut_deg), "section")
    )
