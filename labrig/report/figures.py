"""Line figures by matplotlib, as SVG within the page.

Only matplotlib's object interface is used: no figure outlives its function, and no setting outlives a figure. The same
data give the same bytes.
"""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labrig.report.palette import DESIGN, Mark

FloatArray = NDArray[np.float64]

SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "labrig",
    "svg.fonttype": "none",
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "text.parse_math": False,
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.labelsize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#555555",
    "axes.axisbelow": True,
    "xtick.color": "#333333",
    "ytick.color": "#333333",
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}
_MEAN_MARK: dict[str, Any] = {"markersize": 6, "capsize": 3.5, "linewidth": 1.5}
_SD_BAR: dict[str, Any] = {"linewidth": 6.0, "alpha": 0.22, "solid_capstyle": "butt"}
_PAPER_MARK: dict[str, Any] = {
    "fmt": "D",
    "color": "#666666",
    "markerfacecolor": "white",
    "markersize": 5,
    "linewidth": 0.9,
}
NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


_FEW = 4
"""Insertions; the interval of the mean of fewer is many times as wide as they scatter."""


@dataclass(frozen=True)
class GelSeries:
    """One needle in one gel in figure 8; paths are (N, 2), columns (y, z), from the sheath's tip."""

    label: str
    mark: Mark
    paths_mm: tuple[FloatArray, ...]
    radii_mm: tuple[float, ...]
    mean_mm: float | None
    sd_mm: float | None
    ci95_mm: tuple[float, float] | None
    paper_mm: tuple[float, float] | None
    drawn_mean_mm: float | None


@dataclass(frozen=True)
class Design:
    """The arc that the needle was designed for, and the side to which it bends (+1: +y)."""

    radius_mm: float
    length_mm: float
    side: int


def draw_steerability_figure(series: Sequence[GelSeries], design: Design, name: str) -> Markup:
    """Draw figure 8 of the paper: all paths from one sheath tip, and the radii of each gel."""
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 4.3), layout="constrained")
        paths, radii = figure.subplots(1, 2, width_ratios=(1.12, 1))
        _draw_paths(paths, series, design)
        _draw_radii(radii, series, design)
        return svg(figure, name)


def _draw_paths(axes: Axes, series: Sequence[GelSeries], design: Design) -> None:
    axes.set_title("Paths, from the tip of the sheath")
    for gel in series:
        for path in gel.paths_mm:
            axes.plot(path[:, 1], path[:, 0], color=gel.mark.colour, linewidth=0.7, alpha=0.55)
        axes.plot([], [], color=gel.mark.colour, linewidth=2, label=gel.label)
    angle = np.linspace(0.0, design.length_mm / design.radius_mm, 80)
    axes.plot(
        design.radius_mm * np.sin(angle),
        design.side * design.radius_mm * (1.0 - np.cos(angle)),
        color=DESIGN,
        linewidth=1.4,
        linestyle=(0, (4, 2.5)),
        label=f"design, {design.radius_mm:g} mm",
    )
    axes.set_aspect("equal", anchor="N")
    axes.set_xlabel("z, along the insertion (mm)")
    axes.set_ylabel("y, sideways (mm)")
    axes.grid(visible=True)
    axes.legend(loc="lower left" if design.side < 0 else "upper left", handlelength=1.6)


def _draw_radii(axes: Axes, series: Sequence[GelSeries], design: Design) -> None:
    axes.set_title("Radius of each insertion, and means")
    axes.axhline(design.radius_mm, color=DESIGN, linewidth=1.2, linestyle=(0, (4, 2.5)))
    for place, gel in enumerate(series):
        _draw_gel(axes, place, gel)
    axes.set_xticks(range(len(series)), [gel.label for gel in series])
    axes.set_xlim(-0.6, len(series) - 0.4)
    axes.set_ylim(*_find_range(series, design))
    axes.set_xlabel("gelatin, powder to water by mass")
    axes.set_ylabel("radius of curvature (mm)")
    axes.grid(visible=True, axis="y")
    axes.annotate(
        f"design, {design.radius_mm:g} mm",
        (0.995, design.radius_mm),
        xycoords=("axes fraction", "data"),
        xytext=(0, -3),
        textcoords="offset points",
        ha="right",
        va="top",
        fontsize=8.5,
        color=DESIGN,
    )
    _explain_marks(axes, series)


def _find_range(series: Sequence[GelSeries], design: Design) -> tuple[float, float]:
    """Return the range of radii that is drawn [mm].

    It holds every radius, mean and standard deviation. An interval of two or three insertions may leave it: drawn
    whole, it would squeeze all else to a point.
    """
    shown = [design.radius_mm]
    for gel in series:
        shown += gel.radii_mm
        for mean_mm, sd_mm in (
            (gel.mean_mm, gel.sd_mm),
            gel.paper_mm or (None, None),
            (gel.drawn_mean_mm, None),
        ):
            if mean_mm is not None:
                shown += [mean_mm - (sd_mm or 0.0), mean_mm + (sd_mm or 0.0)]
        if gel.ci95_mm is not None and len(gel.radii_mm) >= _FEW:
            shown += gel.ci95_mm
    margin = 0.25 * (max(shown) - min(shown)) + 0.1
    return min(shown) - 1.6 * margin, max(shown) + margin


