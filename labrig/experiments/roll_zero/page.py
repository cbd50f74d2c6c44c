"""What the page of a roll zero run shows: each insertion's deflection, and the cosine of the roll through them."""

import math
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import AnalysisResult, TrialOrigin
from labrig.experiments.roll_zero.analysis import find_last_origin
from labrig.experiments.roll_zero.protocol import RollZeroProtocol
from labrig.experiments.roll_zero.result import RollZeroResult, describe_torsion
from labrig.experiments.shared.roll_zero_events import RollZeroRole
from labrig.experiments.shared.torsion_bends import BENT_MM
from labrig.record.reader import Run
from labrig.report.figures import SETTINGS, DrawnFigure, svg
from labrig.report.page import Page
from labrig.report.palette import DESIGN, mark
from labrig.report.pictures import THUMBNAIL, Plate, photograph, polyline, scale_bar
from labrig.vision.plane import PlaneMap

TEMPLATE = Path(__file__).with_name("page.html.jinja")

_CURVE_POINTS = 181
# A turn is drawn from here [degrees], so that the zero of an axis that was clamped near it stands among the points.
_FIRST_DEG = -60.0


def make_page(run: Run, protocol: RollZeroProtocol, result: AnalysisResult[RollZeroResult]) -> Page:
    """Return the page of a roll zero: the deflections, the cosine through them, and the pictures."""
    content, plane, radius_mm = result.content, load_plane_map(run), protocol.needle.design_radius_mm
    residuals_mm = [
        seen - _evaluate_fit_mm(content, roll)
        for roll, seen in zip(content.rolls_rad, content.deflections_mm, strict=True)
        if content.fit
    ]
    shown = {
        "residuals_mm": residuals_mm,
        "figure": _draw_figure(content, residuals_mm, "roll-zero") if content.rolls_rad else None,
        "shots": _list_shots(run, content, plane, protocol.roll_zero.length_mm),
        "degrees": math.degrees,
        "bent_mm": BENT_MM,
        "describe_torsion": describe_torsion,
        # How far a degree of roll takes the tip of an arc out of the plane.
        "out_of_plane_mm": lambda mm: radius_mm * (1.0 - math.cos(mm / radius_mm)) * math.radians(1.0),
    }
    return Page(TEMPLATE, plane, shown)


def _list_shots(
    run: Run, result: RollZeroResult, plane: PlaneMap, length_mm: float
) -> list[tuple[str, float, float | None, Plate | None]]:
    """Return file, roll [degrees], deflection [mm] and picture of each insertion; None where it was not seen."""
    seen_mm = dict(zip(result.rolls_rad, result.deflections_mm, strict=True))
    shots = []
    for line in run.frame_lines:
        if line.role == RollZeroRole.NEEDLE:
            picture, roll_rad = photograph(run, line.frame, THUMBNAIL), line.rotation_rad or 0.0
            if picture is not None:
                axis = _draw_axis(find_last_origin(line.frame, result.origins), plane, length_mm)
                bar = scale_bar((picture.width, picture.height), plane)
                picture = replace(picture, lines=(("tip", axis),), bar=bar)
            shots.append((line.file, math.degrees(roll_rad), seen_mm.get(roll_rad), picture))
    return shots


def _draw_axis(origin: TrialOrigin | None, plane: PlaneMap, length_mm: float) -> str:
    """Return the line straight ahead of the sheath, or of the plane's origin, from which deflections are measured."""
    start_mm, heading_rad = (0.0, 0.0), 0.0
    if origin is not None and origin.tip_mm is not None and origin.heading_rad is not None:
        start_mm, heading_rad = origin.tip_mm, origin.heading_rad
    ahead_mm = length_mm * np.array((math.sin(heading_rad), math.cos(heading_rad)))
    return polyline(plane.to_px(np.array(start_mm) + np.array(((0.0,), (1.0,))) * ahead_mm))


def _evaluate_fit_mm(result: RollZeroResult, roll_rad: float) -> float:
    """Return the fitted cosine at a roll; there is a fit."""
    assert result.fit is not None
    assert result.offset_mm is not None
    return result.offset_mm - result.fit["bend_mm"] * math.cos(roll_rad - result.fit["zero_rad"])


def _draw_figure(result: RollZeroResult, residuals_mm: list[float], name: str) -> DrawnFigure:
    """Draw the deflections over the roll with cosine and zero, and below what the cosine leaves."""
    # The points of the turns before and behind too, as far as they are within the axis.
    rolls_deg = np.degrees(result.rolls_rad) + np.array([[-360.0], [0.0], [360.0]])
    seen_mm, left_mm = (np.tile(values, (3, 1)) for values in (result.deflections_mm, residuals_mm))
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 5.2), layout="constrained")
        axes, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        if result.fit is not None:
            zero, sd = (math.degrees(result.fit[key]) for key in ("zero_rad", "sd_rad"))
            zero = (zero - _FIRST_DEG) % 360.0 + _FIRST_DEG
            turn_deg = np.linspace(_FIRST_DEG - 15.0, _FIRST_DEG + 375.0, _CURVE_POINTS)
            curve = [_evaluate_fit_mm(result, roll) for roll in np.radians(turn_deg).tolist()]
            axes.plot(turn_deg, curve, color=DESIGN, linewidth=1.2, label="fitted cosine")
            axes.axvspan(zero - 2 * sd, zero + 2 * sd, color="#009e73", alpha=0.3, linewidth=0)
            axes.axvline(zero, color="#009e73", linewidth=1.2, label="roll zero, ± 2 SD")
            below.vlines(rolls_deg.ravel(), 0.0, left_mm.ravel(), color=DESIGN, linewidth=0.8)
            below.plot(rolls_deg[::2], left_mm[::2], "o", color=mark(0).colour, ms=4, fillstyle="none")
            below.plot(rolls_deg[1], left_mm[1], "o", color=mark(0).colour, markersize=4)
        axes.plot(rolls_deg[::2], seen_mm[::2], "o", color=mark(0).colour, fillstyle="none")
        axes.plot(rolls_deg[1], seen_mm[1], "o", color=mark(0).colour, label="tip, without the shift")
        axes.set(ylabel="tip deflection, y (mm)")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        below.axhline(0.0, color=DESIGN, linewidth=0.8)
        below.set(xlabel="rotation axis (degrees)", ylabel="residual (mm)", ymargin=0.3)
        below.set_xticks(range(-60, 301, 60))
        below.set_xlim(_FIRST_DEG - 15.0, _FIRST_DEG + 375.0)
        for panel in (axes, below):
            panel.grid(visible=True)
        return svg(figure, name)
