"""Line figures by matplotlib, as SVG within the page.

Only matplotlib's object interface is used: no figure outlives its function, and no setting outlives a figure. The same
data give the same bytes.
"""

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from labrig.durable import write_atomically
from labrig.protocol.model import Interval
from labrig.report.formatting import count_decimals, interval
from labrig.report.palette import DESIGN, Mark, mark

FloatArray = NDArray[np.float64]

SETTINGS: dict[Any, Any] = {
    "svg.hashsalt": "labrig",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,  # keeps text as text, which journals ask for
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
_METADATA = {
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"Creator": None, "Producer": None, "CreationDate": None},
}
_NARROW_IN = 4.4
"""Width of a figure whose text can be read on a telephone."""
_GREY = "#333333"
_DESIGN_LINE: dict[str, Any] = {"color": DESIGN, "linewidth": 1.4, "linestyle": (0, (4, 2.5))}
_MEAN: dict[str, Any] = {"markersize": 6, "capsize": 3.5, "linewidth": 1.5}
_SD: dict[str, Any] = {"fmt": "none", "elinewidth": 6.0, "alpha": 0.4}
_DRAWN: dict[str, Any] = {"fmt": "none", "color": "black", "elinewidth": 1.6}
_CLEAR: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
"""Behind words that stand on a line."""
_PAPER: dict[str, Any] = {"fmt": "D", "color": "#666666", "mfc": "white", "markersize": 5, "linewidth": 0.9}
MOST_VECTORS = 300
"""Points that are drawn one by one; more of them become a picture, which is smaller."""


class DrawnFigure(Markup):
    """A figure as elements of a page, wide and narrow; the wide one as a file, and what it was drawn from."""

    name: str
    figure: Figure
    file: str


def svg(figure: Figure, name: str) -> DrawnFigure:
    """Return the figure as elements of the page: as it is, and for narrow screens with its panels in one column."""
    width_in, height_in = figure.get_size_inches().tolist()
    panels = {axes: place for axes in figure.axes if (place := axes.get_subplotspec()) is not None}
    wide = _draw(figure)
    columns = max((place.get_gridspec().ncols for place in panels.values()), default=1)
    tall_in = height_in * columns
    if any(axes.get_aspect() != "auto" for axes in panels):
        tall_in *= min(1.0, 0.15 + columns * _NARROW_IN / width_in)  # axes shrink, their labels do not
    figure.set_size_inches(_NARROW_IN, tall_in)
    column = figure.add_gridspec(len(panels), 1)
    # Beside one another panels may share the names of their rows, and below one another each needs them.
    named = {axes: axes.yaxis.get_tick_params().get("labelleft", True) for axes in panels}
    for row, axes in enumerate(panels):
        axes.set_subplotspec(column[row])
        axes.tick_params(labelleft=True)
    narrow = _draw(figure)
    for axes, place in panels.items():
        axes.set_subplotspec(place)
        axes.tick_params(labelleft=named[axes])
    figure.set_size_inches(width_in, height_in)
    told = _name_panels(figure)
    # Safe: drawn here from numbers and from text that matplotlib escapes.
    drawn = DrawnFigure(
        _make_element(wide, name, "wide", told) + _make_element(narrow, f"{name}-narrow", "slim", told)
    )
    drawn.name, drawn.figure, drawn.file = name, figure, wide
    return drawn


def _draw(figure: Figure) -> str:
    buffer = io.StringIO()
    with mpl.rc_context(SETTINGS):
        # Not `savefig`, which draws everything twice, first into nothing.
        FigureCanvasSVG(figure).print_svg(buffer, metadata=_METADATA["svg"])  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def _make_element(file: str, name: str, look: str, told: str) -> str:
    """Return a drawn figure as an SVG element of this class; its identifiers are unique within the page."""
    text = file[file.index("<svg") :]
    text = re.sub(r'\s+(xmlns(:\w+)?|version)="[^"]*"', "", text, count=3)
    text = re.sub(r'\s(?:width|height)="[\d.]+pt"', "", text, count=2)
    text = text.replace("xlink:href", "href").replace(
        "<svg", f'<svg class="{look}" role="img" aria-label="{told}"', 1
    )
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", text)


def _name_panels(figure: Figure) -> str:
    """Return what a figure shows, for who cannot see it: its panels by their titles and what is over what."""
    panels = (
        ", ".join(filter(None, (axes.get_title("left"), " over ".join(filter(None, labels)))))
        for axes in figure.axes
        for labels in [(axes.get_ylabel(), axes.get_xlabel())]
    )
    return escape("Figure: " + "; ".join(filter(None, panels)))


def write_figure(folder: Path, drawn: DrawnFigure) -> None:
    """Write a figure as NAME.svg and NAME.pdf, for a paper. Raises `DiskError`."""
    write_atomically(folder / f"{drawn.name}.svg", drawn.file.encode())
    write_image(folder / f"{drawn.name}.pdf", drawn.figure)


