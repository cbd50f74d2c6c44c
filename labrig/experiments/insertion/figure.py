"""Figures of an insertion over its length: error of the tip, clearance, NIS and heading, and what its markers moved."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from labrig.analysis.result import tabulate
from labrig.experiments.insertion.events import NIS_95, PathSought
from labrig.experiments.insertion.result import InsertionStep, InsertionTrial, MarkerStep
from labrig.report.figures import SETTINGS, svg
from labrig.report.palette import DESIGN, mark

_SEEN, _LOST, _TRUE = mark(0).colour, mark(1).colour, "#000000"
_DASHED = (0, (4, 2.5))


def draw_insertion_figure(
    trial: InsertionTrial, plans: Sequence[PathSought], map_truth: Callable[..., Any], *, predicts: bool
) -> Markup:
    """Draw the curves of an insertion over the inserted length, with the places where the path was replanned.

    `map_truth` takes true places (N, 2) [mm] to where the plane map has them.
    """
    steps = tabulate(InsertionStep, trial.steps).set_index("depth_mm")
    places = ["true_y_mm", "true_z_mm"]
    steps[places] = map_truth(steps[places].astype(float))
    if not predicts:
        steps[["innovation_y_mm", "nis"]] = np.nan
    draws: list[tuple[list[str], Callable[[Axes, pd.DataFrame], None]]] = [
        (["innovation_y_mm", "true_y_mm"], _draw_error),
        (["clearance_mm"], _draw_clearance),
        (["nis"], partial(_draw_nis, mean_nis=trial.mean_nis)),
        (["heading_rad"], _draw_heading),
    ]
    known = [draw for columns, draw in draws if steps[columns].notna().any(axis=None)]
    rows = len(known) + bool(trial.marker_steps)
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 2.1 * rows), layout="constrained")
        curves = figure.subplots(rows, 1, sharex=True)
        for axes, draw in zip(curves, known, strict=False):
            draw(axes, steps)
        if trial.marker_steps:
            _draw_markers(curves[-1], tabulate(MarkerStep, trial.marker_steps).set_index("depth_mm"))
        for axes in curves:
            axes.grid(visible=True, axis="y")
            for plan in plans:
                axes.axvline(plan.depth_mm, color="#9aa1a9", linewidth=0.8, zorder=0)
            if axes.get_legend_handles_labels()[0]:
                axes.legend(
                    loc="upper right",
                    bbox_to_anchor=(1.0, -0.02 if axes is not curves[-1] else -0.3),
                    ncols=3,
                )
        curves[-1].set_xlabel("inserted (mm); grey lines: a path was sought")
        return svg(figure, f"trial{trial.trial}")


def _plot(axes: Axes, values: Any, colour: str, style: Any = "-", **look: Any) -> None:
    """Draw what is known of a column over the inserted length; nothing if nothing is."""
    known = pd.to_numeric(values).dropna()
    drawn = {"linestyle": "none", "marker": style} if style in {".", "x"} else {"linestyle": style}
    if len(known):
        axes.plot(known.index, known, color=colour, **drawn, **{"linewidth": 1.3, "markersize": 4, **look})


def _plot_lost(axes: Axes, steps: pd.DataFrame, colour: str, label: str) -> None:
    believed = steps["believed"].astype(float)
    _plot(axes, believed[believed == 0.0], colour, "x", label=label)


def _find_length(steps: pd.DataFrame, name: str, less: str | None = None) -> Any:
    """Return the length of a vector of (y, z), less another, step by step [mm]."""
    y_mm, z_mm = (
        steps[f"{name}_{axis}_mm"] - (0.0 if less is None else steps[f"{less}_{axis}_mm"]) for axis in "yz"
    )
    return np.hypot(y_mm, z_mm)


def _draw_error(axes: Axes, steps: pd.DataFrame) -> None:
    true = _find_length(steps, "estimate", "true")
    axes.set_title("Tip: how far the estimate is off" if true.notna().any() else "Tip: innovation")
    _plot(axes, _find_length(steps, "innovation"), _SEEN, ".", label="innovation")
    _plot(axes, true, _TRUE, label="estimate from truth")
    _plot_lost(axes, steps, _LOST, "tip not used")
    axes.set_ylabel("mm")
    axes.set_ylim(bottom=0.0)


def _draw_clearance(axes: Axes, steps: pd.DataFrame) -> None:
    axes.set_title("Clearance from the nearest obstacle")
    _plot(axes, steps["clearance_mm"], mark(2).colour, label="at the tip")
    axes.axhline(0.0, color=_LOST, linewidth=1.0, label="touching")
    axes.set_ylabel("mm")


def _draw_nis(axes: Axes, steps: pd.DataFrame, mean_nis: float | None) -> None:
    axes.set_title("NIS; its mean is of the sightings used")
    _plot(axes, pd.to_numeric(steps["nis"]).clip(lower=1e-4), _SEEN, ".")
    usual = f"95 % should lie below {NIS_95:.1f}"
    axes.axhline(NIS_95, color=DESIGN, linewidth=1.0, linestyle=_DASHED, label=usual)
    if mean_nis is not None:
        axes.axhline(mean_nis, color=_SEEN, linewidth=1.0, label=f"mean {mean_nis:.2f}; 2 expected")
    axes.set_yscale("log")
    axes.set_ylim(top=max(4 * NIS_95, 1.5 * pd.to_numeric(steps["nis"]).max()))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_heading(axes: Axes, steps: pd.DataFrame) -> None:
    axes.set_title("Heading, from the insertion towards +y")
    heading, sd, true = (
        np.degrees(pd.to_numeric(steps[name]))
        for name in ("heading_rad", "heading_sd_rad", "true_heading_rad")
    )
    axes.fill_between(steps.index, heading - 2 * sd, heading + 2 * sd, color=_SEEN, alpha=0.2, linewidth=0)
    _plot(axes, heading, _SEEN, label="estimate, ± 2 SD")
    _plot(axes, true, _TRUE, _DASHED, linewidth=1.0, label="truth")
    axes.set_ylabel("degrees")


def _draw_markers(axes: Axes, steps: pd.DataFrame) -> None:
    axes.set_title("Markers: displacement since the start")
    for place, (marker_id, own) in enumerate(steps.groupby("marker_id")):
        colour = mark(place).colour
        for name, style in (("y", "-"), ("z", _DASHED)):
            _plot(axes, own[f"displacement_{name}_mm"], colour, style, label=f"{marker_id}, along {name}")
        _plot_lost(axes, own, colour, f"{marker_id} not seen")
    axes.set_ylabel("mm")
