"""What of a calibrated scene a picture shows, to be drawn over it: the sheath."""

from collections.abc import Callable
from dataclasses import dataclass

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