def write_image(path: Path, figure: Figure, **options: Any) -> None:
    """Write a figure in the format that the suffix names; equal figures give equal files. Raises `DiskError`."""
    buffer, form = io.BytesIO(), path.suffix.lower().lstrip(".")
    with mpl.rc_context(SETTINGS):
        figure.savefig(buffer, format=form, metadata=_METADATA.get(form), dpi=150, **options)
    write_atomically(path, buffer.getvalue())


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


def choose_limits(values: Sequence[float], intervals: Sequence[Interval | None]) -> Interval | None:
    """Return the limits of an axis of values and intervals; None without two different values.

    An interval of two or three values may be ten times as wide as these, and would squeeze all else to a point. It may
    go on beyond them by 1.5 times what they are apart; a longer one is cut where it has gone on by once that.
    """
    low, high = min(values, default=0.0), max(values, default=0.0)
    if low == high:
        return None
    span, ends = high - low, np.array([low, high, *(end for interval in intervals for end in interval or ())])
    cut = np.clip(ends, low - span, high + span)
    shown = np.where(np.abs(ends - cut) < span / 2, ends, cut)
    return float(shown.min() - 0.04 * np.ptp(shown)), float(shown.max() + 0.04 * np.ptp(shown))


def draw_interval(
    axes: Axes, ends: Interval, place: float, colour: str, *, width: float = 2.0, upright: bool = False
) -> None:
    """Draw an interval with caps, and with an arrow where it goes on beyond the limits of its axis."""
    limits, cap, arrows = (axes.get_ylim(), "_", "v^") if upright else (axes.get_xlim(), "|", "<>")
    inset = 0.02 * (limits[1] - limits[0])
    inside = (np.array(ends) >= limits[0]) & (np.array(ends) <= limits[1])
    shown = np.where(inside, ends, np.clip(ends, limits[0] + inset, limits[1] - inset))
    marks = (
        (at, cap, 8) if end == at else (at, arrow, 5)
        for end, at, arrow in zip(ends, shown, arrows, strict=True)
    )
    for along, style, size in [(shown, "-", 0), *marks]:
        across = np.full_like(along, place)
        points = (across, along) if upright else (along, across)
        axes.plot(*points, style, color=colour, linewidth=width, markersize=size, clip_on=style == "-")
    if tuple(shown) != tuple(ends):
        words, end = interval(ends, count_decimals([ends], ends)), int(upright or shown[0] == ends[0])
        # Beside an upright interval, and above the arrow of any other.
        look: dict[str, Any] = {"rotation": 90, "va": "top"} if upright else {"ha": ("left", "right")[end]}
        place_at, off = ((place, shown[1]), (-11, 0)) if upright else ((shown[end], place), (0, 5))
        axes.annotate(words, place_at, off, textcoords="offset points", fontsize=8, bbox=_CLEAR, **look)


def draw_steerability_figure(series: Sequence[GelSeries], design: Design, name: str) -> DrawnFigure:
    """Draw figure 8 of the paper: all paths from one sheath tip, and the radii of each gel."""
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 4.7), layout="constrained")
        paths, radii = figure.subplots(1, 2, width_ratios=(1.12, 1))
        _draw_paths(paths, series, design)
        _draw_radii(radii, series, design)
        return svg(figure, name)


def _draw_paths(axes: Axes, series: Sequence[GelSeries], design: Design) -> None:
    for gel in series:
        for path in gel.paths_mm:
            axes.plot(path[:, 1], path[:, 0], color=gel.mark.colour, linewidth=0.9)
        axes.plot([], [], color=gel.mark.colour, linewidth=2, label=gel.label)
    angle = np.linspace(0.0, design.length_mm / design.radius_mm, 80)
    sideways_mm = design.side * design.radius_mm * (1.0 - np.cos(angle))
    label = f"design, {design.radius_mm:g} mm"
    axes.plot(design.radius_mm * np.sin(angle), sideways_mm, label=label, **_DESIGN_LINE)
    axes.set_aspect("equal", anchor="N")
    axes.set(
        title="Paths, from the tip of the sheath",
        xlabel="z, along the insertion (mm)",
        ylabel="y, sideways (mm)",
    )
    axes.grid(visible=True)
    axes.legend(loc="lower left" if design.side < 0 else "upper left", handlelength=1.6)


