"""The page of an experiment without one of its own: its table, each quantity by trial, and the pictures."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.figure import Figure

from labrig.analysis.pictures import PLANE_FILE, load_plane_map
from labrig.analysis.result import AnalysisResult
from labrig.analysis.row_table import RowTable
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run
from labrig.report.figures import SETTINGS, svg
from labrig.report.formatting import Rows, number
from labrig.report.page import Page
from labrig.report.palette import mark
from labrig.report.pictures import THUMBNAIL, photograph
from labrig.text import format_count

TEMPLATE = Path(__file__).parent / "templates" / "rows.html.jinja"

_OF_THE_PICTURE = ("trial", "frame", "role", "insertion_mm", "rotation_rad", "linear_mm", "reason")
_MOST_PICTURES = 24


def make_page(run: Run, protocol: ExperimentProtocol, result: AnalysisResult[RowTable] | None) -> Page:
    """Return the page of a run; without a result, the facts of its protocol."""
    facts = _list_facts(protocol)
    if result is None:
        return Page(facts)
    content = result.content
    shown = [row for row in content.rows if row["frame"] is not None][:_MOST_PICTURES]
    return Page(
        facts,
        TEMPLATE,
        [_write_verdict(content)],
        load_plane_map(run) if PLANE_FILE in run.calibration_files else None,
        {
            "columns": content.columns,
            "rows": [[_tell(row.get(name)) for name in content.columns] for row in content.rows],
            "figures": [_draw(content, name, place) for place, name in enumerate(_list_quantities(content))],
            "pictures": [
                (photograph(run.read_frame(int(str(row["frame"]))), THUMBNAIL), f"trial {row['trial']}")
                for row in shown
            ],
        },
    )


def _list_facts(protocol: ExperimentProtocol) -> Rows:
    """Return what is plain in a protocol: its own numbers and words."""
    own = protocol.model_dump(exclude=set(ExperimentProtocol.model_fields))
    return tuple((name, str(value)) for name, value in own.items() if isinstance(value, int | float | str))


def _write_verdict(content: RowTable) -> str:
    measured = sum(row.get("reason") is None for row in content.rows)
    told = "".join(f"; {name}: {_tell(value)}" for name, value in content.conclusion.items())
    return f"{measured} of {format_count(len(content.rows), 'picture')} measured{told}."


def _list_quantities(content: RowTable) -> Iterator[str]:
    """Yield the measured columns that hold numbers."""
    for name in content.columns:
        values = [row.get(name) for row in content.rows]
        if name not in _OF_THE_PICTURE and any(isinstance(value, float) for value in values):
            yield name


def _draw(content: RowTable, name: str, place: int) -> Markup:
    """Draw a quantity over the trials."""
    points: Sequence[tuple[Any, Any]] = [
        (row["trial"], row[name]) for row in content.rows if row.get(name) is not None
    ]
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(6.4, 2.6), layout="constrained")
        axes = figure.subplots()
        seen = mark(place)
        axes.plot(*zip(*points, strict=True), linestyle="none", marker=seen.marker, color=seen.colour)
        axes.set_xlabel("trial")
        axes.set_ylabel(name)
        axes.grid(visible=True)
        return svg(figure, f"rows-{place}")


def _tell(value: Any) -> str:
    return "–" if value is None else number(value) if isinstance(value, float) else str(value)
