"""The hinges in section, and figure 3 of the paper, on our own contour."""

import math

import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from labrig.experiments.hinge_design.result import DesignStudy
from labrig.needle.hinge import Hinge, LinkPair
from labrig.report.figures import SETTINGS, DrawnFigure, svg

# Okabe and Ito (2008).
_SEARCHED, _FITTED, _PAPER = "#000000", "#0072b2", "#d55e00"
_DRAWN_RADII_MM = (15, 20, 25, 30, 40, 60, 100)


def draw_section(hinge: Hinge, name: str) -> DrawnFigure:
    """Draw two adjacent hinges at rest in the plane of bending, and enlarged what the laser cuts.

    Parameters
    ----------
    hinge : Hinge
    name : str
        Of the figure, unique within its page.
    """
    outer_mm, knuckle_mm = hinge.tube.outer_diameter_mm / 2, hinge.knuckle_radius_mm
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 3.8), layout="constrained")
        along, across, detail = figure.subplots(1, 3, width_ratios=(1, 1, 1.8))
        for axes, links, title in (
            (along, hinge.links, "Hinge a, from the side"),
            (across, hinge.section(0.0), "Hinge b, in section"),
            (detail, hinge.links, "Hinge a, enlarged: the cut"),
        ):
            _draw_links(axes, links)
            axes.set(title=title, xlabel="across the needle (mm)")
        for axes in (along, detail):
            axes.set_ylabel("along the needle (mm)")
        for axes in (along, across):
            axes.set(xlim=(-1.2 * outer_mm, 2.0 * outer_mm), ylim=(-2.2 * outer_mm, 2.2 * outer_mm))
            axes.text(1.1 * outer_mm, 1.7 * outer_mm, "socket", fontsize=8.5)
            axes.text(1.1 * outer_mm, -1.8 * outer_mm, "knuckle", fontsize=8.5)
        along.plot(0.0, 0.0, "+", color=_PAPER, markersize=9)
        rim_mm = knuckle_mm * np.array((math.cos(math.radians(50.0)), math.sin(math.radians(50.0))))
        along.annotate("", rim_mm, (0.0, 0.0), arrowprops={"arrowstyle": "->", "color": _PAPER})
        along.text(0.0, 1.05 * outer_mm, f"R = {knuckle_mm:g} mm", ha="center", fontsize=8.5, color=_PAPER)
        across.plot([-outer_mm, outer_mm], [0.0, 0.0], "--", color=_PAPER, linewidth=0.9)
        across.text(0.0, 0.06 * outer_mm, "pin", ha="center", fontsize=8.5, color=_PAPER)
        _explain_cut(detail, hinge)
        return svg(figure, name)


def _draw_links(axes: Axes, links: LinkPair) -> None:
    for link, colour in ((links.knuckle, "#b8c4ce"), (links.socket, "#e3d3b4")):
        for part in shapely.get_parts(link):
            axes.fill(*part.exterior.xy, facecolor=colour, edgecolor="#333333", linewidth=0.8)
    axes.set_aspect("equal")


def _explain_cut(axes: Axes, hinge: Hinge) -> None:
    """Mark the clearance where it is as wide as the laser cuts, and the inclination as an angle."""
    outer_mm, lip_mm = hinge.tube.outer_diameter_mm / 2, hinge.lip_depth_mm
    cut_rad = math.radians(hinge.beta_cut_deg)
    axes.set_xlim(0.15 * outer_mm, 1.65 * outer_mm)
    axes.set_ylim(-lip_mm - 0.35 * outer_mm, -lip_mm + 0.75 * outer_mm)
    middle_mm = hinge.knuckle_radius_mm - hinge.clearance_mm / 2
    axes.annotate(
        f"clearance {hinge.clearance_mm:g} mm",
        (middle_mm * math.cos(math.radians(20.0)), -middle_mm * math.sin(math.radians(20.0))),
        (1.28 * outer_mm, -0.1 * outer_mm),
        ha="center",
        fontsize=8.5,
        arrowprops={"arrowstyle": "->", "linewidth": 0.8},
    )
    # The face is the square line at the height of the lips, turned about the pin; they meet here.
    corner = np.array((lip_mm * math.tan(cut_rad / 2), -lip_mm))
    for angle_rad in (0.0, cut_rad):
        end = corner + 1.2 * outer_mm * np.array((math.cos(angle_rad), math.sin(angle_rad)))
        axes.plot(*np.transpose((corner, end)), "--", color=_PAPER, linewidth=0.9)
    turn_rad = np.linspace(0.0, cut_rad, 20)
    arc = corner + 1.12 * outer_mm * np.column_stack((np.cos(turn_rad), np.sin(turn_rad)))
    axes.plot(*arc.T, color=_PAPER, linewidth=1.4)
    label = f"inclination\n{hinge.beta_cut_deg:.2f}°"
    axes.text(1.24 * outer_mm, -lip_mm + 0.02 * outer_mm, label, fontsize=8.5, color=_PAPER)


def draw_hinge_figure(study: DesignStudy, name: str) -> DrawnFigure:
    """Draw figure 3 in the plane: the rotation over the clearance for three inclinations, and the design.

    Parameters
    ----------
    study : DesignStudy
    name : str
        Of the figure, unique within its page.
    """
    cuts_deg = sorted({cell.beta_cut_deg for cell in study.cells})
    clearances_mm = np.array(sorted({cell.clearance_mm for cell in study.cells}))
    factor = 2.0 * math.degrees(study.tube.link_length_mm)

    def convert(values: ArrayLike) -> ArrayLike:
        """Return radii [mm] of rotations [degrees], and rotations of radii (equation 1)."""
        return np.asarray(factor / np.maximum(values, 0.1))

    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 4.6), layout="constrained")
        axes = figure.subplots()
        lines = (
            (study.search.fit, _FITTED, "-", "our contour, fitted plane"),
            (study.equation_3, _PAPER, "--", "equation (3)"),
        )
        for cut_deg in (cuts_deg[0], cuts_deg[len(cuts_deg) // 2], cuts_deg[-1]):
            for plane, colour, style, words in lines:
                turns_deg = [plane.beta_rot_deg(cut_deg, clearance_mm) for clearance_mm in clearances_mm]
                label = words if cut_deg == cuts_deg[0] else None
                axes.plot(clearances_mm, turns_deg, style, color=colour, linewidth=1.1, label=label)
            found = [
                (cell.clearance_mm, cell.beta_rot_deg) for cell in study.cells if cell.beta_cut_deg == cut_deg
            ]
            axes.plot(*np.transpose(found), "o", color=_SEARCHED, markersize=3.5)
            words = f"inclination {cut_deg:.3g}°"
            axes.annotate(words, min(found), (6, -14), textcoords="offset points", fontsize=8.5)
        axes.plot([], [], "o", color=_SEARCHED, markersize=3.5, label="searched on our contour")
        axes.plot(
            study.clearance_mm, study.beta_rot_deg, "*", color="#009e73", markersize=13, label="this design"
        )
        axes.set_ymargin(0.1)
        axes.set(xlabel="clearance (mm)", ylabel="Rotation of two adjacent hinges (degrees)")
        radius = axes.secondary_yaxis("right", functions=(convert, convert))
        radius.set_ylabel("radius (mm)")
        low_deg, high_deg = axes.get_ylim()
        radius.set_yticks([mm for mm in _DRAWN_RADII_MM if low_deg < factor / mm < high_deg])
        axes.grid(visible=True)
        axes.legend(loc="upper left")
        return svg(figure, name)
