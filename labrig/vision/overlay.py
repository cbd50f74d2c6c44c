"""A measurement drawn into its picture, thin enough to judge the needle's edges beside it.

Colours are those of Okabe and Ito (Color Universal Design, 2008), told apart by colour-blind readers.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.vision.curvature import CurvatureMeasurement
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]
_Colour = tuple[int, int, int]

# Blue, green, red.
_CENTRE_LINE: _Colour = (66, 228, 240)
_CIRCLE: _Colour = (233, 180, 86)
_ENTRY: _Colour = (115, 158, 0)
_TIP: _Colour = (0, 94, 213)
# The circle is drawn this far beyond the fitted window, so that its course shows against the needle's.
_BEYOND_MM = 4.0
_CIRCLE_POINTS = 200
_DASH_ROWS = 10
_SUBPIXEL_BITS = 4
# Marks are this long compared with the picture's width, and at least so many pixels.
_MARK, _LEAST_MARK_PX = 0.012, 5.0


def draw_measurement(image: Picture, measurement: CurvatureMeasurement, plane: PlaneMap) -> Picture:
    """Return a copy of the picture, (H, W, 3) blue-green-red, with what was measured drawn in.

    The centre line is dashed yellow, the fitted circle blue, the entry (the sheath's tip) a green cross, the
    needle's tip an orange ring; what is None is not drawn.
    """
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    drawn = np.asarray(colour, dtype=np.uint8)
    if measurement.radius_mm is not None and measurement.centre_mm is not None:
        _polyline(
            drawn, plane.to_px(_arc_mm(measurement.centre_mm, measurement.radius_mm, measurement)), _CIRCLE
        )
    # Dashed, because line and circle coincide where all is well.
    for first in range(0, len(measurement.centre_line_px), 2 * _DASH_ROWS):
        _polyline(drawn, measurement.centre_line_px[first : first + _DASH_ROWS], _CENTRE_LINE)
    half = max(_LEAST_MARK_PX, _MARK * image.shape[1])
    if measurement.entry_mm is not None:
        centre = plane.to_px(np.array([measurement.entry_mm]))[0]
        for across in (np.array([half, half]), np.array([half, -half])):
            _polyline(drawn, np.array([centre - across, centre + across]), _ENTRY)
    if measurement.tip_px is not None:
        turn = np.linspace(0.0, 2.0 * np.pi, 60)
        _polyline(drawn, measurement.tip_px + half * np.column_stack((np.cos(turn), np.sin(turn))), _TIP)
    return drawn


def _arc_mm(centre: tuple[float, float], radius: float, measurement: CurvatureMeasurement) -> FloatArray:
    """Return points (N, 2) of the circle along the fitted window and a little beyond."""
    first, end = measurement.window
    fitted = (measurement.centre_line_mm[first:end] - centre) @ [1.0, 1.0j]
    middle = fitted[len(fitted) // 2]
    turns = np.angle(fitted / middle)
    beyond = _BEYOND_MM / radius
    angles = np.linspace(turns.min() - beyond, turns.max() + beyond, _CIRCLE_POINTS)
    points = middle / np.abs(middle) * radius * np.exp(1j * angles)
    return np.column_stack((points.real, points.imag)) + centre


def _polyline(drawn: Picture, points: FloatArray, colour: _Colour) -> None:
    if len(points):
        fixed = np.rint(points * 2**_SUBPIXEL_BITS).astype(np.int32)
        cv2.polylines(
            drawn, [fixed], isClosed=False, color=colour, lineType=cv2.LINE_AA, shift=_SUBPIXEL_BITS
        )
