"""Figures of a campaign: its arms, and the measure over the keys that were drawn."""

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from labrig.campaign.result import CampaignResult
from labrig.campaign.statistics import (
    BROKEN_OFF,
    WITHOUT_VALUE,
    ArmResult,
    find_failing,
    find_false_successes,
    read_values,
)
from labrig.protocol.model import Interval
from labrig.protocol.sections import Criterion
from labrig.report.figures import MOST_VECTORS, SETTINGS, DrawnFigure, choose_limits, draw_interval, svg
from labrig.report.formatting import label_key, name_settings
from labrig.report.palette import Mark, mark
from labrig.text import split_quantity, tell_value

MOST_ARMS = 40
"""More of them are a carpet; the table has them."""
_BINS, _LEAST_IN_BIN = 12, 5
_SHARES = LinearSegmentedColormap.from_list("shares", ("#ffffff", "#56b4e9"))
_SIGNS = {"missed": "x", BROKEN_OFF: "^", WITHOUT_VALUE: "s"}
_SIGN: dict[str, Any] = {"color": "#b02a00", "mfc": "white", "ms": 6, "mew": 1.4, "clip_on": False, "ls": ""}
_SMALL = {**_SIGN, "mfc": "none", "ms": 4.5, "mew": 1.1, "alpha": 0.6}
_APART = 0.22
"""Of rows: the values stand below the mean, and the number within the tolerance above its share."""


def draw_arms(result: CampaignResult, table: pd.DataFrame) -> DrawnFigure | None:
    """Draw the values of each arm, their mean with its interval, the share within the tolerance, and the differences.

    None for too many arms.
    """
    if len(result.arms) > MOST_ARMS:
        return None
    panels = 1 + (result.tolerance is not None) + bool(result.pairs)
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 1.1 + 0.62 * len(result.arms)))
        figure.set_layout_engine("constrained", w_pad=0.12)
        axes = figure.subplots(1, panels, sharey=True, squeeze=False)[0]
        known = read_values(table, result.measure)
        drawn = [*known[~np.isnan(known)].tolist(), *([] if result.tolerance is None else [result.tolerance])]
        axes[0].set_xlim(choose_limits(drawn, [arm.ci95 for arm in result.arms]))
        if result.tolerance is not None:
            axes[0].axvline(result.tolerance, color="#555555", linewidth=1.0, linestyle=(0, (4, 2.5)))
            axes[1].set_xlim(-3, 103)  # room for the caps at 0 and 100
            axes[1].set_xlabel(f"share within {tell_value(result.tolerance, result.measure)} (%)")
        for place, arm in enumerate(result.arms):
            values = read_values(table[table["arm"] == arm.name], result.measure)
            _draw_arm(axes, place, arm, values.tolist())
        names = [_shorten(arm.name) for arm in result.arms] if len(result.arms) > 1 else [""]
        axes[0].set_yticks(range(len(names)), names)
        axes[0].set(ylim=(len(result.arms) - 0.5, -0.5), xlabel=label_key(result.measure))
        if result.pairs:
            _draw_pairs(axes[-1], result)
        for panel in axes:
            panel.grid(visible=True, axis="x")
        return svg(figure, "arms")


def _draw_pairs(axes: Axes, result: CampaignResult) -> None:
    """Draw the mean of the paired differences of each further arm from the first."""
    known = [(place, pair, pair.mean) for place, pair in enumerate(result.pairs, 1) if pair.mean is not None]
    bounds = [pair.ci95 for pair in result.pairs if pair.ci95 is not None]
    # One mean is close to 0 however wide its interval is: the narrowest one belongs to the values.
    narrow = min(bounds, key=lambda ends: ends[1] - ends[0], default=())
    axes.set_xlim(choose_limits([0.0, *(mean for *_, mean in known), *narrow], bounds))
    axes.axvline(0.0, color="#555555", linewidth=1.0)
    for place, pair, mean in known:
        _draw_interval(axes, place, mark(place), mean, pair.ci95)
    unit = split_quantity(result.measure)[1]
    axes.set_xlabel(f"difference from\n{_shorten(result.arms[0].name)}{f' ({unit})' if unit else ''}")


def _draw_arm(axes: Sequence[Axes], place: int, arm: ArmResult, values: Sequence[float]) -> None:
    look, below, many = mark(place), [place + _APART] * len(values), len(values) > MOST_VECTORS
    axes[0].plot(values, below, ".", color=look.colour, markersize=5, alpha=0.5, rasterized=many)
    if arm.mean is not None:
        _draw_interval(axes[0], place, look, arm.mean, arm.ci95)
    if len(axes) > 1 and arm.share is not None:
        share_ci95 = arm.share_ci95 and (100 * arm.share_ci95[0], 100 * arm.share_ci95[1])
        _draw_interval(axes[1], place, look, 100 * arm.share, share_ci95)
        words = f"{arm.within_tolerance} of {arm.tasks - arm.failed}"
        axes[1].text(
            100 * arm.share, place - _APART / 2, words, size=8, ha=("left", "right")[arm.share > 0.5]
        )


def _draw_interval(axes: Axes, place: int, look: Mark, value: float, limits: Interval | None) -> None:
    if limits is not None:
        draw_interval(axes, limits, place, look.colour)
    axes.plot(value, place, look.marker, color=look.colour, markersize=5, clip_on=False, in_layout=False)