def _draw_gel(axes: Axes, place: int, gel: GelSeries) -> None:
    """Draw one gel's column: radii, our mean, the drawn mean and the paper's, from left to right."""
    colour = gel.mark.colour
    # Spread sideways in a fixed pattern, so that equal radii do not cover each other.
    sideways = place - 0.22 + 0.045 * (np.arange(len(gel.radii_mm)) % 5 - 2)
    axes.plot(
        sideways, gel.radii_mm, gel.mark.marker, color=colour, markersize=4.2, alpha=0.6, markeredgewidth=0
    )
    if gel.mean_mm is not None:
        if gel.sd_mm is not None:
            ends = [gel.mean_mm - gel.sd_mm, gel.mean_mm + gel.sd_mm]
            axes.plot([place + 0.03] * 2, ends, color=colour, **_SD_BAR)
        low, high = gel.ci95_mm or (gel.mean_mm, gel.mean_mm)
        error = [[gel.mean_mm - low], [high - gel.mean_mm]]
        axes.errorbar(place + 0.03, gel.mean_mm, error, fmt=gel.mark.marker, color=colour, **_MEAN_MARK)
    if gel.drawn_mean_mm is not None:
        axes.plot([place + 0.10, place + 0.20], [gel.drawn_mean_mm] * 2, color="black", linewidth=1.6)
    if gel.paper_mm is not None:
        _draw_paper(axes, place + 0.32, *gel.paper_mm)


def _draw_paper(axes: Axes, place: float, mean_mm: float, sd_mm: float) -> None:
    """Draw the paper's mean with its standard deviation, dashed: it is no interval of a mean."""
    _, _, bars = axes.errorbar(place, mean_mm, sd_mm, **_PAPER_MARK)
    for bar in bars:
        bar.set_linestyle((0, (2, 1.5)))


def _explain_marks(axes: Axes, series: Sequence[GelSeries]) -> None:
    """Add a legend of the marks in the figure."""
    axes.errorbar([], [], [], fmt="o", color="#333333", label="mean, 95 % interval of it", **_MEAN_MARK)
    axes.plot([], [], color="#333333", label="± SD of the insertions", **_SD_BAR)
    if any(gel.paper_mm for gel in series):
        axes.errorbar([], [], [], label="paper: mean, ± SD dashed", **_PAPER_MARK)
    if any(gel.drawn_mean_mm is not None for gel in series):
        axes.plot([], [], color="black", linewidth=1.6, label="mean of the drawn radii")
    axes.legend(loc="lower left", handlelength=1.2)


def draw_coverage_figure(
    corners_px: Mapping[str, FloatArray], image_size: tuple[int, int], name: str
) -> Markup:
    """Draw the corners of the board found in each photograph, (N, 2) pixels."""
    width, height = image_size
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(5.6, 5.6 * height / width + 0.7), layout="constrained")
        axes = figure.subplots()
        for pixels in corners_px.values():
            axes.plot(
                pixels[:, 0], pixels[:, 1], ".", color="#0072b2", markersize=4, alpha=0.5, markeredgewidth=0
            )
        axes.set_xlim(-0.5, width - 0.5)
        axes.set_ylim(height - 0.5, -0.5)
        axes.set_aspect("equal")
        axes.set_xlabel("u, to the right (px)")
        axes.set_ylabel("v, downwards (px)")
        axes.grid(visible=True)
        for spine in axes.spines.values():
            spine.set_visible(True)
        return svg(figure, name)


def draw_residual_figure(views: Sequence[tuple[str, float]], overall_px: float, name: str) -> Markup:
    """Draw the reprojection error of each photograph [px], and of all together."""
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(5.6, 0.6 + 0.2 * max(len(views), 3)), layout="constrained")
        axes = figure.subplots()
        places = np.arange(len(views))
        axes.barh(places, [rms for _, rms in views], height=0.62, color="#0072b2")
        axes.axvline(overall_px, color=DESIGN, linewidth=1.2, linestyle=(0, (4, 2.5)))
        axes.set_yticks(places, [label for label, _ in views])
        axes.invert_yaxis()
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel("reprojection error, rms (px); dashed: all photographs")
        axes.grid(visible=True, axis="x")
        return svg(figure, name)


class DrawnFigure(Markup):
    """A figure as an element of a page, and what it was drawn from, so that it can be written as a file too."""

    name: str
    figure: Figure


def svg(figure: Figure, name: str) -> DrawnFigure:
    """Return the figure as an element of the page; its identifiers are unique within the page."""
    buffer = io.StringIO()
    # Not `savefig`, which draws everything twice, first into nothing.
    FigureCanvasSVG(figure).print_svg(buffer, metadata=NO_METADATA)  # type: ignore[no-untyped-call]
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'\s+(xmlns(:\w+)?|version)="[^"]*"', "", text, count=3)
    text = re.sub(r'\s(?:width|height)="[\d.]+pt"', "", text, count=2)
    text = text.replace("xlink:href", "href")
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", text)
    # Safe: drawn here from numbers and from text that matplotlib escapes.
    drawn = DrawnFigure(text)
    drawn.name, drawn.figure = name, figure
    return drawn
