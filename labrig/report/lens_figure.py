"""Draw the corners of a calibrated lens's boards with their residuals."""

import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrig.durable import write_atomically
from labrig.report.figures import SETTINGS
from labrig.report.palette import mark
from labrig.vision.intrinsics import Intrinsics

_DOTS_PER_INCH = 130
_LEAST_RMS_PX = 1e-6
# Residuals are enlarged until their rms is this share of the picture's width.
_ARROW_SHARE = 0.02
_LEFT_OUT = "#999999"


def write_lens_figure(path: Path, lens: Intrinsics) -> None:
    """Draw corners and residuals over the picture, as PNG.

    Raises
    ------
    DiskError
        If the file cannot be written.
    """
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(6.4, 5.4), layout="constrained")
        axes = figure.subplots()
        _draw_residuals(axes, lens)
        axes.set_xlim(-0.5, lens.image_size[0] - 0.5)
        axes.set_ylim(lens.image_size[1] - 0.5, -0.5)
        axes.set_aspect("equal")
        axes.set_xlabel("u (px)")
        axes.set_ylabel("v (px)")
        axes.spines[:].set_visible(True)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=_DOTS_PER_INCH, facecolor="white")
    write_atomically(path, buffer.getvalue())


def _draw_residuals(axes: Axes, lens: Intrinsics) -> None:
    longer = _ARROW_SHARE * lens.image_size[0] / max(lens.rms_px, _LEAST_RMS_PX)
    for index, view in enumerate(lens.views):
        if not view.corners_px:
            continue
        corners = np.array(view.corners_px)
        colour = mark(index).colour if view.used else _LEFT_OUT
        axes.plot(*corners.T, "." if view.used else "x", color=colour, markersize=2 if view.used else 4)
        if view.errors_px:
            ends = np.stack((corners, corners + longer * np.array(view.errors_px)), axis=1)
            axes.plot(*ends.transpose(2, 1, 0), color=colour, linewidth=0.9)
    used = sum(view.used for view in lens.views)
    coverage = "" if lens.coverage is None else f", {100.0 * lens.coverage:.0f} % of the picture"
    axes.set_title(f"Corners of {used} views{coverage}, with their residuals")
    length = float(f"{2.0 * lens.rms_px:.1g}")
    axes.plot(
        [],
        [],
        color="#333333",
        linewidth=0.9,
        label=f"residuals {longer:.0f} times enlarged, {lens.rms_px:.2g} px rms",
    )
    if any(view.corners_px and not view.used for view in lens.views):
        axes.plot([], [], "x", color=_LEFT_OUT, markersize=4, label="of views left out")
    _draw_scale(axes, lens.image_size, longer, length)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, borderaxespad=0.0)


def _draw_scale(axes: Axes, size: tuple[int, int], longer: float, length_px: float) -> None:
    """Draw a residual of this length as a scale in the lower left corner."""
    u, v = 0.03 * size[0], 0.95 * size[1]
    axes.plot((u, u + longer * length_px), (v, v), color="black", linewidth=1.8, solid_capstyle="butt")
    axes.annotate(f"{length_px:g} px", (u, v), xytext=(0, 3), textcoords="offset points", fontsize=8.5)
