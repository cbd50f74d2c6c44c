"""The answers of a design in sentences, on a terminal and on its page."""

from collections.abc import Iterator, Mapping
from typing import Any

from labrig.analysis.result import Summary
from labrig.experiments.hinge_design.result import DesignStudy
from labrig.needle.design_search import STEEPEST_CUT_DEG
from labrig.needle.tube import TABLE_1
from labrig.text import number


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return both answers in sentences, with what limits them."""
    kept = {key: value for key, value in document.items() if key in DesignStudy.model_fields}
    study = DesignStudy.model_validate(kept, strict=False)
    return *list_findings(study), *list_warnings(study)


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


def list_warnings(study: DesignStudy) -> Iterator[str]:
    """Yield what limits the answers."""
    if not study.tube.is_papers:
        yield "Equation (3) was fitted to a tube of 1.2 and 0.7 mm; for this one only our contour was searched."
    if study.search.reason is not None:
        yield f"No answer of our own: {study.search.reason}."
    if study.search.inside_grid is False:
        yield f"The inclination is beyond the searched grid, which ends at {STEEPEST_CUT_DEG:g} degrees."
    yield "Our contour is not the paper's, whose figure 2 is not in its text: it shows trends, and is not for cutting."
