"""The page `RUN/report.html`, whose content comes from the experiment."""

import shlex
from datetime import datetime
from pathlib import Path

from markupsafe import Markup

from labrig.analysis.result import AnyResult
from labrig.durable import write_atomically
from labrig.record.reader import Run
from labrig.report.heading import make_heading
from labrig.report.load_figure import draw_load_figure
from labrig.report.page import Page
from labrig.report.provenance import make_provenance
from labrig.report.rendering import TEMPLATES, render

REPORT_FILE = "report.html"


def write_report(
    run: Run, page: Page, result: AnyResult | None, created: datetime, *, kind: str, can_resume: bool
) -> Path:
    """Write `RUN/report.html`, replacing an older one, and return its path.

    Parameters
    ----------
    run : Run
        A run of any experiment and exit status.
    page : Page
        The content from its experiment.
    result : AnyResult or None
        The result behind it; None for a run without a result, which the page states.
    created : datetime
        Calendar time, aware.
    kind : str
        Title of the experiment.
    can_resume : bool
        Whether an interrupted run of it can be continued.

    Raises
    ------
    RecordError
        When the record or the result is too damaged to show anything.
    DiskError
        When the page cannot be written; an older one is untouched.
    """
    path = run.path / REPORT_FILE
    verdict = page.verdict if result is not None else [_state_no_result(run)]
    heading = make_heading(run, verdict, created, result, kind=kind, facts=page.facts, can_resume=can_resume)
    provenance = make_provenance(run, result, page.calibration)
    load = draw_load_figure(run.states, "load")
    shown = {"heading": heading, "load": load, "provenance": provenance, **page.shown}
    content = render(TEMPLATES / "bare.html.jinja" if page.template is None else page.template, shown)
    write_atomically(path, content.encode("utf-8"))
    return path


def _state_no_result(run: Run) -> Markup:
    nothing = Markup(
        "Nothing has been measured yet: there is no result. <code>labrig reanalyze {}</code> makes one."
    )
    return nothing.format(shlex.quote(str(run.path)))
