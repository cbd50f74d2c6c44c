"""The answers of a design side by side, on a terminal and on its page."""

from collections.abc import Iterator, Mapping
from typing import Any

from labrig.analysis.result import Summary, TextTable
from labrig.experiments.hinge_design.result import DesignStudy
from labrig.needle.design_search import STEEPEST_CUT_DEG
from labrig.needle.equations import RadiusTolerance
from labrig.needle.tube import TABLE_1
from labrig.text import number

Row = tuple[str, str, str]


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return both answers side by side, with warnings about their limits."""
    kept = {key: value for key, value in document.items() if key in DesignStudy.model_fields}
    study = DesignStudy.model_validate(kept, strict=False)
    heads = ("", "equation (3)", "our contour")
    table = TextTable(heads, (*list_answers(study), *list_planes(study)))
    return *list_findings(study), table, *list_warnings(study)


def list_findings(study: DesignStudy) -> Iterator[str]:
    """Yield the answers in sentences."""
    search = study.search
    ours = search.reason or f"our own contour for {number(search.beta_cut_deg, 2)}"
    yield (
        f"For a radius of {number(study.radius_mm, 2)} mm two hinges turn {number(study.beta_rot_deg, 2)} degrees. "
        f"At a clearance of {study.clearance_mm:g} mm equation (3) asks for an inclination of "
        f"{number(study.beta_cut_deg, 2)} degrees, {ours}."
    )
    if study.is_table_1:
        yield (
            f"Table I prints {TABLE_1.beta_cut_deg} degrees; equation (3) solved for it gives "
            f"{number(study.beta_cut_deg, 2)}."
        )
    if study.measured is not None:
        measured = study.measured
        yield (
            f"Measured {number(measured.radius_mm, 2)} mm means {number(measured.beta_rot_deg, 2)} degrees; cut at "
            f"{number(measured.beta_cut_deg, 2)} degrees, a clearance of {number(measured.clearance_mm, 4)} mm by "
            f"equation (3), {number(measured.search_clearance_mm, 4)} mm by our contour."
        )


def list_answers(study: DesignStudy) -> Iterator[Row]:
    """Yield each quantity, its value by equation (3), and by our contour; those to cut by first."""
    search = study.search
    for label, key in (
        ("inclination to cut [degrees]", "beta_cut_deg"),
        ("two hinges turn [degrees]", "beta_rot_deg"),
    ):
        yield label, number(getattr(study, key), 2), number(getattr(search, key), 2)
    within, by_clearance, by_cut = zip(*map(_describe, (study.tolerance, search.tolerance)), strict=True)
    yield ("radius within the tolerances [mm]", *within)
    turns = f"{number(search.beta_a_deg, 2)}, {number(search.beta_b_deg, 2)}"
    yield "hinge a turns, hinge b turns [degrees]", "-", turns
    yield "radius [mm]", number(study.radius_mm, 2), number(search.radius_mm, 2)
    yield ("change of radius for 0.001 mm of clearance [mm]", *by_clearance)
    yield ("change of radius for 0.1 degrees of inclination [mm]", *by_cut)


def _describe(tolerance: RadiusTolerance | None) -> Row:
    """Return the radius within a tolerance, and its changes with clearance and inclination."""
    if tolerance is None:
        return "-", "-", "-"
    low, high = number(tolerance.low_mm, 2), number(tolerance.high_mm, 2)
    within = f"{low} or more" if tolerance.high_mm is None else f"{low} to {high}"
    return within, number(0.001 * tolerance.per_clearance), number(0.1 * tolerance.per_degree_mm)


def list_planes(study: DesignStudy) -> Iterator[Row]:
    """Yield each number of the planes, of equation (3) and of our contour."""
    for label, key, digits in (
        ("degrees per degree of inclination", "a", 3),
        ("degrees per mm of clearance", "b", 1),
        ("constant [degrees]", "c", 3),
        ("RMSE of the plane [degrees]", "rmse_deg", 4),
    ):
        paper, ours = getattr(study.equation_3, key), getattr(study.search.fit, key)
        yield label, number(paper, digits), number(ours, digits)


def list_warnings(study: DesignStudy) -> Iterator[str]:
    """Yield what limits the answers."""
    if not study.tube.is_papers:
        yield "Equation (3) was fitted to a tube of 1.2 and 0.7 mm; for this one only our contour was searched."
    if study.search.reason is not None:
        yield f"No answer of our own: {study.search.reason}."
    if study.search.inside_grid is False:
        yield f"The inclination is beyond the searched grid, which ends at {STEEPEST_CUT_DEG:g} degrees."
    yield "Our contour is not the paper's, whose figure 2 is not in its text: it shows trends, and is not for cutting."
