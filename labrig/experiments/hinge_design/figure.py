"""The hinge in section, and figure 3 of the paper, on our own contour."""

import io
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrig.needle.design_search import GridPoint
from labrig.needle.equations import EQUATION_3, RotationPlane
from labrig.needle.hinge import Hinge
from labrig.report.figures import SETTINGS, DrawnFigure, svg

# This figure is an image by itself, with its own ground and letters.
_SETTINGS = SETTINGS | {"figure.facecolor": "white", "axes.facecolor": "white", "svg.fonttype": "path"}
# Okabe and Ito (2008).
_SEARCHED, _FITTED, _PAPER = "#000000", "#0072b2", "#d55e00"
_MARKERS = "osD^vPX"


def draw_section(hinge: Hinge, name: str) -> DrawnFigure:
    """Draw the hinge in the view along its pin, at rest, and enlarged what the laser cuts at its stop faces.

    Parameters
    ----------
    hinge : Hinge
    name : str
        Of the figure, unique within its page.
    """
    outer_mm, lip_mm = hinge.tube.outer_diameter_mm / 2, hinge.lip_depth_mm
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 5.2), layout="constrained")
        whole, detail = figure.subplots(1, 2)
        for axes, title in ((whole, "The hinge along its pin"), (detail, "Its stop faces, enlarged")):
            for link, colour in ((hinge.links.knuckle, "#b8c4ce"), (hinge.links.socket, "#e3d3b4")):
                for part in shapely.get_parts(link):
                    axes.fill(*part.exterior.xy, facecolor=colour, edgecolor="#333333", linewidth=0.8)
            axes.set_title(title)
            axes.set_aspect("equal")
            axes.set_xlabel("mm")
        whole.set_ylabel("along the needle (mm)")
        whole.plot(0.0, 0.0, "+", color=_PAPER, markersize=9)
        whole.set_xlim(-1.5 * outer_mm, 1.5 * outer_mm)
        whole.set_ylim(-2.2 * outer_mm, 2.2 * outer_mm)
        _point_out(whole, f"pin, R = {hinge.knuckle_radius_mm:g} mm", (0.0, 0.0), (0.0, 1.5 * outer_mm))
        detail.set_xlim(0.15 * outer_mm, 1.15 * outer_mm)
        detail.set_ylim(-lip_mm - 0.55 * outer_mm, -lip_mm + 0.45 * outer_mm)
        gap = (0.5 * outer_mm, -lip_mm - hinge.clearance_mm / 2)
        _point_out(
            detail,
            f"clearance d = {hinge.clearance_mm:g} mm",
            gap,
            (0.7 * outer_mm, -lip_mm - 0.35 * outer_mm),
        )
        face = (0.85 * outer_mm, -lip_mm + 0.85 * outer_mm * np.tan(np.radians(hinge.beta_cut_deg)))
        words = f"inclined by β_cut = {hinge.beta_cut_deg:.2f}°"
        _point_out(detail, words, face, (0.8 * outer_mm, -lip_mm + 0.3 * outer_mm))
        return svg(figure, name)


def _point_out(axes: Axes, words: str, place: tuple[float, float], text: tuple[float, float]) -> None:
    """Write words into a link, with an arrow to what they are of."""
    arrow = {"arrowstyle": "->", "linewidth": 0.8}
    axes.annotate(words, place, text, ha="center", va="center", fontsize=8.5, arrowprops=arrow)


def draw_hinge_figure(cells: Sequence[GridPoint], plane: RotationPlane, picture_format: str) -> bytes:
    """Return figure 3: the searched rotations with both planes, and the residuals of our plane.

    Parameters
    ----------
    cells : sequence of GridPoint
        The searched grid.
    plane : RotationPlane
        Fitted to it.
    picture_format : str
        ``png``, ``svg`` or ``pdf``.
    """
    with mpl.rc_context(_SETTINGS):
        figure = Figure(figsize=(10.5, 4.8), layout="constrained")
        grid = figure.add_gridspec(1, 2, width_ratios=(1.25, 1))
        rotations = figure.add_subplot(grid[0], projection="3d")
        _draw_rotations(rotations, cells, plane)
        _draw_residuals(figure.add_subplot(grid[1]), cells, plane)
        buffer = io.BytesIO()
        figure.savefig(buffer, format=picture_format, dpi=160, metadata=_omit_date(picture_format))
        return buffer.getvalue()


def _omit_date(picture_format: str) -> dict[str, None]:
    """Return metadata that leaves out the date, so that the same data give the same bytes."""
    return {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(picture_format, {})


def _draw_rotations(axes: Any, cells: Sequence[GridPoint], plane: RotationPlane) -> None:
    """Draw into axes of the projection "3d", for which matplotlib has no types."""
    clearances_mm, cuts_deg = np.meshgrid(
        sorted({cell.clearance_mm for cell in cells}), sorted({cell.beta_cut_deg for cell in cells})
    )
    axes.set_title("Rotation of two adjacent hinges")
    for colour, shown, name in ((_FITTED, plane, "our contour"), (_PAPER, EQUATION_3, "equation (3)")):
        heights_deg = shown.a * cuts_deg + shown.b * clearances_mm + shown.c
        axes.plot_wireframe(clearances_mm, cuts_deg, heights_deg, color=colour, linewidth=0.8)
        axes.plot([], [], [], color=colour, label=f"{name}: {_format_formula(shown)}")
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
    axes.set_xlabel("clearance d [mm]", labelpad=8)
    axes.set_ylabel("inclination β_cut [°]")
    axes.set_zlabel("β_rot [°]")
    axes.view_init(elev=20, azim=-125)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.02))


def _format_formula(plane: RotationPlane) -> str:
    sign = "-" if plane.c < 0 else "+"
    return f"{plane.a:.2f} β_cut + {plane.b:.0f} d {sign} {abs(plane.c):.3f}, RMSE {plane.rmse_deg:.3f}°"


def _draw_residuals(axes: Axes, cells: Sequence[GridPoint], plane: RotationPlane) -> None:
    axes.set_title("Searched less fitted")
    clearances_mm = sorted({cell.clearance_mm for cell in cells})
    colours = mpl.colormaps["cividis"](np.linspace(0.0, 0.9, len(clearances_mm)))
    for colour, marker, clearance_mm in zip(colours, _MARKERS, clearances_mm, strict=False):
        row = [cell for cell in cells if cell.clearance_mm == clearance_mm]
        axes.plot(
            [cell.beta_cut_deg for cell in row],
            [_find_residual_deg(cell, plane) for cell in row],
            color=colour,
            marker=marker,
            markersize=4.5,
            linewidth=1,
            label=f"{clearance_mm:.3f} mm",
        )
    axes.axhline(0.0, color="#888888", linewidth=0.7)
    axes.set_xlabel("inclination β_cut [°]")
    axes.set_ylabel("residual of β_rot [°]")
    axes.legend(title="clearance d", loc="upper center", ncols=2)


def _find_residual_deg(cell: GridPoint, plane: RotationPlane) -> float:
    return cell.beta_rot_deg - plane.beta_rot_deg(cell.beta_cut_deg, cell.clearance_mm)
