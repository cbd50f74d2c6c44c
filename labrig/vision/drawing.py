"""A plan drawn over a picture.

Lines are thin enough to leave the needle's edges visible. The colours are those of Okabe and Ito (Color Universal
Design, 2008), which colour-blind readers can distinguish.
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
# The sheath's line is longer than the axis, and its text is clear of the text of the axes.
_SHEATH_MM = 24.0
_BELOW_PX = np.array([-90.0, 60.0])
_RING_PX = 5


@dataclass(frozen=True, eq=False)
class DrawnPlan:
    """A plan to draw, with points (y, z) [mm] of the steering plane.

    `path_mm` is (N, 2), an obstacle a centre and a radius; `sheath` is the tip and heading [rad] found, if any.
    """

    path_mm: FloatArray
    target_mm: tuple[float, float]
    tolerance_mm: float
    obstacles: tuple[tuple[tuple[float, float], float], ...] = ()
    sheath: tuple[tuple[float, float], float] | None = None


def draw_plan(image: Picture, plane: PlaneMap, plan: DrawnPlan) -> Picture:
    """Return a copy of the picture, (H, W, 3) blue-green-red, with the plan and the plane's axes.

    The path is blue, the target an orange ring of its tolerance, obstacles are yellow. The axes are green and 10 mm
    long, from the commanded origin, z along the insertion. A purple line shows the sheath that was found.
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
        axis_px = plane.to_px(np.array([(0.0, 0.0), end_mm]))
        _draw_polyline(drawn, axis_px, _AXES)
        _draw_name(drawn, name, axis_px[1] + 6.0, _AXES)
    if plan.sheath is not None:
        tip_mm, heading_rad = plan.sheath
        along = _SHEATH_MM * np.array([np.sin(heading_rad), np.cos(heading_rad)])
        tip_px, end_px = plane.to_px(np.array([tip_mm, tip_mm + along]))
        _draw_polyline(drawn, tip_px + _RING_PX * ring, _SHEATH)
        _draw_polyline(drawn, np.array([tip_px, end_px]), _SHEATH)
        found = f"sheath found: y {tip_mm[0]:+.2f}, z {tip_mm[1]:+.2f} mm, {np.degrees(heading_rad):+.1f} deg"
        _draw_name(drawn, found, tip_px + _BELOW_PX, _SHEATH)
    return drawn


def _draw_name(drawn: Picture, name: str, place: FloatArray, colour: _Colour) -> None:
    """Draw a name in a colour, outlined in black."""
    u, v = (int(coordinate) for coordinate in place)
    for width, tone in ((3, _OUTLINE), (1, colour)):
        cv2.putText(drawn, name, (u, v), cv2.FONT_HERSHEY_SIMPLEX, 0.45, tone, width, cv2.LINE_AA)


def _draw_polyline(drawn: Picture, points: FloatArray, colour: _Colour) -> None:
    fixed = np.rint(points * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(drawn, [fixed], isClosed=False, color=colour, lineType=cv2.LINE_AA, shift=_SUBPIXEL_BITS)
