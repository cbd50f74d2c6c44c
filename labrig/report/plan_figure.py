"""Draw a plan: path, obstacles and target, true to scale."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from labrig.report.figures import SETTINGS, write_image
from labrig.report.palette import DESIGN, mark
from labrig.steering.planner import Plan, sample_path
from labrig.steering.problem import PlanProblem


def write_plan_figure(path: Path, problem: PlanProblem, plan: Plan) -> None:
    """Draw a plan; without a path only obstacles, start and target.

    Parameters
    ----------
    path : Path
        `.svg` or `.png`.
    problem : PlanProblem
        A planar problem is drawn in the y-z plane, any other also from the side.
    plan : Plan

    Raises
    ------
    DiskError
        If the file cannot be written.
    """
    views = (1,) if problem.planar else (1, 0)
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(8.0, 0.6 + 3.1 * len(views)), layout="constrained")
        panels = figure.subplots(len(views), 1, squeeze=False)[:, 0]
        for axes, across in zip(panels, views, strict=True):
            _draw_view(axes, problem, plan, across)
        panels[0].set_title(_make_title(plan))
    write_image(path, figure, facecolor="white")


def _make_title(plan: Plan) -> str:
    if not plan.found:
        return f"No path: {plan.reason}"
    clearance = "" if plan.clearance_mm is None else f", clearance {plan.clearance_mm:.2f} mm"
    return f"{len(plan.arcs)} arcs, {plan.length_mm:.1f} mm{clearance}"


def _draw_view(axes: Axes, problem: PlanProblem, plan: Plan, across: int) -> None:
    """Draw depth z to the right and one lateral axis upwards: y, or x."""
    ours, theirs = mark(0).colour, mark(1).colour
    for number, obstacle in enumerate(problem.obstacles, start=1):
        place = (obstacle.position_mm[2], obstacle.position_mm[across])
        wider = obstacle.radius_mm + problem.clearance_mm + problem.diameter_mm / 2
        axes.add_patch(Circle(place, wider, fill=False, edgecolor="#999999", linestyle=":", linewidth=0.8))
        axes.add_patch(
            Circle(place, obstacle.radius_mm, facecolor="#dddddd", edgecolor="#777777", linewidth=0.8)
        )
        axes.annotate(str(number), place, ha="center", va="center", fontsize=8.5, color="#333333")
    target = (problem.target_mm[2], problem.target_mm[across])
    axes.add_patch(Circle(target, problem.tolerance_mm, fill=False, edgecolor=theirs, linewidth=1.2))
    axes.plot(*target, "+", color=theirs, markersize=9, label="target and tolerance")
    axes.plot(*np.asarray(problem.start)[[2, across], 3], "s", color=DESIGN, markersize=4, label="start")
    if plan.arcs:
        path = sample_path(problem, plan)[:, [2, across]]
        axes.plot(*path.T, color=ours, linewidth=1.8, label="path")
        flips = path[:: len(path) // len(plan.arcs)][1:-1]
        axes.plot(*flips.T, "o", color=ours, markerfacecolor="white", label="the bevel turns")
    axes.plot([], [], ":", color="#999999", label="centre line stays outside")
    axes.set_aspect("equal", adjustable="datalim")
    sideways = f"{'xy'[across]}, {'sideways' if across else 'away from the camera'} (mm)"
    axes.set(xlabel="z, along the insertion (mm)", ylabel=sideways)
    axes.grid(visible=True)
    axes.legend(loc="best")