def draw_over_points(
    result: CampaignResult, table: pd.DataFrame, keys: Sequence[str], granted: Mapping[str, Any], name: str
) -> DrawnFigure | None:
    """Draw the measure over sampled keys, point by point, with median and quartiles of each part of the range.

    Tasks that failed outright are on the upper edge; those that were wrongly called a success are ringed. `granted`
    has where a protocol says what an insertion takes a key for, and that value, an upright line unless it is drawn too.
    """
    sound = table[table["error"].isna()]
    known = sound[~np.isnan(read_values(sound, result.measure))]
    if known.empty or not keys:
        return None
    with mpl.rc_context(SETTINGS):
        rows, columns = (len(keys) + 2) // 3, min(3, len(keys))
        figure = Figure(figsize=(9.6, 0.4 + 2.8 * rows), layout="constrained")
        panels = [figure.add_subplot(rows, columns, place) for place in range(1, len(keys) + 1)]
        false = find_false_successes(sound, Criterion(result.measure, result.tolerance))
        for panel, key in zip(panels, keys, strict=True):
            _draw_points(panel, known, key, result)
            if key in granted and granted[key][0] not in table and granted[key][1] is not None:
                panel.axvline(granted[key][1], color="#009e73", linewidth=1.6)
            for end, failing in find_failing(sound, result.measure).items():
                # A line without a point has no box: the layout collapses.
                signs = {"transform": panel.get_xaxis_transform(), "in_layout": failing.any(), **_SMALL}
                row = np.full(int(failing.sum()), 1.05 if end == BROKEN_OFF else 1.0)
                panel.plot(sound.loc[failing, key], row, _SIGNS[end], **signs)
            ring = {**_SIGN, "mfc": "none", "in_layout": false.any()}
            panel.plot(sound.loc[false, key], sound.loc[false, result.measure], "o", **ring)
        return svg(figure, name)


def _draw_points(axes: Axes, table: pd.DataFrame, key: str, result: CampaignResult) -> None:
    many, bins = len(table) > MOST_VECTORS, min(_BINS, max(1, len(table) // (2 * _LEAST_IN_BIN)))
    values = table[result.measure].astype(np.float64)
    axes.plot(table[key], values, ".", color=mark(0).colour, markersize=4, alpha=0.5, rasterized=many)
    for part, inside in values.groupby(pd.cut(table[key], bins), observed=True):
        low, middle, high = inside.quantile([0.25, 0.5, 0.75])
        axes.plot([part.mid] * 2, [low, high], "-", color="#000000", linewidth=1.5)
        axes.plot(part.mid, middle, "o", color="#000000", markersize=4)
    if result.tolerance is not None:
        axes.axhline(result.tolerance, color="#555555", linewidth=1.0, linestyle=(0, (4, 2.5)))
    axes.set(xlabel=fill(label_key(key), 32), ylabel=fill(label_key(result.measure), 32))
    axes.grid(visible=True)


def draw_map(
    result: CampaignResult,
    table: pd.DataFrame,
    ranges: Mapping[str, Interval],
    circles: Sequence[tuple[float, float, float]],
    name: str,
) -> DrawnFigure:
    """Draw where two sampled keys led within the tolerance: its share in each area, and every point by how it ended.

    Parameters
    ----------
    table : DataFrame
        The rows of one arm, without those that failed.
    ranges : mapping
        The keys of the horizontal and of the vertical axis, and the range of each.
    circles : sequence of tuple
        Centre and radius of each obstacle, in the units of the axes; drawn on top, in equal scales.
    """
    x, y = (table[key].to_numpy(np.float64) for key in ranges)
    values = read_values(table, result.measure)
    reached = values <= (result.tolerance or 0.0)
    fields = int(np.clip(np.sqrt(len(x) / _LEAST_IN_BIN), 1, 2 * _BINS))
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 5.0), layout="constrained")
        axes = figure.subplots()
        counts, x_edges, y_edges = np.histogram2d(x, y, fields, [*ranges.values()])
        hits, _, _ = np.histogram2d(x, y, (x_edges, y_edges), weights=reached.astype(np.float64))
        share = np.ma.masked_where(counts == 0, hits / np.maximum(counts, 1.0)).T
        axes.patch.set(facecolor="#f6f6f6", hatch="////", edgecolor="#d4d4d4")
        mesh = axes.pcolormesh(x_edges, y_edges, share, cmap=_SHARES, vmin=0, vmax=1, rasterized=True)
        many = len(x) > MOST_VECTORS
        axes.plot(x[reached], y[reached], ".", color="#00507d", markersize=4, rasterized=many, clip_on=False)
        for across, up, radius in circles:
            axes.add_patch(Circle((across, up), radius, facecolor="#c8c8c8", edgecolor="#888888"))
        missed = values > (result.tolerance or 0.0)
        for end, rows in {"missed": missed, **find_failing(table, result.measure)}.items():
            axes.plot(x[rows], y[rows], _SIGNS[end], **_SIGN, zorder=3)
        if circles:
            axes.set_aspect("equal")
            axes.plot(0, 0, ">k", markersize=9)  # where the needle goes in
        along, upwards = map(label_key, ranges)
        axes.set(xlabel=along, ylabel=upwards)
        sizes = " to ".join(map("{:.0f}".format, sorted({counts[counts > 0].min(), counts.max()})))
        label = f"share within {tell_value(result.tolerance, result.measure)}, of {sizes} tasks each"
        figure.colorbar(mesh, ax=axes, label=label, format="{x:.0%}", location="bottom", aspect=40)
        return svg(figure, name)


def _shorten(name: str) -> str:
    words = name_settings(name) if "=" in name else f"“{name}”"
    return words if len(words) <= 40 else f"{words[:37]}..."
