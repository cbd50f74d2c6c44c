"""The page of an experiment without one of its own: its table, each quantity by trial, and the pictures."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.figure import Figure

from labrig.analysis.pictures import PLANE_FILE, load_plane_map
from labrig.analysis.result import AnalysisResult
from labrig.analysis.row_table import OF_THE_PICTURE, RowTable
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run
from labrig.report.figures import SETTINGS, svg
from labrig.report.page import Page
from labrig.report.palette import mark
from labrig.report.pictures import THUMBNAIL, photograph

TEMPLATE = Path(__file__).parent / "templates" / "rows.html.jinja"

_MOST_PICTURES = 24


def make_page(run: Run, _protocol: ExperimentProtocol, result: AnalysisResult[RowTable]) -> Page:
    """Return the page of a run."""
    content = result.content
    shown = [row for row in content.rows if row["frame"] is not None][:_MOST_PICTURES]
    return Page(
        TEMPLATE,
        load_plane_map(run) if PLANE_FILE in run.calibration_files else None,
        {
            "figures": [_draw(content, name, place) for place, name in enumerate(_list_quantities(content))],
            "pictures": [
                (photograph(run, int(str(row["frame"])), THUMBNAIL), f"trial {row['trial']}") for row in shown
            ],
        },
    )


def _list_quantities(content: RowTable) -> Iterator[str]:
    """Yield the measured columns that hold numbers."""
    for name in content.columns:
        values = [row.get(name) for row in content.rows]
        if name not in OF_THE_PICTURE and any(isinstance(value, float) for value in values):
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
        axes.set(xlabel="trial", ylabel=name)
        axes.grid(visible=True)
        return svg(figure, f"rows-{place}")
