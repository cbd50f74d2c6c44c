"""What the page of imported pictures shows."""

from labrig.analysis.result import AnalysisResult
from labrig.experiments.imported_pictures.protocol import ImportProtocol
from labrig.experiments.shared.curvature_page import make_curvature_page
from labrig.experiments.shared.curvature_result import CurvatureResult
from labrig.record.reader import Run
from labrig.report.formatting import number
from labrig.report.page import Page
from labrig.text import format_count


def make_page(run: Run, protocol: ImportProtocol, result: AnalysisResult[CurvatureResult] | None) -> Page:
    """Return the page of imported pictures: each picture with its measurement."""
    facts = (("Needle", f"{protocol.needle.needle_id}, {protocol.needle.diameter_mm:g} mm"),)
    if result is None:
        return Page(facts)
    return make_curvature_page(
        run, result, result.content, facts=facts, verdict=_write_verdict(result.content)
    )


def _write_verdict(content: CurvatureResult) -> list[str]:
    found = sum(measurement.found for measurement in content.measurements)
    accepted = sum(measurement.accepted for measurement in content.measurements)
    pictures = format_count(len(content.measurements), "picture")
    fitted = [
        measurement.sigma_radius_mm
        for measurement in content.measurements
        if not measurement.accepted and measurement.radius_mm is not None and measurement.sigma_radius_mm
    ]
    sentence = f"Shaft and tip were found in {found} of {pictures}; a radius can be stated in {accepted}."
    if not fitted:
        return [sentence]
    more = (
        f"In {len(fitted)} more it was fitted and refused, with a standard deviation of {number(min(fitted))} to "
        f"{number(max(fitted))} mm; the table shows each, with the reason."
    )
    return [f"{sentence} {more}"]
