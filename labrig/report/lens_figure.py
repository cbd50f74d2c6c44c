"""Draw a calibrated lens: the coverage by boards, the residuals, and the uncertainty of each pixel."""

import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy.ndimage import zoom

from labrig.durable import write_atomically
from labrig.report.figures import SETTINGS
from labrig.report.palette import mark
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.lens_judgement import LARGEST_PROJECTION_SIGMA_PX, WORKING_MARGIN

_DOTS_PER_INCH = 130
_LEVELS_PX = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
# Contours are drawn on a map that is finer by this factor, interpolated in its logarithm.
_FINER = 6
_LEAST_SIGMA_PX = 1e-6
# Residuals are enlarged until their rms is this share of the picture's width.
_ARROW_SHARE = 0.02
_LEFT_OUT = "#999999"


def write_lens_figure(path: Path, lens: Intrinsics) -> None:
    """Draw residuals and coverage beside the uncertainty over the picture, as PNG.

    Raises
    ------
    DiskError
        If the file cannot be written.
    """
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(10.0, 4.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        _draw_residuals(left, lens)
        _draw_uncertainty(right, lens)
        for axes in (left, right):
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
    longer = _ARROW_SHARE * lens.image_size[0] / max(lens.rms_px, _LEAST_SIGMA_PX)
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


def _draw_uncertainty(axes: Axes, lens: Intrinsics) -> None:
    if lens.projection_sigma_px is None:
        axes.set_title("The views do not determine the lens")
        return
    sigma = np.maximum(np.array(lens.projection_sigma_px), _LEAST_SIGMA_PX)
    width, height = lens.image_size
    u, v = np.linspace(0, width - 1, sigma.shape[1]), np.linspace(0, height - 1, sigma.shape[0])
    smooth = np.exp(zoom(np.log(sigma), _FINER))
    finer = (np.linspace(0, width - 1, smooth.shape[1]), np.linspace(0, height - 1, smooth.shape[0]))
    levels = (0.0, *_LEVELS_PX, max(2 * _LEVELS_PX[-1], 1.01 * float(smooth.max())))
    norm = BoundaryNorm(levels, mpl.colormaps["Blues"].N)
    axes.contourf(*finer, smooth, levels=levels, cmap="Blues", norm=norm, alpha=0.7)
    drawn = axes.contour(*finer, smooth, levels=_LEVELS_PX, colors="#555555", linewidths=0.5)
    axes.clabel(drawn, fmt="%g", fontsize=7.5)
    places = np.stack(np.meshgrid(u[1:-1:2], v[1:-1:2]), axis=-1).reshape(-1, 2)
    for place, value in zip(places, sigma[1:-1:2, 1:-1:2].ravel(), strict=True):
        axes.annotate(f"{value:.2f}", tuple(place), ha="center", va="center", fontsize=8.5, fontweight="bold")
    corner = (WORKING_MARGIN * (width - 1), WORKING_MARGIN * (height - 1))
    sides = [(1.0 - 2.0 * WORKING_MARGIN) * (side - 1) for side in (width, height)]
    label = f"working area: {LARGEST_PROJECTION_SIGMA_PX:g} px at most"
    axes.add_patch(
        Rectangle(corner, *sides, fill=False, edgecolor="#d55e00", linestyle="--", linewidth=1.2, label=label)
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), borderaxespad=0.0)
    axes.set_title("Uncertainty of a pixel, one standard deviation (px)")
