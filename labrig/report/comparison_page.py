"""The page, the figure and the tables of a comparison, in a folder of their own."""

import os
import textwrap
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from string import ascii_uppercase

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrig.analysis.comparison import ComparedRuns, Comparison, Group, compare_runs
from labrig.analysis.engine import describe_installation
from labrig.analysis.groups import Unit
from labrig.analysis.measurements import Measured
from labrig.durable import write_atomically
from labrig.record.difference import list_conditions
from labrig.record.json_lines import encode_document
from labrig.record.layout import read_checksum
from labrig.record.tables import encode_csv
from labrig.report.figures import (
    MOST_VECTORS,
    SETTINGS,
    DrawnFigure,
    choose_limits,
    draw_interval,
    svg,
    write_figure,
)
from labrig.report.formatting import UNKNOWN, count_decimals, format_value, label_key
from labrig.report.page import REPORT_FILE, TEMPLATES, read_world, tell_writing, write_page
from labrig.report.palette import mark
from labrig.steering.parameters import PAPER_SECTIONS, SECTIONS
from labrig.text import split_quantity, tell_value

TABLE_FILES = ("measurements.csv", "measurements.json")
DOCUMENT_FILE = "comparison.json"
MOST_GROUPS = 40
"""More rows than that are a carpet; the table has them."""
_LONGEST_NAME = 16


def write_comparison(
    folder: Path, compared: ComparedRuns, created: datetime, measured: Sequence[Measured]
) -> Comparison:
    """Write report.html, comparison.json, measurements.csv and .json, and the figure; return what the page shows.

    `measured` are the runs, in the order of those that were used.

    Raises
    ------
    DiskError
        When one of them cannot be written.
    """
    whole, table = compared.comparison, compared.table
    tidy = table.set_index(["group", "block", "value"]).reset_index()
    write_atomically(folder / TABLE_FILES[0], encode_csv(tidy))
    records = tidy.astype(object).where(tidy.notna(), None).to_dict("records")
    write_atomically(folder / TABLE_FILES[1], encode_document({"measurements": records}))
    write_atomically(folder / DOCUMENT_FILE, encode_document(whole.model_dump(mode="json")))
    content, table, letters = _shorten_runs(compared, measured)
    used = [run.run for run in measured if run.about in whole.used]
    ends = _name_ends(content.quantity, table)
    figure = draw_groups(content, table, ends) if len(content.groups) <= MOST_GROUPS else None
    if figure is not None:
        write_figure(folder, figure)
    shown = {
        "content": content,
        "quantity": split_quantity(content.quantity)[0],
        "colours": [mark(place).colour for place in range(len(content.groups))] if figure else [],
        "figure": figure,
        "ends": ends,
        "decimals": count_decimals([g.ci95 for g in content.groups], [g.mean for g in content.groups]),
        "letters": letters,
        "runs": dict(zip((run.run for run in content.used), used, strict=True)),
        "conditions": [*list_conditions(*used)],
        "records": table.astype(object).where(table.notna(), None).to_dict("records"),
        "paper": PAPER_SECTIONS,
        "sections": SECTIONS,
        "code_here": describe_installation(),
        "written": tell_writing(created),
    }
    filters = {
        "checksum": read_checksum,
        "world": read_world,
        "link": lambda run: Path(os.path.relpath(run / REPORT_FILE, folder)).as_posix(),
        "with_unit": lambda value, key: UNKNOWN if value is None else tell_value(format_value(value), key),
    }
    write_page(folder / REPORT_FILE, TEMPLATES / "comparison.html.jinja", shown, filters)
    return content


def _shorten_runs(
    compared: ComparedRuns, measured: Sequence[Measured]
) -> tuple[Comparison, pd.DataFrame, Mapping[str, str]]:
    """Return comparison and table, with letters for runs whose names are too long for a figure, and these letters."""
    whole, names = compared.comparison, [run.run for run in compared.comparison.used]
    if "run" not in whole.by or max(map(len, names)) <= _LONGEST_NAME or len(names) > len(ascii_uppercase):
        return whole, compared.table, {}
    letters = {name: f"run {letter}" for name, letter in zip(names, ascii_uppercase, strict=False)}
    lettered = [run.rename(letters.get(run.name, run.name)) for run in measured]
    short = compare_runs(lettered, quantity=whole.quantity, by=compared.asked)
    content = short.comparison.model_copy(update={"left_out": whole.left_out})
    return content, compared.table.assign(run=short.table["run"], group=short.table["group"]), letters


