"""`RUN/report.html`: which page a run gets, and how it is rendered."""

import shlex
from datetime import datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from labrig.analysis import AnalysisResult, CalibrationResult, DesignResult, InsertionResult, RollZeroResult
from labrig.record import Run, write_atomically
from labrig.report.calibration_page import calibration_page, calibration_verdict
from labrig.report.curvature_page import calibration_rows, curvature_page, curvature_verdict
from labrig.report.design_page import design_page, design_verdict
from labrig.report.heading import make_heading
from labrig.report.insertion_words import arrival_verdict
from labrig.report.provenance import make_provenance
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
        return _bare(run, None, [nothing.format(shlex.quote(str(run.path)))], created)
    if isinstance(result.content, CalibrationResult):
        return _page(
            "calibration",
            {
                "heading": make_heading(run, calibration_verdict(result.content), created, result),
                "provenance": make_provenance(run, result),
                **calibration_page(run, result, result.content),
            },
        )
    if isinstance(result.content, DesignResult):
        return _page(
            "design",
            {
                "heading": make_heading(run, design_verdict(result.content), created),
                "provenance": make_provenance(run, result),
                **design_page(result, result.content),
            },
        )
    if isinstance(result.content, InsertionResult | RollZeroResult):
        return _bare(run, result, arrival_verdict(result.content), created)
    return _page(
        "curvature",
        {
            "heading": make_heading(run, curvature_verdict(run, result.content), created, result),
            "provenance": make_provenance(run, result, calibration_rows(run)),
            **curvature_page(run, result, result.content),
        },
    )


def _bare(run: Run, result: AnalysisResult | None, verdict: list[Markup], created: datetime) -> str:
    """Return a page of heading and provenance alone."""
    rows = () if result is None else calibration_rows(run)
    return _page(
        "bare",
        {
            "heading": make_heading(run, verdict, created, result),
            "provenance": make_provenance(run, result, rows),
        },
    )


def _page(template: str, context: dict[str, Any]) -> str:
    return _PAGES.get_template(f"{template}.html.jinja").render(context)
