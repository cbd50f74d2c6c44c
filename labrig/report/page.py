"""The page of a run, `RUN/report.html`: its content comes from the experiment, all else from the record.

What stands on every page is in `templates/base.html.jinja`: the head, what was done, and what the numbers rest on.
"""

import math
import re
import shlex
import statistics
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from labrig import __version__
from labrig.analysis.pictures import PLANE_FILE, load_lens
from labrig.analysis.result import AnyResult
from labrig.durable import write_atomically
from labrig.errors import FileFormatError, RecordError
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.events import UNENDED, TrialStart, TrialStop
from labrig.record.layout import INCOMPLETE, is_simulated
from labrig.record.notes import Annotations
from labrig.record.reader import Run
from labrig.report.event_words import list_decisions
from labrig.report.formatting import flatten, format_time, format_value, interval, mark_breaks, number, signed
from labrig.report.pictures import PLATE, photograph
from labrig.text import format_count, split_key
from labrig.vision.calibration_file import read_creation_time
from labrig.vision.error_budget import ErrorBudget
from labrig.vision.plane import PlaneMap

REPORT_FILE = "report.html"
TEMPLATES = Path(__file__).parent / "templates"
_LOOSE_UNIT = re.compile(
    r"(<code>.*?</code>)|(?<=\d) (?=(?:mm|µm|px|degrees?|rad|ms|min|s)\b|[%±])|(?<=±) (?=[\d−])", re.DOTALL
)
_NONE: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Page:
    """The content of a page, from an experiment.

    Attributes
    ----------
    template : Path
        The experiment's template, which extends `base.html.jinja`. Its block `facts` tells the `protocol`, also without
        a result; `verdict`, the result in a sentence or two, `body` with its picture, `results` and `sure` find `run`,
        `result`, its `content` and its `folder` beside what is in `shown`.
    plane : PlaneMap or None
        By which the pictures were measured; None for an experiment that measures none.
    shown : Mapping
        Further variables of the template, with all drawings.
    """

    template: Path
    plane: PlaneMap | None = None
    shown: Mapping[str, Any] = field(default_factory=dict)


def write_report(
    run: Run,
    protocol: ExperimentProtocol,
    page: Page,
    result: AnyResult | None,
    created: datetime,
    *,
    kind: str,
    can_resume: bool,
) -> Path:
    """Write `RUN/report.html`, replacing an older one, and return its path.

    Parameters
    ----------
    run : Run
        A run of any experiment and exit status.
    protocol : ExperimentProtocol
        Its protocol.
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
    trials = run.read_trials(TrialStart, TrialStop)
    annotations, unreadable = _read_annotations(run)
    known = {f"{problem.where}: {problem.message}" for problem in run.damage}
    shown = {
        "run": run,
        "protocol": protocol,
        "page": page,
        "result": result,
        "content": None if result is None else result.content,
        "folder": "" if result is None else f"analysis/{result.path.name}",
        "kind": kind,
        "can_resume": can_resume,
        "written": tell_writing(created),
        "status": str(run.manifest.get("exit_status", INCOMPLETE)),
        "world": read_world(run),
        "is_simulated": not run.truth.empty or is_simulated(run.manifest),
        "annotations": annotations,
        "unreadable": unreadable,
        "damage": () if result is None else [fault for fault in result.content.damage if fault not in known],
        "trials": trials,
        "ended": sum(trial.exit_status not in UNENDED for trial in trials),
        "done": sum(trial.exit_status == "success" and not trial.left_out for trial in trials),
        "decisions": list_decisions(run),
        "last_picture": None
        if result or not run.frame_lines
        else photograph(run, run.frame_lines[-1].frame, PLATE),
        "lens": None if page.plane is None else load_lens(run),
        "calibrated": None
        if page.plane is None or PLANE_FILE not in run.calibration_files
        else read_creation_time(run.calibration_path(PLANE_FILE)),
        **page.shown,
    }
    write_page(run.path / REPORT_FILE, page.template, shown)
    return run.path / REPORT_FILE


def write_page(
    path: Path, template: Path, shown: Mapping[str, Any], filters: Mapping[str, Any] = _NONE
) -> None:
    """Write a page; text in it is escaped, and a variable that is missing is refused. `filters` are added to ours.

    Raises
    ------
    DiskError
        When it cannot be written; an older one is untouched.
    """
    environment = _open_environment(template.parent, tuple(filters.items()))
    write_atomically(path, environment.get_template(template.name).render(shown).encode())


def tell_writing(created: datetime) -> str:
    """Return when a page was written, and by what."""
    return f"Written {format_time(created.isoformat(timespec='seconds'))} by labrig {__version__}"


def _read_annotations(run: Run) -> tuple[Annotations, str]:
    """Return verdict, tags and notes of a run, or none and why they cannot be read."""
    try:
        return run.annotations, ""
    except RecordError as error:
        return Annotations(), error.message.replace(f"{run.path}/", "")


def read_world(run: Run) -> Mapping[str, Any]:
    """Return what the rig file says of the simulated world; nothing on a real rig."""
    with suppress(FileFormatError):
        match run.rig:
            case {"world": Mapping() as world}:
                return world
    return _NONE


def _take_medians(budgets: Iterable[ErrorBudget | None]) -> ErrorBudget | None:
    """Return the median of each source over the budgets that know it; None without a budget."""
    known = pd.DataFrame([budget.model_dump() for budget in budgets if budget is not None], dtype=float)
    return None if known.empty else ErrorBudget.model_validate(known.median().dropna().to_dict())


def _bind_units(page: Markup) -> Markup:
    """Return a page in which no line ends between a number and its unit; what is to be copied is left as it is."""
    # Safe: what enters a page was escaped, and a space is all that is changed.
    return Markup(_LOOSE_UNIT.sub(lambda found: found[1] or "\u00a0", page))  # noqa: S704


def _select_said(words: Iterable[tuple[str, str]], page: Markup) -> list[tuple[str, str]]:
    """Return the words, with their meanings, that stand in the text of a page."""
    # Safe: a stroke is all that is added, so that no word begins in one cell and ends in the next.
    text = Markup(str(page).replace("<", " / <")).striptags().replace("\u00a0", " ")  # noqa: S704
    pattern = {word: re.sub("y$", "(y|ie)", re.escape(word)) for word, _ in words}
    return [each for each in words if re.search(rf"\b{pattern[each[0]]}s?\b", text, re.IGNORECASE)]


_FILTERS = {
    "number": number,
    "signed": signed,
    "interval": interval,
    "count_of": format_count,
    "breakable": mark_breaks,
    "rows": flatten,
    "shell": lambda path: shlex.quote(str(path)),
    "joined": shlex.join,
    "time": format_time,
    "told": format_value,
    "medians": _take_medians,
    "mode": statistics.mode,
    "dist": math.dist,
    "interp": np.interp,
    "sd": statistics.stdev,
    "bind_units": _bind_units,
    "said_in": _select_said,
    "in_words": lambda key: split_key(key)[0].replace("_", " "),
}


@lru_cache(maxsize=8)
def _open_environment(folder: Path, filters: tuple[tuple[str, Any], ...]) -> Environment:
    """Return what reads templates of a folder and ours; it is kept, since each template is compiled once in it."""
    environment = Environment(
        loader=FileSystemLoader([folder, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({**_FILTERS, **dict(filters)})
    return environment
