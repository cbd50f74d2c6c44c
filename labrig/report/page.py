"""`RUN/report.html`: which page a run gets, and how it is rendered."""

import shlex
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from labrig.analysis.result import (
    AnalysisResult,
    CalibrationResult,
    DesignResult,
    InsertionResult,
    RollZeroResult,
)
from labrig.record.durable import write_atomically
from labrig.record.reader import Run
from labrig.report.calibration_page import calibration_page, calibration_verdict
from labrig.report.curvature_page import calibration_rows, curvature_page, curvature_verdict
from labrig.report.design_page import design_page, design_verdict
from labrig.report.heading import make_heading
from labrig.report.insertion_page import insertion_page, insertion_verdict
from labrig.report.provenance import Rows, make_provenance
from labrig.report.roll_zero_page import roll_zero_page, roll_zero_verdict
from labrig.report.words import breakable, count_of, interval, number, signed

REPORT_FILE = "report.html"

_PAGES = Environment(
    loader=FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_PAGES.filters.update(number=number, signed=signed, interval=interval, count_of=count_of, breakable=breakable)


def write_report(run: Run, result: AnalysisResult | None, created: datetime) -> Path:
    """Write `RUN/report.html`, replacing an older one, and return its path.

    Parameters
    ----------
    run : Run
        Of any experiment and any exit status.
    result : AnalysisResult or None
        What is shown; None for a run without a result, whose page says so.
    created : datetime
        Calendar time, aware.

    Raises
    ------
    RecordError
        When the record or the result is damaged so that nothing can be shown.
    DiskError
        When the page cannot be written; an older one is untouched.
    """
    path = run.path / REPORT_FILE
    write_atomically(path, _render(run, result, created).encode("utf-8"))
    return path


def _render(run: Run, result: AnalysisResult | None, created: datetime) -> str:
    if result is None:
        nothing = Markup(
            "Nothing has been measured yet: there is no result. <code>labrig reanalyze {}</code> makes one."
        )
        verdict = [nothing.format(shlex.quote(str(run.path)))]
        return _page(
            "bare", {"heading": make_heading(run, verdict, created), "provenance": make_provenance(run, None)}
        )
    template, said, rows, shown = _parts(run, result)
    return _page(
        template,
        {
            "heading": make_heading(run, said, created, result),
            "provenance": make_provenance(run, result, rows),
            **shown,
        },
    )


def _parts(run: Run, result: AnalysisResult) -> tuple[str, Sequence[str], Rows, dict[str, Any]]:
    """Return the template of a result's page, its verdict, what is told of the calibration, and what it shows."""
    match result.content:
        case CalibrationResult() as content:
            return "calibration", calibration_verdict(content), (), calibration_page(run, result, content)
        case DesignResult() as content:
            return "design", design_verdict(content), (), design_page(result, content)
        case InsertionResult() as content:
            shown = insertion_page(run, result, content)
            return "insertion", insertion_verdict(content), calibration_rows(run), shown
        case RollZeroResult() as content:
            return (
                "roll-zero",
                roll_zero_verdict(content),
                calibration_rows(run),
                roll_zero_page(run, content, f"analysis/{result.path.name}"),
            )
        case content:
            shown = curvature_page(run, result, content)
            return "curvature", curvature_verdict(run, content), calibration_rows(run), shown


def _page(template: str, context: dict[str, Any]) -> str:
    return _PAGES.get_template(f"{template}.html.jinja").render(context)