def _draw_radii(axes: Axes, series: Sequence[GelSeries], design: Design) -> None:
    """Draw a column a gel: radii, our mean, the true mean and the paper's, from left to right."""
    axes.axhline(design.radius_mm, label=f"design, {design.radius_mm:g} mm", **_DESIGN_LINE)
    for place, gel in enumerate(series):
        # Spread sideways in a fixed pattern, so that equal radii do not cover each other.
        sideways = place - 0.22 + 0.045 * (np.arange(len(gel.radii_mm)) % 5 - 2)
        look: dict[str, Any] = {
            "color": gel.mark.colour,
            "markersize": 4.2,
            "alpha": 0.8,
            "markeredgewidth": 0,
        }
        axes.plot(sideways, gel.radii_mm, gel.mark.marker, **look)
        mean_mm, sd_mm, drawn_mm = np.array([gel.mean_mm, gel.sd_mm, gel.drawn_mean_mm], dtype=np.float64)
        axes.errorbar(place + 0.24, mean_mm, sd_mm, ecolor=gel.mark.colour, **_SD)
        axes.errorbar(place + 0.13, drawn_mm, xerr=0.05, **_DRAWN)
        if gel.paper_mm is not None:
            # Dashed: it is no interval of a mean.
            axes.errorbar(place + 0.36, *gel.paper_mm, **_PAPER)[2][0].set_linestyle((0, (5, 2)))
    axes.set_ymargin(0.2)
    axes.autoscale_view()
    axes.set_ylim(choose_limits(axes.get_ylim(), [gel.ci95_mm for gel in series]))
    for place, gel in enumerate(series):
        if gel.mean_mm is not None:
            if gel.ci95_mm is not None:
                draw_interval(axes, gel.ci95_mm, place + 0.03, gel.mark.colour, width=1.5, upright=True)
            axes.plot(place + 0.03, gel.mean_mm, gel.mark.marker, color=gel.mark.colour, markersize=6)
    _explain_marks(axes, series)
    axes.set_xticks(range(len(series)), [gel.label for gel in series])
    axes.set(
        title="Radius of each insertion, and means",
        xlabel="gelatin, mass of powder per water",
        ylabel="radius of curvature (mm)",
        xlim=(-0.6, len(series) - 0.4),
    )
    axes.grid(visible=True, axis="y")


def _explain_marks(axes: Axes, series: Sequence[GelSeries]) -> None:
    """Add a legend of the marks in the figure."""
    interval = ", 95 % interval of it" if any(gel.ci95_mm for gel in series) else ""
    axes.errorbar([], [], [] if interval else None, fmt="o", color=_GREY, label=f"mean{interval}", **_MEAN)
    if any(gel.sd_mm is not None for gel in series):
        axes.errorbar([], [], [], ecolor=_GREY, label="± SD of the insertions", **_SD)
    if any(gel.paper_mm for gel in series):
        axes.errorbar([], [], [], label="paper: mean, ± SD dashed", **_PAPER)
    if any(gel.drawn_mean_mm is not None for gel in series):
        axes.errorbar([], [], xerr=[], label="true mean of these insertions", **_DRAWN)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, handlelength=1.8)


def _find_hull(views: Iterable[ArrayLike]) -> cv2.typing.MatLike:
    corners_px = np.concatenate([np.reshape(corners, (-1, 2)) for corners in views])
    return cv2.convexHull(corners_px.astype(np.float32))


def clip_to_corners(line_px: FloatArray, views: Sequence[ArrayLike]) -> FloatArray:
    """Return a line (2, 2) as far as it is within the corners (N, 2) of all views [px]; all of it if none is."""
    hull = _find_hull(views or [line_px])
    points = np.linspace(line_px[0], line_px[1], 500)
    within = [
        place
        for place, px in enumerate(points.tolist())
        if cv2.pointPolygonTest(hull, px, measureDist=False) >= 0
    ]
    return points[[within[0], within[-1]]] if within else line_px


def draw_lens(
    image_size: tuple[int, int],
    views: Iterable[tuple[ArrayLike, ArrayLike]],
    rms_px: float,
    needle_px: ArrayLike | None = None,
) -> Figure:
    """Draw the corners (N, 2) of the board in each view [px], and their residuals (N, 2), enlarged, if known.

    `needle_px` (2, 2) is a line along which the needle goes.
    """
    width, height = image_size
    larger = 0.02 * width / max(rms_px, 1e-6)
    seen = [[np.reshape(pixels, (-1, 2)) for pixels in view] for view in views]
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(8.4, 8.0 * height / width + 0.6), layout="constrained")
        axes = figure.subplots()
        if seen:
            hull = _find_hull(corners_px for corners_px, _ in seen)
            axes.fill(*hull[:, 0].T, facecolor="#0072b2", alpha=0.1)
        for corners_px, errors_px in seen:
            axes.plot(*corners_px.T, ".", color=mark(0).colour, markersize=3)
            if len(errors_px):
                ends = np.stack((corners_px, corners_px + larger * errors_px), axis=1)
                axes.plot(*ends.transpose(2, 1, 0), color=mark(1).colour, linewidth=0.9)
                axes.set_title(
                    f"Corners of the board; residuals {larger:.0f} times enlarged, {rms_px:.2g} px rms"
                )
        if needle_px is not None:
            start, end = np.asarray(needle_px)
            arrow = {"arrowstyle": "->", "color": mark(1).colour, "linewidth": 2}
            axes.annotate("", end, start, arrowprops=arrow)
            where: dict[str, Any] = {"textcoords": "offset points", "bbox": _CLEAR}
            axes.annotate("z", start, (4, 5), color=mark(1).colour, fontweight="bold", **where)
        axes.set_aspect("equal")
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
        axes.set(xlabel="u, to the right (px)", ylabel="v, downwards (px)")
        axes.grid(visible=True)
        axes.spines[:].set_visible(True)
        return figure
