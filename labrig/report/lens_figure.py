"""A calibrated lens as a figure of its own: what the boards covered, what is left over, and how sure each pixel is."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure

from labrig.report.figures import SETTINGS
from labrig.report.palette import mark
from labrig.vision import Intrinsics

_DOTS_PER_INCH = 130
_LEVELS_PX = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
# Residuals are drawn so much longer that their rms is this share of the picture's width.
_ARROW_SHARE = 0.02


def write_lens_figure(path: Path, lens: Intrinsics) -> None:
    """Draw residuals and coverage beside the uncertainty over the picture, as PNG.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(10.0, 4.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        _draw_residuals(left, lens)
        _draw_uncertainty(right, lens)
        for axes in (left, right):
            axes.set_xlim(-0.5, lens.image_size[0] - 0.5)
            axes.set_ylim(lens.image_size[1] - 0.5, -0.5)
            axes.set_aspect("equal")
            axes.set_xlabel("u (px)")
            axes.set_ylabel("v (px)")
        figure.savefig(path, format="png", dpi=_DOTS_PER_INCH, facecolor="white")


def _draw_residuals(axes: Axes, lens: Intrinsics) -> None:
    longer = max(1.0, round(_ARROW_SHARE * lens.image_size[0] / max(lens.rms_px, 1e-6)))
    for index, view in enumerate(lens.views):
        if not view.corners_px:
            continue
        corners = np.array(view.corners_px)
        colour = mark(index).colour if view.used else "#bbbbbb"
        axes.plot(*corners.T, "." if view.used else "x", color=colour, markersize=2 if view.used else 4)
        if view.errors_px:
            ends = np.stack((corners, corners + longer * np.array(view.errors_px)), axis=1)
            axes.plot(*ends.transpose(2, 1, 0), color=colour, linewidth=0.9)
    used = sum(view.used for view in lens.views)
    coverage = "" if lens.coverage is None else f", {100.0 * lens.coverage:.0f} % of the picture"
    axes.set_title(f"{used} views{coverage}; residuals {longer:g} times enlarged")


def _draw_uncertainty(axes: Axes, lens: Intrinsics) -> None:
    if lens.projection_sigma_px is None:
        axes.set_title("The views do not determine the lens")
        return
    sigma = np.array(lens.projection_sigma_px)
    width, height = lens.image_size
    u, v = np.linspace(0, width - 1, sigma.shape[1]), np.linspace(0, height - 1, sigma.shape[0])
    levels = (0.0, *_LEVELS_PX, max(2 * _LEVELS_PX[-1], float(sigma.max())))
    norm = BoundaryNorm(levels, mpl.colormaps["Blues"].N)
    axes.contourf(u, v, sigma, levels=levels, cmap="Blues", norm=norm, alpha=0.7)
    axes.contour(u, v, sigma, levels=_LEVELS_PX, colors="#555555", linewidths=0.5)
    for place, value in zip(
        np.stack(np.meshgrid(u[1:-1:2], v[1:-1:2]), axis=-1).reshape(-1, 2),
        sigma[1:-1:2, 1:-1:2].ravel(),
        strict=True,
    ):
        axes.annotate(f"{value:.2f}", tuple(place), ha="center", va="center", fontsize=8.5)
    axes.set_title("Uncertainty of a pixel, one standard deviation (px)")
