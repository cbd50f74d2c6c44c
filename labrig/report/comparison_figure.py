"""The figure of a comparison: the measurements of each group with their means."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from labrig.analysis.comparison import Comparison, Group
from labrig.report.figures import SETTINGS, DrawnFigure, svg
from labrig.report.formatting import label_quantity
from labrig.report.palette import Mark, mark

MOST_GROUPS = 40
"""More rows than that are a carpet; the table has them."""
_MOST_VECTORS = 300
"""Points of a group that are drawn one by one; more of them become a picture, which is smaller."""


def mark_groups(groups: Sequence[Group]) -> tuple[Mark, ...]:
    """Return the mark of each group, none of groups that are not drawn."""
    return tuple(mark(index) for index in range(len(groups))) if len(groups) <= MOST_GROUPS else ()


def draw_groups(comparison: Comparison, table: pd.DataFrame, name: str) -> DrawnFigure | None:
    """Draw every measurement and the mean of each group; None for more groups than a figure can show."""
    groups = comparison.groups
    if len(groups) > MOST_GROUPS:
        return None
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 1.1 + 0.52 * len(groups)), layout="constrained")
        axes = figure.subplots()
        for place, (group, look) in enumerate(zip(groups, mark_groups(groups), strict=True)):
            rows = table[(table["group"] == group.name) & table["value"].notna()]
            by_block = comparison.unit_of_analysis == "specimen"
            _draw_group(axes, place, group, look, rows, by_block=by_block)
        axes.set_yticks(range(len(groups)), [_shorten(group.name) for group in groups])
        axes.set_ylim(len(groups) - 0.5, -0.6)
        axes.set_xlabel(label_quantity(comparison.quantity))
        axes.grid(visible=True, axis="x")
        return svg(figure, name)


def _draw_group(
    axes: Axes, place: int, group: Group, look: Mark, rows: pd.DataFrame, *, by_block: bool
) -> None:
    # Spread in a fixed pattern, so that equal values do not cover each other.
    up = place - 0.2 + 0.035 * (np.arange(len(rows)) % 5 - 2)
    _scatter(axes, rows["value"], up, look, size=3.6, alpha=0.55)
    if by_block:
        means = rows.groupby("block")["value"].mean()
        axes.plot(
            means, np.full(len(means), place - 0.02), "o", color=look.colour, markersize=6, fillstyle="none"
        )
    if group.mean is None:
        return
    for interval, width in ((group.ci95_with_shared, 1.0), (group.ci95, 2.4)):
        if interval is not None:
            axes.plot(
                interval, [place + 0.2] * 2, "-", color=look.colour, linewidth=width, marker="|", markersize=8
            )
    axes.plot(group.mean, place + 0.2, look.marker, color=look.colour, markersize=7)


def _scatter(axes: Axes, x: ArrayLike, y: ArrayLike, look: Mark, *, size: float, alpha: float) -> None:
    """Draw measurements as they are marked, as pixels where there are very many."""
    many = np.size(x) > _MOST_VECTORS
    axes.plot(
        x, y, look.marker, color=look.colour, markersize=size, alpha=alpha, markeredgewidth=0, rasterized=many
    )


def _shorten(name: str) -> str:
    return name if len(name) <= 32 else f"{name[:29]}..."
