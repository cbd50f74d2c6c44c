"""A plan drawn into its picture, thin enough to judge the needle's edges beside it.

Colours are those of Okabe and Ito (Color Universal Design, 2008), told apart by colour-blind readers.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]
_Colour = tuple[int, int, int]

# Blue, green, red.
_OBSTACLE: _Colour = (66, 228, 240)
_PATH: _Colour = (233, 180, 86)
_AXES: _Colour = (115, 158, 0)
_TARGET: _Colour = (0, 94, 213)
_SHEATH: _Colour = (167, 121, 204)
_OUTLINE: _Colour = (0, 0, 0)
_SUBPIXEL_BITS = 4
_AXIS_MM = 10.0
# The sheath's arrow goes beyond the axis, and its words stand clear of those of the axes.
_SHEATH_MM = 24.0
_BELOW_PX = np.array([-90.0, 60.0])
_RING_PX = 5.0


@dataclass(frozen=True, eq=False)
class DrawnPlan:
    """A plan as it is drawn: columns (y, z) [mm] of the steering plane.

    path_mm (N, 2); target_mm (y, z) with its tolerance; obstacles ((y, z), radius); sheath its tip (y, z) and heading
    [rad] where it was found.
    """

    path_mm: FloatArray
    target_mm: tuple[float, float]
    tolerance_mm: float
    obstacles: tuple[tuple[tuple[float, float], float], ...] = ()
    sheath: tuple[tuple[float, float], float] | None = None


def draw_plan(image: Picture, plane: PlaneMap, plan: DrawnPlan) -> Picture:
    """Return a copy of the picture, (H, W, 3) blue-green-red, with a plan and the plane's axes drawn in.

    The path is blue, the target an orange ring of its tolerance, obstacles yellow; the axes are green, 10 mm long, z
    along the insertion, from the origin that was commanded. Where the sheath was found is a purple arrow along it.
    """
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    drawn = np.asarray(colour, dtype=np.uint8)
    turn = np.linspace(0.0, 2.0 * np.pi, 120)
    ring = np.column_stack((np.cos(turn), np.sin(turn)))
    for centre_mm, radius_mm in plan.obstacles:
        _draw_polyline(drawn, plane.to_px(np.asarray(centre_mm) + radius_mm * ring), _OBSTACLE)
    _draw_polyline(drawn, plane.to_px(np.asarray(plan.target_mm) + plan.tolerance_mm * ring), _TARGET)
    if len(plan.path_mm):
        _draw_polyline(drawn, plane.to_px(plan.path_mm), _PATH)
    for name, end_mm in (("z 10 mm", (0.0, _AXIS_MM)), ("y", (_AXIS_MM, 0.0))):
        _, end = _draw_arrow(drawn, plane.to_px(np.array([(0.0, 0.0), end_mm])), _AXES)
        _draw_name(drawn, name, end + 6.0, _AXES)
    if plan.sheath is not None:
        _draw_sheath(drawn, plane, *plan.sheath)
    return drawn


def _draw_sheath(drawn: Picture, plane: PlaneMap, tip_mm: tuple[float, float], heading_rad: float) -> None:
    """Draw where the sheath was found: an arrow along its heading through a ring at its tip, named with both."""
    along = _SHEATH_MM * np.array([np.sin(heading_rad), np.cos(heading_rad)])
    start, _ = _draw_arrow(drawn, plane.to_px(np.array([tip_mm, tip_mm + along])), _SHEATH)
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    _draw_polyline(drawn, start + _RING_PX * np.column_stack((np.cos(turn), np.sin(turn))), _SHEATH)
    found = f"sheath found: y {tip_mm[0]:+.2f}, z {tip_mm[1]:+.2f} mm, {np.degrees(heading_rad):+.1f} deg"
    for width, colour in ((3, _OUTLINE), (1, _SHEATH)):
        _draw_name(drawn, found, start + _BELOW_PX, colour, width)


def _draw_arrow(drawn: Picture, ends: FloatArray, colour: _Colour) -> tuple[FloatArray, FloatArray]:
    """Draw an arrow between two pixels (2, 2), and return them."""
    start, end = ends
    tip = 0.85 * (end - start)
    aside = 0.07 * np.array([-(end - start)[1], (end - start)[0]])
    _draw_polyline(drawn, np.array([start, end, start + tip + aside, start + tip - aside, end]), colour)
    return start, end


def _draw_name(drawn: Picture, name: str, place: FloatArray, colour: _Colour, width_px: int = 1) -> None:
    u, v = (int(one) for one in place)
    cv2.putText(drawn, name, (u, v), cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, width_px, cv2.LINE_AA)


def _draw_polyline(drawn: Picture, points: FloatArray, colour: _Colour) -> None:
    if len(points):
        fixed = np.rint(points * 2**_SUBPIXEL_BITS).astype(np.int32)
        cv2.polylines(
            drawn, [fixed], isClosed=False, color=colour, lineType=cv2.LINE_AA, shift=_SUBPIXEL_BITS
        )
