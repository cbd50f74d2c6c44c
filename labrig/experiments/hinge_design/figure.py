"""The hinge in section, and figure 3 of the paper, on our own contour."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.figure import Figure

from labrig.needle.equations import EQUATION_3, RotationPlane
from labrig.needle.hinge import Hinge
from labrig.needle.rotation_search import GridPoint
from labrig.report.figures import SETTINGS, DrawnFigure, svg

# Okabe and Ito (2008).
_SEARCHED, _FITTED, _PAPER = "#000000", "#0072b2", "#d55e00"


def draw_section(hinge: Hinge, name: str) -> DrawnFigure:
    """Draw the hinge in the view along its pin, at rest, with what the laser cuts.

    Parameters
    ----------
    hinge : Hinge
    name : str
        Of the figure, unique within its page.
    """
    outer_mm, lip_mm = hinge.tube.outer_diameter_mm / 2, hinge.lip_depth_mm
    face_mm = 0.85 * outer_mm * np.tan(np.radians(hinge.beta_cut_deg)) - lip_mm
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(7.2, 5.2), layout="constrained")
        axes = figure.subplots()
        for link, colour in ((hinge.links.knuckle, "#b8c4ce"), (hinge.links.socket, "#e3d3b4")):
            for part in shapely.get_parts(link):
                axes.fill(*part.exterior.xy, facecolor=colour, edgecolor="#333333", linewidth=0.8)
        axes.set(title="The hinge along its pin", xlabel="mm", ylabel="along the needle (mm)", aspect="equal")
        axes.set(xlim=(-1.5 * outer_mm, 1.5 * outer_mm), ylim=(-1.6 * outer_mm, 1.2 * outer_mm))
        gap = (0.5 * outer_mm, -lip_mm - hinge.clearance_mm / 2)
        for words, place, text in (
            (f"pin, R = {hinge.knuckle_radius_mm:g} mm", (0.0, 0.0), (0.0, 0.9 * outer_mm)),
            (f"clearance {hinge.clearance_mm:g} mm", gap, (0.6 * outer_mm, -1.3 * outer_mm)),
            (
                f"inclined by {hinge.beta_cut_deg:.2f}°",
                (0.85 * outer_mm, face_mm),
                (outer_mm, 0.2 * outer_mm),
            ),
        ):
            arrow = {"arrowstyle": "->", "linewidth": 0.8}
            axes.annotate(words, place, text, ha="center", va="center", fontsize=8.5, arrowprops=arrow)
        return svg(figure, name)


def draw_hinge_figure(cells: Sequence[GridPoint], plane: RotationPlane, name: str) -> DrawnFigure:
    """Draw figure 3: the searched rotations over clearance and inclination, with both planes.

    Parameters
    ----------
    cells : sequence of GridPoint
        The searched grid.
    plane : RotationPlane
        Fitted to it.
    name : str
        Of the figure, unique within its page.
    """
    clearances_mm, cuts_deg = np.meshgrid(
        sorted({cell.clearance_mm for cell in cells}), sorted({cell.beta_cut_deg for cell in cells})
    )
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(7.2, 4.8), layout="constrained")
        axes: Any = figure.add_subplot(projection="3d")  # for which matplotlib has no types
        axes.set_title("Rotation of two adjacent hinges")
        for colour, shown, words in ((_FITTED, plane, "our contour"), (_PAPER, EQUATION_3, "equation (3)")):
            heights_deg = shown.a * cuts_deg + shown.b * clearances_mm + shown.c
            axes.plot_wireframe(clearances_mm, cuts_deg, heights_deg, color=colour, linewidth=0.8)
            axes.plot([], [], [], color=colour, label=f"{words}: {_format_formula(shown)}")
        axes.scatter(
            [cell.clearance_mm for cell in cells],
            [cell.beta_cut_deg for cell in cells],
            [cell.beta_rot_deg for cell in cells],
            color=_SEARCHED,
            s=14,
            depthshade=False,
            label="searched on our contour",
        )
        axes.locator_params(axis="x", nbins=4)
        axes.set_xlabel("clearance (mm)", labelpad=8)
        axes.set_ylabel("inclination (°)")
        axes.set_zlabel("rotation (°)")
        axes.view_init(elev=20, azim=-125)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.02))
        return svg(figure, name)


def _format_formula(plane: RotationPlane) -> str:
    sign = "−" if plane.c < 0 else "+"
    formula = f"{plane.a:.2f} × inclination + {plane.b:.0f} × clearance {sign} {abs(plane.c):.3f}"
    return f"{formula}, RMSE {plane.rmse_deg:.3f}°"
