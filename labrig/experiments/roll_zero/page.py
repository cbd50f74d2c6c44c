"""What the page of a roll zero run shows: each insertion's deflection, and the cosine of the roll through them."""

import math
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from labrig.analysis.pictures import load_plane_map
from labrig.analysis.result import AnalysisResult
from labrig.experiments.roll_zero.protocol import RollZeroProtocol
from labrig.experiments.roll_zero.result import RollZeroResult
from labrig.experiments.shared.roll_zero_events import RollZeroRole
from labrig.record.reader import Run
from labrig.report.figures import SETTINGS, svg
from labrig.report.page import Page
from labrig.report.palette import DESIGN, mark
from labrig.report.pictures import THUMBNAIL, photograph

TEMPLATE = Path(__file__).with_name("page.html.jinja")

_CURVE_POINTS = 181


def make_page(run: Run, _protocol: RollZeroProtocol, result: AnalysisResult[RollZeroResult]) -> Page:
    """Return the page of a roll zero: the deflections, the cosine through them, and the pictures."""
    return Page(TEMPLATE, load_plane_map(run), _collect_content(run, result.content))


def _collect_content(run: Run, result: RollZeroResult) -> dict[str, Any]:
    shots = [
        (line.frame, math.degrees(line.rotation_rad or 0.0), photograph(run, line.frame, THUMBNAIL))
        for line in run.frame_lines
        if line.role == RollZeroRole.NEEDLE
    ]
    return {
        "rows": [
            (math.degrees(roll), seen, None if fitted is None else seen - fitted)
            for roll, seen in zip(result.rolls_rad, result.deflections_mm, strict=True)
            for fitted in (_evaluate_fit_mm(result, roll),)
        ],
        "figure": _draw_figure(result, "roll-zero") if result.rolls_rad else None,
        "shots": shots,
        "degrees": math.degrees,
    }


def _evaluate_fit_mm(result: RollZeroResult, roll_rad: float) -> float | None:
    """Return the fitted cosine at a roll; None without a fit."""
    if result.fit is None or result.offset_mm is None:
        return None
    return result.offset_mm - result.fit["bend_mm"] * math.cos(roll_rad - result.fit["zero_rad"])


def _draw_figure(result: RollZeroResult, name: str) -> Markup:
    """Draw the deflections over the roll, the cosine, and the zero with twice its standard deviation."""
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 3.9), layout="constrained")
        axes = figure.subplots()
        turn_rad = np.linspace(0.0, 2 * math.pi, _CURVE_POINTS)
        curve = [mm for roll in turn_rad.tolist() if (mm := _evaluate_fit_mm(result, roll)) is not None]
        if result.fit is not None and curve:
            axes.plot(np.degrees(turn_rad), curve, color=DESIGN, linewidth=1.2, label="fitted cosine")
            zero, sd = (math.degrees(result.fit[key]) for key in ("zero_rad", "sd_rad"))
            axes.axvspan(zero % 360 - 2 * sd, zero % 360 + 2 * sd, color="#009e73", alpha=0.3, linewidth=0)
            axes.axvline(zero % 360, color="#009e73", linewidth=1.2, label="roll zero, ± 2 SD")
        rolls_deg = np.degrees(result.rolls_rad)
        axes.plot(rolls_deg, result.deflections_mm, "o", color=mark(0).colour, label="tip, as seen")
        axes.set_xticks(range(0, 361, 60))
        axes.set(xlim=(-15, 375), xlabel="rotation axis (degrees)", ylabel="tip aside, y (mm)")
        axes.grid(visible=True)
        axes.legend(loc="best")
        return svg(figure, name)
