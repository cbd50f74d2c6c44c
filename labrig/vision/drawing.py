"""What is drawn over a picture: the sheath that it shows, and a plan.

Lines are thin enough to leave the needle's edges visible. The colours are those of Okabe and Ito (Color Universal
Design, 2008), which colour-blind readers can distinguish.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import LabrigError
from labrig.vision.picture import Picture, require_contrast
from labrig.vision.plane import PlaneMap
from labrig.vision.sheath import SheathPose, measure_sheath

Polyline = tuple[tuple[float, float], ...]

_ARROW_MM = 10.0


@dataclass(frozen=True)
class Landmark:
    """Something that was looked for.

    Attributes
    ----------
    name : str
        sheath.
    found : bool
    text : str
        What was found, or why not.
    lines : tuple
        What to draw: lines through pixels (u, v).
    """

    name: str
    found: bool
    text: str
    lines: tuple[Polyline, ...] = ()


def find_landmarks(
    image: Picture, plane: Callable[[], PlaneMap], sheath_diameter_mm: float
) -> tuple[Landmark, ...]:
    """Return the sheath in a picture, or why it was not found.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    plane : callable
        Returns the map by which the sheath is measured, or raises a `LabrigError` if there is none.
    sheath_diameter_mm : float
        Within a factor of about 1.5.
    """
    try:
        text, lines = _find_sheath(image, plane(), sheath_diameter_mm)
    except LabrigError as refusal:
        return (Landmark("sheath", found=False, text=refusal.message),)
    return (Landmark("sheath", found=True, text=text, lines=lines),)


def _find_sheath(image: Picture, plane: PlaneMap, diameter_mm: float) -> tuple[str, tuple[Polyline, ...]]:
    require_contrast(image)
    pose: SheathPose = measure_sheath(image, plane, diameter_mm)
    heading = np.array([np.sin(pose.heading_rad), np.cos(pose.heading_rad)])
    aside = 0.5 * pose.width_mm * np.array([heading[1], -heading[0]])
    tip = np.array(pose.tip_mm)
    text = (
        f"tip at ({pose.tip_px[0]:.0f}, {pose.tip_px[1]:.0f}) px, y {pose.tip_mm[0]:+.2f}, z {pose.tip_mm[1]:+.2f} mm, "
        f"heading {np.degrees(pose.heading_rad):+.1f} deg, {pose.width_mm:.2f} mm wide"
    )
    return text, (
        _round(plane.to_px(np.array([tip - _ARROW_MM * heading, tip]))),
        _round(plane.to_px(np.array([tip - aside, tip + aside]))),
    )


def _round(pixels: NDArray[np.float64]) -> Polyline:
    return tuple((round(float(u), 1), round(float(v), 1)) for u, v in pixels)


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
