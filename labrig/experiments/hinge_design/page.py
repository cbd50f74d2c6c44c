"""What the page of a design run shows."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labrig.analysis.result import AnalysisResult, AnyResult
from labrig.experiments.hinge_design.figure import draw_hinge_figure, draw_section
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.experiments.hinge_design.result import DesignResult
from labrig.experiments.hinge_design.study import find_design_basis
from labrig.needle.design_search import STEEPEST_CUT_DEG, GridPoint
from labrig.needle.equations import RotationPlane
from labrig.needle.hinge import Hinge
from labrig.needle.tube import Tube
from labrig.record.reader import Run
from labrig.report.figures import DrawnFigure
from labrig.report.formatting import Rows, interval, number
from labrig.report.page import Page
from labrig.report.pictures import data_uri
from labrig.text import format_count

TEMPLATE = Path(__file__).with_name("page.html.jinja")

# The tolerance if our contour has no answer.
_NO_TOLERANCE: dict[str, Any] = {
    "radius_mm": [None, None],
    "radius_mm_per_clearance_mm": None,
    "radius_mm_per_cut_deg": None,
}


def make_page(_run: Run, protocol: DesignProtocol, result: AnalysisResult[DesignResult] | None) -> Page:
    """Return the page of a design: both answers, figure 3, and the searched grid."""
    facts = _list_facts(protocol)
    if result is None:
        return Page(facts)
    return Page(
        facts, TEMPLATE, _write_verdict(result.content), shown=_collect_content(result, result.content)
    )


def _list_facts(protocol: DesignProtocol) -> Rows:
    tube, tolerances = protocol.tube, protocol.tolerances
    diameters = f"{tube.outer_diameter_mm:g} / {tube.inner_diameter_mm:g} mm"
    return (
        ("Tube", f"{diameters}, links of {tube.link_length_mm:g} mm"),
        ("Radius wanted", f"{protocol.radius_mm:g} mm"),
        ("Clearance", f"{protocol.clearance_mm:g} ± {tolerances.clearance_mm:g} mm"),
        ("Inclination", f"± {tolerances.cut_deg:g} degrees"),
    )


def _collect_content(result: AnyResult, content: DesignResult) -> dict[str, Any]:
    fit = RotationPlane(**content.search["fit"])
    cells = content.cells
    return {
        "content": content,
        "folder": f"analysis/{result.path.name}",
        "section": _draw_section(content),
        "figure": data_uri(draw_hinge_figure(cells, fit, "svg"), "image/svg+xml"),
        "answers": _list_answers(content),
        "planes": (
            ("degrees per degree of inclination", "a", 3),
            ("degrees per mm of clearance", "b", 1),
            ("constant, degrees", "c", 3),
            ("RMSE, degrees", "rmse_deg", 4),
        ),
        "basis": find_design_basis(content.model_dump()),
        "clearances_mm": sorted({cell.clearance_mm for cell in cells}),
        "rows": _group_cells(cells),
        "steepest_deg": STEEPEST_CUT_DEG,
        "shifts": {
            "b_percent": 100 * (content.search["fit"]["b"] / content.equation_3["b"] - 1),
            "cut_deg": None
            if content.search["beta_cut_deg"] is None
            else content.search["beta_cut_deg"] - content.beta_cut_deg,
        },
    }


def _draw_section(content: DesignResult) -> DrawnFigure | None:
    """Return the drawing of the hinge on our contour; None if that has no answer."""
    cut_deg = content.search["beta_cut_deg"]
    if cut_deg is None:
        return None
    return draw_section(Hinge(Tube(**content.tube), content.clearance_mm, cut_deg), "section")


def _write_verdict(content: DesignResult) -> list[str]:
    """Return the page in a sentence or two."""
    reason = content.search.get("reason")
    ours = f"our own contour for {number(content.search['beta_cut_deg'])}" if reason is None else reason
    sentence = (
        f"For a radius of {number(content.radius_mm)} mm two hinges turn {number(content.beta_rot_deg)} degrees. "
        f"At a clearance of {content.clearance_mm:g} mm equation (3) asks for an inclination of "
        f"{number(content.beta_cut_deg)} degrees, {ours}."
    )
    if content.table_1 is None:
        return [sentence]
    printed = (
        f"Table I of the paper prints {number(content.table_1['beta_cut_deg'])} degrees; equation (3) solved for it "
        f"gives {number(content.beta_cut_deg)}."
    )
    return [sentence, printed]


def _list_answers(content: DesignResult) -> list[tuple[str, str, str]]:
    """Return the rows of the table of answers: the quantity, its value by equation (3), and by our contour."""
    search = content.search
    both: list[tuple[str, Mapping[str, Any]]] = [("paper", content.model_dump()), ("ours", search)]
    tolerances = [answer["tolerance"] or _NO_TOLERANCE for _, answer in both]
    low_to_high = [_format_radius_interval(tolerance["radius_mm"]) for tolerance in tolerances]
    rows = [
        ("Inclination to cut [degrees]", *(number(answer["beta_cut_deg"]) for _, answer in both)),
        ("Two hinges turn [degrees]", *(number(answer["beta_rot_deg"]) for _, answer in both)),
        ("Radius within the tolerances [mm]", *low_to_high),
        (
            "Hinge a turns, hinge b turns [degrees]",
            number(None),
            _format_pair(search["beta_a_deg"], search["beta_b_deg"]),
        ),
        ("Radius [mm]", *(number(answer["radius_mm"]) for _, answer in both)),
        (
            "Change of radius for 0.001 mm of clearance [mm]",
            *(_format_slope(tolerance["radius_mm_per_clearance_mm"], 0.001) for tolerance in tolerances),
        ),
        (
            "Change of radius for 0.1 degrees of inclination [mm]",
            *(_format_slope(tolerance["radius_mm_per_cut_deg"], 0.1) for tolerance in tolerances),
        ),
    ]
    return [(label, paper, ours) for label, paper, ours in rows] + _list_optional_answers(content)


def _list_optional_answers(content: DesignResult) -> list[tuple[str, str, str]]:
    rows = []
    if content.measured is not None:
        measured = content.measured
        label = (
            f"Effective clearance of a needle measured at {number(measured['radius_mm'])} mm "
            f"({number(measured['beta_rot_deg'])} degrees), cut at {number(measured['beta_cut_deg'])} degrees [mm]"
        )
        rows.append((label, number(measured["clearance_mm"], 4), number(measured["search_clearance_mm"], 4)))
    if content.links is not None:
        links = format_count(content.links, "link")
        rows.append(("The tip takes", links, links))
    return rows


def _format_slope(slope_mm: float | None, change: float) -> str:
    return number(None if slope_mm is None else slope_mm * change, 3)


def _format_radius_interval(low_high: list[float | None]) -> str:
    low_mm, high_mm = low_high
    if low_mm is None:
        return number(None)
    if high_mm is None:
        return f"{number(low_mm)} or more"
    return interval((low_mm, high_mm))


def _format_pair(first: float | None, second: float | None) -> str:
    return f"{number(first)}, {number(second)}"


def _group_cells(cells: tuple[GridPoint, ...]) -> list[tuple[float, list[GridPoint]]]:
    """Return a row for each inclination, with its cells in order of clearance."""
    cuts_deg = sorted({cell.beta_cut_deg for cell in cells})
    by_clearance = sorted(cells, key=lambda cell: cell.clearance_mm)
    return [(cut, [cell for cell in by_clearance if cell.beta_cut_deg == cut]) for cut in cuts_deg]
