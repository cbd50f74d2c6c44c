"""The page, the figure and the tables of a comparison, in a folder of their own."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrig.analysis.comparison import ComparedRuns, Comparison, Group
from labrig.analysis.engine import describe_installation
from labrig.analysis.measurements import Measured
from labrig.durable import write_atomically
from labrig.record.difference import list_conditions
from labrig.record.json_lines import encode_document
from labrig.record.layout import read_checksum
from labrig.record.tables import encode_csv
from labrig.report.figures import SETTINGS, DrawnFigure, choose_limits, draw_interval, svg, write_figure
from labrig.report.formatting import UNKNOWN, count_decimals, format_value, label_key
from labrig.report.page import REPORT_FILE, TEMPLATES, tell_writing, write_page
from labrig.report.palette import mark
from labrig.steering.parameters import PAPER_SECTIONS, SECTIONS
from labrig.text import split_quantity, tell_value

TABLE_FILES = ("measurements.csv", "measurements.json")
DOCUMENT_FILE = "comparison.json"
MOST_GROUPS = 40
"""More rows than that are a carpet; the table has them."""
_MOST_VECTORS = 300
"""Points of a group that are drawn one by one; more of them become a picture, which is smaller."""


def write_comparison(
    folder: Path, compared: ComparedRuns, created: datetime, measured: Sequence[Measured]
) -> None:
    """Write report.html, comparison.json, measurements.csv and .json, and the figure as .svg and .pdf.

    `measured` are the runs, in the order of those that were used.

    Raises
    ------
    DiskError
        When one of them cannot be written.
    """
    content, table = compared.comparison, compared.table
    first = ["group", "block", "value"]
    others = [name for name in table.columns if name not in first and not str(name).startswith("by_")]
    tidy = table[[*first, *others]]
    write_atomically(folder / TABLE_FILES[0], encode_csv(tidy))
    records = tidy.astype(object).where(tidy.notna(), None).to_dict("records")
    write_atomically(folder / TABLE_FILES[1], encode_document({"measurements": records}))
    write_atomically(folder / DOCUMENT_FILE, encode_document(content.model_dump(mode="json")))
    is_drawn = len(content.groups) <= MOST_GROUPS
    readings = {group.name: _find_reading_sd(group, content.quantity, table) for group in content.groups}
    figure = draw_groups(content, table, readings) if is_drawn else None
    if figure is not None:
        write_figure(folder, figure)
    widths = [(0.0, 2.0 * sd) for sd in readings.values() if sd is not None]
    decimals = count_decimals(
        (*(group.ci95 for group in content.groups), *widths), (group.mean for group in content.groups)
    )
    used = {run.name: run.run for run in measured if run.about in content.used}
    shown = {
        "content": content,
        "quantity": split_quantity(content.quantity)[0],
        "colours": [mark(place).colour for place in range(len(content.groups))] if is_drawn else [],
        "figure": figure,
        "readings": readings,
        "decimals": max(2, decimals),
        "runs": used,
        "conditions": [*list_conditions(*used.values())],
        "records": records,
        "paper": PAPER_SECTIONS,
        "sections": SECTIONS,
        "code_here": describe_installation(),
        "written": tell_writing(created),
    }
    filters = {
        "checksum": read_checksum,
        "with_unit": lambda value, key: UNKNOWN if value is None else tell_value(format_value(value), key),
    }
    write_page(folder / REPORT_FILE, TEMPLATES / "comparison.html.jinja", shown, filters)


def draw_groups(
    comparison: Comparison, table: pd.DataFrame, readings: Mapping[str, float | None]
) -> DrawnFigure:
    """Draw every measurement and the mean of each group, or a single value with the SD of its reading."""
    groups = comparison.groups
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 1.1 + 0.52 * len(groups)), layout="constrained")
        axes = figure.subplots()
        intervals = [ends for group in groups for ends in (group.ci95, group.ci95_with_shared)]
        single = [(group.mean, sd) for group in groups if (sd := readings[group.name]) is not None]
        ends = [mean + sign * sd for mean, sd in single if mean is not None for sign in (-1.0, 1.0)]
        axes.set_xlim(choose_limits([*table["value"].dropna(), *ends], intervals))
        if "error" in comparison.quantity:
            axes.set_xlim(left=0.0)  # the distance from a target is never negative
        for place, group in enumerate(groups):
            rows = table[(table["group"] == group.name) & table["value"].notna()]
            blocks = (
                rows.groupby("block")["value"].mean() if comparison.unit_of_analysis == "specimen" else ()
            )
            _draw_group(axes, place, group, rows["value"] if len(rows) > 1 else rows["value"][:0], blocks)
            if group.mean is not None and (sd := readings[group.name]) is not None:
                axes.errorbar(group.mean, place, xerr=sd, fmt="none", color=mark(place).colour, capsize=3.5)
        names = [name if len(name) <= 32 else f"{name[:29]}..." for name in (group.name for group in groups)]
        axes.set_yticks(range(len(groups)), names)
        axes.set_ylim(len(groups) - 0.5, -0.6)
        axes.set_xlabel(label_key(comparison.quantity))
        axes.grid(visible=True, axis="x")
        return svg(figure, "groups")


def _find_reading_sd(group: Group, quantity: str, table: pd.DataFrame) -> float | None:
    """Return the standard deviation of the reading of a group of one; None of several, or where it is not known."""
    column = f"sigma_{quantity.rpartition('.')[2]}"
    rows = table[(table["group"] == group.name) & table["value"].notna()]
    known = rows[column].dropna().tolist() if column in rows and len(rows) == 1 else []
    return float(known[0]) if known else None


def _draw_group(
    axes: Axes, place: int, group: Group, values: "pd.Series[float]", blocks: "pd.Series[float] | tuple[()]"
) -> None:
    """Draw measurements as dots, the means of blocks as rings, and the mean of the group with both intervals."""
    look = mark(place)
    # Spread in a fixed pattern, so that equal values do not cover each other.
    up = place - 0.25 + 0.035 * (np.arange(len(values)) % 5 - 2)
    dots = axes.plot(
        values, up, look.marker, color=look.colour, markersize=3.6, alpha=0.55, markeredgewidth=0
    )
    dots[0].set_rasterized(len(values) > _MOST_VECTORS)
    rings = np.full(len(blocks), place - 0.12)
    axes.plot(blocks, rings, "o", color=look.colour, markersize=6, fillstyle="none")
    if group.mean is not None:
        for ends, width in ((group.ci95_with_shared, 1.0), (group.ci95, 2.4)):
            if ends is not None:
                draw_interval(axes, ends, place, look.colour, width=width)
        axes.plot(group.mean, place, look.marker, color=look.colour, markersize=7)
