"""What of a calibrated scene a picture shows, to be drawn over it: the ruled lines of graph paper, and the sheath."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from labrig.errors import LabrigError
from labrig.vision.graph_paper import Crossings, find_crossings
from labrig.vision.picture import Picture, require_contrast
from labrig.vision.plane import PlaneMap
from labrig.vision.sheath import SheathPose, measure_sheath

Polyline = tuple[tuple[float, float], ...]

_ARROW_MM = 10.0
_Found = TypeVar("_Found")


@dataclass(frozen=True)
class Landmark:
    """Something that was looked for.

    Attributes
    ----------
    name : str
        ruled paper, or sheath.
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
) -> tuple[Landmark, Landmark]:
    """Return the ruled paper and the sheath in a picture, or why they were not found; takes about two seconds.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    plane : callable
        Returns the map by which the sheath is measured, or raises a `LabrigError` if there is none.
    sheath_diameter_mm : float
        Within a factor of about 1.5.
    """
    return (
        _look_for("ruled paper", lambda: _find_paper(image)),
        _look_for("sheath", lambda: _find_sheath(image, plane(), sheath_diameter_mm)),
    )


def _look_for(name: str, find: Callable[[], tuple[str, tuple[Polyline, ...]]]) -> Landmark:
    try:
        text, lines = find()
    except LabrigError as refusal:
        return Landmark(name, found=False, text=refusal.message)
    return Landmark(name, found=True, text=text, lines=lines)


def _find_paper(image: Picture) -> tuple[str, tuple[Polyline, ...]]:
    require_contrast(image)
    crossings = find_crossings(image)
    text = f"{len(crossings.pixels)} crossings, lines {crossings.pitch_px:.1f} px apart"
    return text, tuple(line for axis in (0, 1) for line in _join(crossings, axis))


def _join(crossings: Crossings, axis: int) -> list[Polyline]:
    """Return the lines of one family, each through its crossings in order."""
    numbers, along = crossings.indices[:, axis], crossings.indices[:, 1 - axis]
    order = np.lexsort((along, numbers))
    ends = np.flatnonzero(np.diff(numbers[order])) + 1
    return [_round(line) for line in np.split(crossings.pixels[order], ends) if len(line) > 1]


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
