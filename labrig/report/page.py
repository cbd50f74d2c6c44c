"""`RUN/report.html`: the page kit, which an experiment fills."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from labrig.analysis.result import AnyResult
from labrig.record.durable import write_atomically
from labrig.record.reader import Run
from labrig.report.heading import make_heading
from labrig.report.provenance import make_provenance
from labrig.report.words import Rows, breakable, count_of, interval, number, signed

REPORT_FILE = "report.html"
_TEMPLATES = Path(__file__).parent / "templates"
_FILTERS = {
    "number": number,
    "signed": signed,
    "interval": interval,
    "count_of": count_of,
    "breakable": breakable,
}


@dataclass(frozen=True)
class Page:
    """What an experiment shows of a run.

    Attributes
    ----------
    facts : tuple
        Of the protocol, a term and a value each; also for a run without a result.
    template : Path or None
        The experiment's own, which extends `base.html.jinja`; None shows the head alone.
    verdict : sequence of str
        The page in a sentence or two.
    calibration : tuple
        How well lens and plane are known.
    shown : Mapping
        What the template needs, everything drawn.
    """

    facts: Rows = ()
    template: Path | None = None
    verdict: Sequence[str] = ()
    calibration: Rows = ()
    shown: Mapping[str, Any] = field(default_factory=dict)


def write_report(
    run: Run, page: Page, result: AnyResult | None, created: datetime, *, kind: str, can_resume: bool
) -> Path:
    """Write `RUN/report.html`, replacing an older one, and return its path.

    Parameters
    ----------
    run : Run
        Of any experiment and any exit status.
    page : Page
        What its experiment shows.
    result : AnyResult or None
        What that rests on; None for a run without a result, whose page says so.
    created : datetime
        Calendar time, aware.
    kind : str
        What the experiment is called.
    can_resume : bool
        Whether an interrupted run of it can be continued.

    Raises
    ------
    RecordError
        When the record or the result is damaged so that nothing can be shown.
    DiskError
        When the page cannot be written; an older one is untouched.
    """
    path = run.path / REPORT_FILE
    verdict = page.verdict if result is not None else [_nothing_measured(run)]
    heading = make_heading(run, verdict, created, result, kind=kind, facts=page.facts, can_resume=can_resume)
    provenance = make_provenance(run, result, page.calibration)
    content = _render(page.template, {"heading": heading, "provenance": provenance, **page.shown})
    write_atomically(path, content.encode("utf-8"))
    return path


def _nothing_measured(run: Run) -> Markup:
    nothing = Markup(
        "Nothing has been measured yet: there is no result. <code>labrig reanalyze {}</code> makes one."
    )
    return nothing.format(shlex.quote(str(run.path)))


def _render(template: Path | None, context: Mapping[str, Any]) -> str:
    own = _TEMPLATES / "bare.html.jinja" if template is None else template
    environment = Environment(
        loader=FileSystemLoader([own.parent, _TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(_FILTERS)
    return environment.get_template(own.name).render(context)
