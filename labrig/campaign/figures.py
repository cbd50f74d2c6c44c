"""Figures of a campaign: its arms, and the measure over the keys that were varied or drawn."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray
from scipy.stats import binned_statistic_2d

from labrig.analysis.statistics import compute_spread
from labrig.campaign.result import CampaignResult
from labrig.campaign.statistics import ArmResult, Judgement, read_values
from labrig.report.figures import SETTINGS, DrawnFigure, svg
from labrig.report.formatting import label_quantity, name_settings
from labrig.report.palette import Mark, mark

FloatArray = NDArray[np.float64]

MOST_ARMS = 40
"""More of them are a carpet; the table has them."""
_MOST_PANELS = 6
_BINS = 12
_LEAST_IN_BIN = 5
_MOST_VECTORS = 300
_APART = 0.22
"""Of rows: the median stands above the mean, not on it."""


@dataclass(frozen=True)
class MapCircle:
    """A circle that a map shows, such as an obstacle: centre and radius in the units of the axes."""

    x: float
    y: float
    radius: float


def draw_arms(result: CampaignResult) -> DrawnFigure | None:
    """Draw the mean of each arm with its interval, and the share within the tolerance; None for too many arms."""
    arms = result.arms
    if len(arms) > MOST_ARMS:
        return None
    panels = 2 if result.tolerance is not None else 1
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 1.1 + 0.42 * len(arms)), layout="constrained")
        axes = figure.subplots(1, panels, sharey=True, squeeze=False)[0]
        for place, arm in enumerate(arms):
            _draw_arm(axes, place, arm)
        axes[0].set_yticks(range(len(arms)), [_shorten(arm.name) for arm in arms])
        axes[0].set_ylim(len(arms) - 0.5, -0.5)
        axes[0].set_xlabel(label_quantity(result.measure))
        if panels == 2:
            axes[1].set_xlabel(f"share within {result.tolerance:g}")
            axes[1].set_xlim(-0.02, 1.02)
        for panel in axes:
            panel.grid(visible=True, axis="x")
        return svg(figure, "arms")


def _draw_arm(axes: Sequence[Axes], place: int, arm: ArmResult) -> None:
    look = mark(place)
    if arm.mean is not None and arm.median is not None:
        axes[0].plot(arm.mean, place, look.marker, color=look.colour, markersize=7)
        axes[0].plot(
            arm.median, place - _APART, look.marker, color=look.colour, markersize=6, fillstyle="none"
        )
    if arm.ci95 is not None:
        axes[0].plot(arm.ci95, [place] * 2, "-", color=look.colour, linewidth=2, marker="|", markersize=8)
    if len(axes) > 1 and arm.share is not None and arm.share_ci95 is not None:
        axes[1].plot(arm.share, place, look.marker, color=look.colour, markersize=7)
        axes[1].plot(
            arm.share_ci95, [place] * 2, "-", color=look.colour, linewidth=2, marker="|", markersize=8
        )


def draw_over_key(result: CampaignResult, key: str) -> DrawnFigure:
    """Draw the mean of each arm over the value of a varied key; arms that differ in other keys are joined by lines."""
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 3.4), layout="constrained")
        axes = figure.subplots()
        for index, (label, arms) in enumerate(_group_arms(result.arms, key).items()):
            _draw_line(axes, arms, key, mark(index), label)
        axes.set_xlabel(label_quantity(key))
        axes.set_ylabel(f"mean {label_quantity(result.measure)}")
        axes.grid(visible=True)
        if len(axes.get_legend_handles_labels()[1]) > 1:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return svg(figure, "over-key")


def _group_arms(arms: Sequence[ArmResult], key: str) -> Mapping[str, list[ArmResult]]:
    """Return the arms with a mean and a number for the key, by their other settings."""
    groups: dict[str, list[ArmResult]] = {}
    for arm in arms:
        value = arm.settings.get(key)
        if arm.mean is not None and isinstance(value, int | float):
            others = ", ".join(part for part in arm.name.split(", ") if not _is_part_of(part, key))
            groups.setdefault(others, []).append(arm)
    return groups


def _is_part_of(part: str, key: str) -> bool:
    name, equals, _ = part.partition("=")
    return bool(equals) and (name == key or key.endswith(f".{name}"))


def _draw_line(axes: Axes, arms: Sequence[ArmResult], key: str, look: Mark, label: str) -> None:
    ordered = sorted(arms, key=lambda arm: float(str(arm.settings[key])))
    x = [float(str(arm.settings[key])) for arm in ordered]
    means = np.array([arm.mean for arm in ordered], dtype=np.float64)
    limits = np.array([arm.ci95 or (math.nan, math.nan) for arm in ordered], dtype=np.float64)
    axes.errorbar(
        x,
        means,
        yerr=np.abs(limits.T - means),
        fmt=f"{look.marker}-",
        color=look.colour,
        capsize=3.5,
        linewidth=1.3,
        label=_shorten(label),
    )
    axes.plot(
        x,
        [arm.median or 0.0 for arm in ordered],
        look.marker,
        color=look.colour,
        fillstyle="none",
        markersize=6,
    )


def draw_over_points(result: CampaignResult, table: pd.DataFrame, keys: Sequence[str]) -> DrawnFigure | None:
    """Draw the measure over each sampled key, point by point, with the mean of each twelfth of the range."""
    known = table[table["error"].isna() & table[result.measure].notna()]
    if known.empty:
        return None
    shown = keys[:_MOST_PANELS]
    with mpl.rc_context(SETTINGS):
        rows = (len(shown) + 2) // 3
        figure = Figure(figsize=(9.6, 0.4 + 2.8 * rows), layout="constrained")
        panels = figure.subplots(rows, min(3, len(shown)), squeeze=False).ravel()
        for panel, key in zip(panels, shown, strict=False):
            _draw_points(panel, known, key, result.measure)
        for panel in panels[len(shown) :]:
            panel.set_axis_off()
        return svg(figure, "over-points")


def _draw_points(axes: Axes, table: pd.DataFrame, key: str, measure: str) -> None:
    x, y = table[key].to_numpy(np.float64), table[measure].to_numpy(np.float64)
    look = mark(0)
    axes.plot(x, y, ".", color=look.colour, markersize=3, alpha=0.35, rasterized=len(x) > _MOST_VECTORS)
    edges = np.linspace(x.min(), x.max(), min(_BINS, max(1, len(x) // _LEAST_IN_BIN)) + 1)
    for low, high in pairwise(edges):
        inside = y[(x >= low) & (x <= high)]
        spread = compute_spread(inside.tolist())
        if spread.mean is not None and spread.ci95 is not None:
            axes.plot([(low + high) / 2] * 2, spread.ci95, "-", color="#000000", linewidth=1.5)
            axes.plot((low + high) / 2, spread.mean, "o", color="#000000", markersize=4)
    axes.set_xlabel(label_quantity(key))
    axes.set_ylabel(label_quantity(measure))
    axes.grid(visible=True)


def draw_map(
    table: pd.DataFrame, keys: tuple[str, str], by: Judgement, circles: Sequence[MapCircle], name: str
) -> DrawnFigure:
    """Draw where two sampled keys led within the tolerance: the share in each field, and every point.

    Parameters
    ----------
    table : DataFrame
        The rows of one arm, without those that failed.
    keys : tuple of str
        Of the horizontal and of the vertical axis.
    circles : sequence of MapCircle
        Drawn on top, with axes of equal scale if there are any.
    """
    x, y = (table[key].to_numpy(np.float64) for key in keys)
    reached = read_values(table, by.measure) <= (by.tolerance or 0.0)
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 4.6), layout="constrained")
        axes = figure.subplots()
        share, x_edges, y_edges = bin_share(x, y, reached)
        mesh = axes.pcolormesh(x_edges, y_edges, share, cmap="viridis", vmin=0.0, vmax=1.0, rasterized=True)
        many = len(x) > _MOST_VECTORS
        axes.plot(x[reached], y[reached], ".", color="#000000", markersize=3, rasterized=many)
        axes.plot(x[~reached], y[~reached], "x", color="#d55e00", markersize=4, rasterized=many)
        for circle in circles:
            axes.add_patch(
                Circle((circle.x, circle.y), circle.radius, fill=False, edgecolor="#000000", linewidth=1.4)
            )
        if circles:
            axes.set_aspect("equal")
        axes.set_xlabel(label_quantity(keys[0]))
        axes.set_ylabel(label_quantity(keys[1]))
        figure.colorbar(
            mesh, ax=axes, label=f"share with {label_quantity(by.measure)} at most {by.tolerance:g}"
        )
        return svg(figure, name)


def bin_share(
    x: FloatArray, y: FloatArray, reached: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the share in each field, (rows along y, columns along x), and the edges of both; NaN without points."""
    fields = int(np.clip(np.sqrt(len(x) / _LEAST_IN_BIN), 1, 2 * _BINS))
    found = binned_statistic_2d(x, y, reached.astype(np.float64), statistic="mean", bins=fields)
    return np.asarray(found.statistic, np.float64).T, found.x_edge, found.y_edge


def _shorten(name: str) -> str:
    words = name_settings(name)
    return words if len(words) <= 40 else f"{words[:37]}..."
