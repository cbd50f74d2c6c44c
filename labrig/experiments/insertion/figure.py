"""Figures of an insertion over its length: error of the tip, clearance, NIS and heading, and what its markers moved."""

import math
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import chdtri

from labrig.experiments.insertion.events import PathSought
from labrig.experiments.insertion.result import InsertionTrial
from labrig.report.figures import SETTINGS, svg
from labrig.report.palette import DESIGN, mark

_SEEN, _TRUE = mark(0).colour, "#000000"
# The 95 % quantile of the NIS of two coordinates.
_NIS_95 = float(chdtri(2, 0.05))


def draw_insertion_figure(trial: InsertionTrial, plans: Sequence[PathSought], name: str) -> Markup:
    """Draw the curves of an insertion over the inserted length, with the places where the path was replanned."""
    draws = [_draw_error, _draw_clearance, _draw_nis, _draw_heading]
    if trial.marker_steps:
        draws.append(_draw_markers)
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 1.8 * len(draws)), layout="constrained")
        curves = figure.subplots(len(draws), 1, sharex=True)
        for axes, draw in zip(curves, draws, strict=True):
            draw(axes, trial)
            axes.grid(visible=True)
            for plan in plans:
                axes.axvline(plan.depth_mm, color="#c9cdd2", linewidth=0.8, zorder=0)
            if axes.get_legend_handles_labels()[0]:
                axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), borderaxespad=0.0)
        curves[-1].set_xlabel("inserted (mm); grey lines: a path was sought")
        return svg(figure, name)


def _draw_error(axes: Axes, trial: InsertionTrial) -> None:
    axes.set_title("Tip: error of the estimate" if trial.true_path_mm else "Tip: innovation")
    seen = [(step.depth_mm, math.hypot(*step.innovation_mm)) for step in trial.steps if step.innovation_mm]
    axes.plot(*_split_columns(seen), ".", color=_SEEN, markersize=4, label="innovation")
    true = [
        (step.depth_mm, math.dist(step.estimate_mm, step.true_mm)) for step in trial.steps if step.true_mm
    ]
    if true:
        axes.plot(*_split_columns(true), color=_TRUE, linewidth=1.3, label="estimate from truth")
    missed = [(step.depth_mm, 0.0) for step in trial.steps if not step.believed]
    if missed:
        axes.plot(*_split_columns(missed), "x", color=mark(1).colour, markersize=5, label="tip not seen")
    axes.set_ylabel("mm")
    axes.set_ylim(bottom=0.0)


def _draw_clearance(axes: Axes, trial: InsertionTrial) -> None:
    axes.set_title("Clearance: needle's surface to the nearest obstacle's")
    known = [(step.depth_mm, step.clearance_mm) for step in trial.steps if step.clearance_mm is not None]
    axes.plot(*_split_columns(known), color=mark(2).colour, linewidth=1.3, label="at the tip")
    axes.axhline(0.0, color=mark(1).colour, linewidth=1.0, label="touching")
    axes.set_ylabel("mm")


def _draw_nis(axes: Axes, trial: InsertionTrial) -> None:
    axes.set_title("NIS: normalised innovation squared")
    known = [(step.depth_mm, max(step.nis, 1e-4)) for step in trial.steps if step.nis is not None]
    axes.plot(*_split_columns(known), ".", color=_SEEN, markersize=4)
    axes.axhline(_NIS_95, color=DESIGN, linewidth=1.0, linestyle=(0, (4, 2.5)), label="95 % lie below")
    if trial.mean_nis is not None:
        axes.axhline(
            trial.mean_nis, color=_SEEN, linewidth=1.0, label=f"mean {trial.mean_nis:.2g}; 2 expected"
        )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")


def _draw_heading(axes: Axes, trial: InsertionTrial) -> None:
    axes.set_title("Heading, from the insertion towards +y")
    depth = np.array([step.depth_mm for step in trial.steps])
    heading = np.degrees([step.heading_rad for step in trial.steps])
    spread = 2.0 * np.degrees([step.heading_sd_rad for step in trial.steps])
    axes.fill_between(depth, heading - spread, heading + spread, color=_SEEN, alpha=0.2, linewidth=0)
    axes.plot(depth, heading, color=_SEEN, linewidth=1.3, label="estimate, ± 2 SD")
    true = [
        (step.depth_mm, math.degrees(step.true_heading_rad))
        for step in trial.steps
        if step.true_heading_rad is not None
    ]
    if true:
        axes.plot(*_split_columns(true), color=_TRUE, linewidth=1.0, linestyle=(0, (4, 2.5)), label="truth")
    axes.set_ylabel("degrees")


def _draw_markers(axes: Axes, trial: InsertionTrial) -> None:
    axes.set_title("Markers: displacement since the start")
    for place, (_, marker) in enumerate(trial.markers):
        steps = [step for step in trial.marker_steps if step.marker_id == marker.marker_id]
        for name, along, line in (("y", 0, "-"), ("z", 1, (0, (4, 2.5)))):
            moved = [(step.depth_mm, step.displacement_mm[along]) for step in steps]
            label = f"{marker.marker_id}, along {name}"
            axes.plot(
                *_split_columns(moved), color=mark(place).colour, linewidth=1.3, linestyle=line, label=label
            )
        missed = [(step.depth_mm, 0.0) for step in steps if not step.believed]
        if missed:
            label = f"{marker.marker_id} not seen"
            axes.plot(*_split_columns(missed), "x", color=mark(place).colour, markersize=5, label=label)
    axes.set_ylabel("mm")


def _split_columns(rows: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [row[0] for row in rows], [row[1] for row in rows]