def draw_groups(comparison: Comparison, table: pd.DataFrame, ends: tuple[str, str] | None) -> DrawnFigure:
    """Draw the mean of each group and its measurements; in space, and of one alone, the interval of each."""
    groups, in_space = comparison.groups, ends is not None and ends[0].startswith("target_error")
    rows = table[table["value"].notna() & table["group"].notna()]
    rows = rows.assign(true=rows.get("true_target_error_mm", np.nan))
    alone = rows if in_space else rows[~rows["group"].duplicated(keep=False)]
    parts = [rows[rows["group"] == group.name] for group in groups]
    lines = np.array([max(1, len(part)) if in_space else 1 for part in parts])
    places = (np.cumsum(lines) - (lines + 1) / 2.0).tolist()
    with mpl.rc_context(SETTINGS):
        height_in = 1.1 + max(0.52 * len(groups), 0.26 * min(lines.sum(), MOST_GROUPS))
        figure = Figure(figsize=(9.6, height_in), layout="constrained")
        axes = figure.subplots()
        shown = [*alone[[*(ends or ())]].stack(), *rows["true" if in_space else "value"].dropna()]
        intervals = [] if in_space else [group.ci95_with_shared or group.ci95 for group in groups]
        allowed_mm = rows.get("tolerance_mm", pd.Series()).unique().tolist() if in_space else []
        axes.set_xlim(choose_limits([*shown, *allowed_mm], intervals))
        if "error" in comparison.quantity:
            axes.set_xlim(left=0.0)  # the distance from a target is never negative
        for number, (group, part) in enumerate(zip(groups, parts, strict=True)):
            if not in_space:
                _draw_group(axes, number, group, part, comparison.unit_of_analysis)
            if ends is not None and (in_space or len(part) == 1):
                _draw_readings(axes, places[number], part, ends, mark(number).colour)
        axes.set_yticks(places, [f"{textwrap.fill(group.name, 32)}\nn = {group.n}" for group in groups])
        axes.set_ylim(lines.sum() - 0.5, -0.6)
        axes.vlines(allowed_mm, *axes.get_ylim(), colors="#555555", linewidth=1.0, linestyle=(0, (4, 2.5)))
        axes.set_xlabel(label_key(comparison.quantity).replace(" (", " in space (" if in_space else " ("))
        axes.grid(visible=True, axis="x")
        return svg(figure, "groups")


def _name_ends(quantity: str, table: pd.DataFrame) -> tuple[str, str] | None:
    """Return the columns of the 95 % interval of each measurement; None without them."""
    stem, _, unit = quantity.rpartition(".")[2].rpartition("_")
    found = [(f"{stem}_{kind}low_{unit}", f"{stem}_{kind}high_{unit}") for kind in ("", "ci95_")]
    return next((ends for ends in found if ends[0] in table), None)


def _draw_readings(axes: Axes, place: float, rows: pd.DataFrame, ends: tuple[str, str], colour: str) -> None:
    """Draw the intervals of measurements below each other about a place, and upright their true values."""
    lines = place + np.arange(len(rows)) - (len(rows) - 1) / 2.0
    for (low, high), line in zip(rows[[*ends]].to_numpy(float).tolist(), lines.tolist(), strict=True):
        if np.isfinite(low):
            draw_interval(axes, (low, high), line, colour, width=2.4)
    axes.plot(rows["true"], lines, "|k", markersize=15, markeredgewidth=2.2)


def _draw_group(axes: Axes, place: int, group: Group, rows: pd.DataFrame, unit: Unit) -> None:
    """Draw measurements as dots, the means of blocks as rings, and the mean of the group with its interval."""
    look, values = mark(place), rows["value"].tolist() if len(rows) > 1 else []
    # Spread in a fixed pattern, so that equal values do not cover each other.
    up = place - 0.25 + 0.035 * (np.arange(len(values)) % 5 - 2)
    dots = axes.plot(values, up, look.marker, c=look.colour, markersize=4.2, alpha=0.85, markeredgewidth=0)
    dots[0].set_rasterized(len(values) > MOST_VECTORS)
    if unit == "specimen":
        blocks = rows.groupby("block")["value"].mean()
        axes.plot(blocks, np.full(len(blocks), place - 0.12), "o", c=look.colour, ms=6, fillstyle="none")
    if group.mean is not None:
        if ends := group.ci95_with_shared or group.ci95:
            draw_interval(axes, ends, place, look.colour, width=2.4)
        axes.plot(group.mean, place, look.marker, color=look.colour, markersize=7)
